"""The camera: its view, and its response from luminance to digital numbers and back.

A pixel that sees luminance L (cd/m^2) collects `N = L * exposure * sensitivity` electrons. Shot and read noise act as one Gaussian of
variance `N + read_noise^2`; the sum is clamped to [0, saturation] and coded as

    DN = round((2^bits - 1) * (N / saturation)^(1 / gamma)).

The default is a measuring camera with 12 bits and linear response. Use gamma 2.2 with 8 bits, where linear levels would be coarser than the
noise in the dark.
"""

import math
from typing import Annotated, Final, Literal, Protocol, Self

import torch
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.perception.noise import FrameNoise
from luxloop.world.files import afford
from luxloop.world.frames import T_ISO_OPENCV, View, pose_from_degrees
from luxloop.world.params import Degrees, Distance, Metres, Params, Positive, Slope

BYTES_A_SAMPLE: Final = 350  # of a frame with G-buffer and shading, measured


class CameraParams(Params):
    """Pose in the vehicle frame (x forward, y left, z up), optics, sensor, and delay and loss of frames."""

    x_m: Metres = Field(-1.6, description="position ahead of the lamps, negative behind")
    y_m: Metres = Field(0.0, description="position to the left of the middle line")
    z_m: Distance = Field(1.35, description="height above the assumed road plane")
    roll_deg: Degrees = Field(0.0, description="rotation about the forward axis, right side down")
    pitch_deg: Slope = Field(3.0, description="rotation about the left axis, nose down")
    yaw_deg: Degrees = Field(0.0, description="rotation about the upward axis, to the left")

    width_px: int = Field(1280, ge=16, le=8192, description="image width")
    height_px: int = Field(720, ge=16, le=8192, description="image height")
    hfov_deg: float = Field(
        30.0, ge=1, le=150, description="horizontal field of view; pixels are square, the principal point is the middle"
    )

    oversampling: int = Field(
        4,
        ge=1,
        le=16,
        description="samples over a pixel's height, since on the road a pixel integrates light over many times its width",
    )

    exposure_s: float = Field(
        0.015, ge=1e-6, le=1, description="exposure time of a frame; on and off frames must fit into one control step"
    )
    sensitivity_e_per_cd_s_m2: Positive = Field(50_000.0, description="electrons per cd/m^2 and second of exposure")
    saturation_e: Positive = Field(1_000.0, description="electrons at the largest digital number")
    read_noise_e: Positive = Field(2.0, description="standard deviation of the read noise in electrons")
    bits: Literal[8, 10, 12] = Field(12, description="bits of a digital number")
    gamma: float = Field(1.0, ge=1, le=3, description="digital numbers are the 1/gamma-th power of the light; 1 is linear")
    noise: bool = Field(True, description="whether frames have shot and read noise")

    latency_steps: int = Field(0, ge=0, le=10, description="latency of frames, in control steps")
    latency_spread_steps: int = Field(
        0, ge=0, le=10, description="largest additional latency, in control steps, drawn at random for each step"
    )
    drop_probability: float = Field(0.0, ge=0, lt=1, description="probability that a step's frames are lost")

    @property
    def focal_px(self) -> float:
        """Focal length in px."""
        return self.width_px / 2 / math.tan(math.radians(self.hfov_deg) / 2)

    @model_validator(mode="after")
    def _affordable(self) -> Self:
        samples = self.width_px * self.height_px * self.oversampling
        size = f"{self.width_px} x {self.height_px} px of {self.oversampling} samples"
        afford(size, BYTES_A_SAMPLE * samples, "lower oversampling, or width_px and height_px")
        return self


def camera_view(params: CameraParams) -> View:
    """The camera's pinhole view while the vehicle stands at the world's origin."""
    T_world_mount = pose_from_degrees((params.x_m, params.y_m, params.z_m), params.roll_deg, params.pitch_deg, params.yaw_deg)
    return View(
        width=params.width_px,
        height=params.height_px,
        fx=params.focal_px,
        fy=params.focal_px,
        cx=params.width_px / 2,
        cy=params.height_px / 2,
        T_world_view=T_world_mount @ T_ISO_OPENCV,
    )


def average_rows(image: Tensor, oversampling: int) -> Tensor:
    """Mean over the rows of each pixel: from `[..., H * oversampling, W]` to `[..., H, W]`."""
    return image.unflatten(-2, (-1, oversampling)).mean(-2)


def expose(luminance: Tensor, params: CameraParams, noise: Tensor | FrameNoise | None = None, *, quantise: bool = True) -> Tensor:
    """Digital numbers `[..., H, W]` of luminance `[..., H, W]` >= 0 in cd/m^2: whole numbers in luminance's floating dtype.

    noise: standard normal numbers, broadcastable to luminance, or the noise of a whole frame; None or `params.noise = False`: no noise.
    quantise: False leaves the numbers unrounded and differentiable.
    """
    levels = _levels(params)
    levels_per_electron = levels / params.saturation_e
    signal = luminance * (_electrons_per_luminance(params) * levels_per_electron)  # in levels of a linear code
    if noise is not None and params.noise:
        if isinstance(noise, FrameNoise):
            noise = noise.part((slice(0, signal.shape[-2]), slice(0, signal.shape[-1])), signal)
        signal.addcmul_((signal + params.read_noise_e**2 * levels_per_electron).sqrt_(), noise, value=levels_per_electron**0.5)
    if params.gamma == 1:
        signal.clamp_(0, levels)
    else:
        # A hundredth of a level instead of zero, since the root's slope is infinite there.
        signal.mul_(1 / levels).clamp_((0.01 / levels) ** params.gamma, 1)
        signal = signal.pow_(1 / params.gamma).mul_(levels)
    return signal.round_() if quantise else signal


def luminance_of(dn: Tensor, params: CameraParams) -> Tensor:
    """Luminance `[..., H, W]` in cd/m^2 of digital numbers `[..., H, W]`, at the centre of their levels."""
    code = dn / _levels(params)
    linear = code if params.gamma == 1 else code.pow(params.gamma)
    return linear * (params.saturation_e / _electrons_per_luminance(params))


def noise_std(luminance: Tensor, params: CameraParams) -> Tensor:
    """Standard deviation in cd/m^2 of one frame's `luminance_of(expose(luminance))`, `[..., H, W]`: shot, read and quantisation noise.

    Clamping is neglected: the true deviation is smaller within three standard deviations of black (0.58 of the returned value at black) and
    of saturation. Beyond saturation: the value at saturation.
    """
    electrons = (luminance * _electrons_per_luminance(params)).clamp_(0, params.saturation_e)
    width: float | Tensor = params.saturation_e / _levels(params)  # of a level, over which the rounding error is uniform
    if params.gamma != 1:
        code, half = (electrons / params.saturation_e).pow(1 / params.gamma), 0.5 / _levels(params)
        width = params.saturation_e * ((code + half).pow(params.gamma) - (code - half).clamp(min=0).pow(params.gamma))
    variance = electrons.add_(params.read_noise_e**2) if params.noise else torch.zeros_like(electrons)
    return variance.add_(width**2 / 12).mul_(_electrons_per_luminance(params) ** -2).sqrt_()


def saturation_luminance(params: CameraParams) -> float:
    """Luminance in cd/m^2 of the largest digital number."""
    return params.saturation_e / _electrons_per_luminance(params)


def _electrons_per_luminance(params: CameraParams) -> float:
    return params.exposure_s * params.sensitivity_e_per_cd_s_m2


def _levels(params: CameraParams) -> int:
    return 2**params.bits - 1


# Disability glare (Stiles & Holladay, CIE 31-1976): 10 cd/m^2 of veil at 1 deg from a source of 1 lx at the eye
EYE_DEG2 = 10.0
BLOOM_DEG = 0.1  # inside this angle the veil is constant, since the formula diverges

Speed = Annotated[float, Field(ge=-200, le=200)]


class GlareSource(Protocol):
    """A round lamp, or the sun; veil: as of `OncomingParams`."""

    @property
    def intensity_cd(self) -> float: ...

    @property
    def diameter_m(self) -> float: ...

    @property
    def veil(self) -> float: ...


class OncomingParams(Params):
    """An oncoming headlamp: a source that faces the camera, lights no surfaces and is never occluded."""

    position_m: tuple[Metres, Metres, Metres] = Field(
        examples=[[40.0, 3.0, 0.7]], description="position in the world at the scenario's start"
    )
    velocity_m_s: tuple[Speed, Speed, Speed] = Field((0.0, 0.0, 0.0), description="velocity")
    intensity_cd: float = Field(500.0, gt=0, le=500_000, description="luminous intensity towards the camera")
    diameter_m: float = Field(0.15, gt=0, le=1, description="diameter of the luminous surface")
    veil: float = Field(
        0.1,
        ge=0,
        le=10,
        description="stray light of the lens, as a multiple of the eye's (disability glare); 0.1 is about 1 % of the light",
    )

    def position_at(self, t_s: float) -> Tensor:
        """Position `[3]` m in the world at a time."""
        start, velocity = (torch.tensor(each, dtype=torch.float64) for each in (self.position_m, self.velocity_m_s))
        return start + t_s * velocity


def glare(view: View, position: Tensor, lamp: GlareSource, device: torch.device | str = "cpu") -> Tensor:
    """Luminance `[height, width]` in cd/m^2, float32, that a lamp at a position `[3]` m in the world adds to a view's image.

    Its image is a Gaussian as wide as lamp and pixel together and integrates to the illuminance E = I / r^2; the veil is `veil * 10 E /
    theta^2` with theta in deg, at least 0.1. Zero if the lamp is behind the camera.
    """
    at = view.T_world_view[:3, :3].T @ (position - view.origin)
    distance = float(at.norm())
    x, y, z = (at / distance).tolist()
    if z <= 0:
        return torch.zeros(view.height, view.width, device=device)
    u = (torch.arange(view.width, device=device) + 0.5 - view.cx) / view.fx
    v = ((torch.arange(view.height, device=device) + 0.5 - view.cy) / view.fy)[:, None]
    shorter = (u * u + v * v + 1).rsqrt()
    chord2 = (u * shorter - x).square() + (v * shorter - y).square() + (shorter - z).square()
    theta2 = (2 * (chord2.sqrt() / 2).clamp(max=1).asin()).square()
    illuminance = lamp.intensity_cd / distance**2
    width2 = (lamp.diameter_m / distance / 4) ** 2 + 1 / (view.fx * view.fy)
    image = (theta2 / (-2 * width2)).exp_().mul_(illuminance / (2 * math.pi * width2))
    veil = lamp.veil * EYE_DEG2 * illuminance * math.radians(1) ** 2
    return image.add_(theta2.clamp_(min=math.radians(BLOOM_DEG) ** 2).reciprocal_(), alpha=veil)
