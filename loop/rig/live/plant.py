"""The simulated world lit by a real lamp: the lamp shows each exposure, and its beam on a screen becomes a module's light (T 4.3).

A motion platform gets the pose of the vehicle's body over the ground as a UDP datagram of JSON per exposure; roll is positive right side
down, pitch nose down:

    {"number": 12, "time_s": 0.4, "heave_m": 0.01, "roll_deg": 0.2, "pitch_deg": -0.5}
"""

import json
import math
import socket
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.rig.arrays import Array, Data, Image
from luxloop.loop.rig.calibration.calibrate import Calibration
from luxloop.loop.rig.calibration.geometry import Geometry, lux_per_cd, on_plane
from luxloop.loop.rig.calibration.intrinsics import brightness
from luxloop.loop.rig.calibration.shots import luminous
from luxloop.loop.rig.params import RigParams
from luxloop.loop.rig.plant import RigPlant
from luxloop.loop.rig.rectification import AS_SENT, WrongPicture, camera_picture
from luxloop.loop.rig.rig import Rig, TimeHistogram
from luxloop.loop.rig.wire.sockets import udp_sender
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame
from luxloop.loop.simulation.simulated import DigitisedPlant, UnderWay
from luxloop.loop.simulation.world import World
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import REST
from luxloop.world.texels import TexelGrid


class Beam:
    """Light textures of exposures in order.

    newest: the last digitised texture of a lit lamp, and its utilisation `[n_p]`.
    """

    def __init__(self, late: int, dark: Tensor) -> None:
        """late: delay of the light in the simulated world, in exposures. dark: texture before the first exposure."""
        self._under_way = deque[Tensor | None]([dark] * late, maxlen=late + 1)
        self._digitising, self._whole, self._saturated = TimeHistogram(), TimeHistogram(), 0.0
        self.newest: tuple[Tensor, Tensor] | None = None

    def take(self, texture: Tensor | None) -> Tensor | None:
        """Add the texture of an exposure, None if its frame is lost; returns the texture that shines now, None if lost."""
        self._under_way.append(texture)
        return self._under_way[0]

    def note(self, digitising_s: float, since_light_s: float, saturated: float) -> None:
        """Record an exposure. digitising_s: from frame to texture. since_light_s: from sending light to texture. saturated: share of
        pixels.
        """
        self._digitising.add(digitising_s)
        self._whole.add(since_light_s)
        self._saturated = max(self._saturated, saturated)

    def summary(self) -> dict[str, Any]:
        """The statistics as plain data."""
        return {
            "light_to_texture_ms": self._whole.in_ms,
            "frame_to_texture_ms": self._digitising.in_ms,
            "saturated": round(self._saturated, 6),
        }


SEEN = 0.5  # least share of texels in view
ONE_FORMAT = "camera: gives pictures in grey and in colour by turns; set it to one of them"
SATURATED = 0.98  # share of the largest digital number from which on a pixel is saturated


@dataclass(frozen=True, eq=False)
class Digitiser:
    """Conversion of a camera's picture of the screen to a light texture.

    u, v: `[rows, cols]` float32, image position of each texel's light in px, pixel centres at integers. candela: `[rows, cols]` float32,
    intensity in cd that saturates the camera there, 0 if out of view. curve: `[levels + 1]` float32, light by digital number relative to
    saturation. shape: height and width of the picture in px. dark: light without the lamp in the evaluated part of the picture, as of
    `light`, or 0.
    """

    u: Image
    v: Image
    candela: Image
    curve: Image
    shape: tuple[int, int]
    dark: Image | float = 0.0

    @classmethod
    def of(cls, calibration: Calibration, module: str, grid: TexelGrid) -> Self:
        """Digitiser of a module. module: its name in the calibration. grid: of its light texture.

        Raises LuxloopError if the calibration lacks the module or the scale, or if the camera sees less than half of the texels.
        """
        if calibration.lux is None:
            raise LuxloopError("has no scale; run `luxloop rig calibrate` again with a reading of a luxmeter, --lux LUX@U,V")
        geometry, camera = calibration.geometry(module), calibration.camera
        y, z = (each.numpy() for each in grid.tangents())
        places, candela = _falling(geometry, y, z)
        u, v = camera.project(places).T.reshape(2, grid.rows, grid.cols) - 0.5  # OpenCV's maps count from pixels' centres
        ahead = (places[:, 2] > 0).reshape(grid.rows, grid.cols) & np.isfinite(u) & np.isfinite(v)
        seen = ahead & (u >= 0) & (v >= 0) & (u <= camera.width - 1) & (v <= camera.height - 1)
        if seen.mean() < SEEN:
            raise LuxloopError(
                f"by it the camera sees {seen.mean():.0%} of the light of {module!r} on the screen; calibrate with a camera that sees all"
            )
        shade = brightness(calibration.vignetting, camera.height, camera.width).astype(np.float32)
        u, v = (np.where(seen, each, 0).astype(np.float32) for each in (u, v))
        factor = calibration.lux * candela.reshape(seen.shape) / cv2.remap(shade, u, v, cv2.INTER_LINEAR)
        return cls(u, v, np.where(seen, factor, 0).astype(np.float32), calibration.response, (camera.height, camera.width))

    @property
    def coverage(self) -> float:
        """Share of the texels in the camera's view, 0..1."""
        return float((self.candela > 0).mean())

    def without(self, pictures: Image) -> Self:
        """Digitiser that subtracts the mean light of pictures `[n, height, width]` or `[n, height, width, 3]` without the lamp."""
        return replace(self, dark=np.stack([self.light(each) for each in pictures]).mean(0))

    def light(self, picture: Image) -> Image:
        """Linear light in the evaluated part of a picture of digital numbers, relative to saturation.

        Raises LuxloopError if the picture's size or numbers do not fit the calibration.
        """
        if picture.shape[:2] != self.shape:
            raise LuxloopError(f"is of {self.shape[1]} x {self.shape[0]} px, but the camera has {picture.shape[1]} x {picture.shape[0]} px")
        part = picture[self._part]
        try:
            return self.curve[part if part.dtype.kind == "u" else part.astype(np.uint16)]
        except IndexError as error:
            raise LuxloopError(f"has the response of numbers up to {len(self.curve) - 1}, but the camera gives {part.max():.0f}") from error

    def saturation(self, picture: Image) -> float:
        """Share of saturated pixels in the evaluated part, 0..1."""
        return float((picture[self._part] >= SATURATED * (len(self.curve) - 1)).mean())

    def texture(self, picture: Image) -> Tensor:
        """Light texture `[rows, cols]` in cd of a grey picture `[height, width]`, or `[3, rows, cols]` in linear sRGB of a colour picture
        `[height, width, 3]` (blue, green, red).

        Raises LuxloopError as `light`, and if the dark pictures had another number of channels.
        """
        if isinstance(self.dark, np.ndarray) and self.dark.ndim != picture.ndim:
            raise LuxloopError(ONE_FORMAT)
        lit = cv2.remap(self.light(picture) - self.dark, *self._maps, cv2.INTER_LINEAR).clip(0)  # negative noise is cut off
        if lit.ndim == 2:
            return torch.from_numpy(lit * self.candela)
        return torch.from_numpy(lit).flip(2).permute(2, 0, 1) * torch.from_numpy(self.candela)

    @cached_property
    def _part(self) -> tuple[slice, slice]:
        """Rows and columns of the evaluated part of the picture."""
        seen = self.candela > 0
        spans = ((each[seen].min(), each[seen].max(), n) for each, n in zip((self.v, self.u), self.shape, strict=True))
        v, u = (slice(int(low), min(int(high) + 2, n)) for low, high, n in spans)
        return v, u

    @cached_property
    def _maps(self) -> tuple[Image, Image]:
        """u and v relative to the evaluated part."""
        rows, cols = self._part
        return self.u - np.float32(cols.start), self.v - np.float32(rows.start)


def _falling(geometry: Geometry, y: Array, z: Array) -> tuple[Array, Array]:
    """Points of the screen lit by the texels at tangents y `[cols]` and z `[rows]`, `[rows * cols, 3]` m in the camera's frame, and cd per
    lx there, `[rows * cols]`, from `I = E d^2 / cos` (T eq. 2.1.5); 0 for rays that miss the screen.
    """
    lamp, screen = geometry.lamp, geometry.screen
    zz, yy = np.meshgrid(z, y, indexing="ij")
    rays = np.stack([np.ones(yy.size), yy.ravel(), zz.ravel()], -1) @ lamp.rotation.T
    places = on_plane(rays, lamp.place, screen)
    forward = ((places - lamp.place) * rays).sum(1) > 0
    return places, np.where(forward, 1 / lux_per_cd(places, lamp.place, screen.rotation[:, 2]), 0.0)


DARKS = 8  # dark frames before the run, whose mean is subtracted
FIRST = 40  # number of the run's first exposure on the rig, after the dark frames, some of which may be lost


def screen_picture(shape: tuple[int, int], data: Data) -> Image:
    """Codes `[height, width]`, or `[height, width, 3]` (blue, green, red), of an encoded or raw picture. shape: expected height and width.

    Raises WrongPicture if it is damaged or of another size.
    """
    picture = camera_picture(data, cv2.IMREAD_ANYCOLOR | AS_SENT) if isinstance(data, bytes) else data
    if picture.shape[:2] != shape:
        (height, width), (rows, columns) = shape, picture.shape[:2]
        raise WrongPicture(f"camera: a picture of {columns} x {rows} px, where the calibration is of {width} x {height}")
    return (picture if picture.ndim == 2 else picture[..., :3]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class LivePlant:
    """A plant whose simulated world waits for the lamp at each exposure; an exposure without a frame from the rig is lost.

    own: the simulated world with its digitised module. lab: the rig, which shows this module alone. platform: socket of the motion
    platform.
    """

    own: DigitisedPlant
    lab: RigPlant
    digitiser: Digitiser
    beam: Beam
    platform: socket.socket | None = None

    @property
    def truth(self) -> World:
        """Ground truth of the simulated world, lit by the digitised light."""
        return self.own.truth

    def start(self) -> tuple[UnderWay, Arrivals]:
        """Initial state: nothing is lit, and no frame is pending."""
        return self.own.night.start()

    def show(self, state: UnderWay, exposure: Exposure) -> tuple[UnderWay, Arrivals]:
        """Show an exposure on the lamp, digitise its light, and expose a frame of the simulated world in this light."""
        self._move(exposure)
        u, command = exposure.lights[self.own.number], exposure.commands[self.own.number] if exposure.commands else REST
        light = u if command.intensity == 1 else Utilisation(command.intensity * u.u, u.band)  # the simulated world turns the module
        (frame,) = self.lab.show(None, replace(exposure, number=FIRST + exposure.number, lights=(light,), commands=()))[1].frames
        texture = None if frame.image is None else self._texture(frame, light)
        now = self.beam.take(texture)
        if now is not None:
            self.own.measured.keep(light.u, now)
        queue, arrivals = self.own.night.show(state, exposure)
        if now is None:
            return _replace_frame(queue, arrivals, exposure.number, image=None)
        if frame.shown is not None:
            lights = (*exposure.lights[: self.own.number], *frame.shown.lights, *exposure.lights[self.own.number + 1 :])
            return _replace_frame(queue, arrivals, exposure.number, shown=replace(exposure, lights=lights))
        return queue, arrivals

    def _texture(self, frame: Frame, light: Utilisation) -> Tensor:
        """Light texture `[rows, cols]` in cd of a frame."""
        assert frame.image is not None
        begun_s, since_s, picture = time.monotonic(), self.lab.rig.keeper.since_s, frame.image.cpu().numpy()
        texture = self.digitiser.texture(picture)
        intensity = luminous(texture)
        took_s = time.monotonic() - begun_s
        if since_s is not None:
            self.beam.note(took_s, frame.arrived_s - since_s + took_s, self.digitiser.saturation(picture))
        if bool(light.u.any()):
            self.beam.newest = texture, light.u
        return intensity

    def _move(self, exposure: Exposure) -> None:
        if self.platform is not None:
            body = self.own.night.dynamics.at(exposure.start_s)
            angles = {"roll_deg": math.degrees(body.roll_rad), "pitch_deg": math.degrees(body.pitch_rad)}
            pose = {"number": exposure.number, "time_s": exposure.start_s, "heave_m": body.heave_m, **angles}
            with suppress(OSError):  # without a listener
                self.platform.send(json.dumps(pose).encode())


@contextmanager
def live_plant(rig: Rig, own: DigitisedPlant, calibration: Calibration, exposures: int) -> Iterator[LivePlant]:
    """Live plant of an open rig. own: the scenario's plant. calibration: of the rig. exposures: number of exposures.

    Takes dark frames first. Raises LuxloopError if they do not arrive, or if rig, calibration and scenario do not fit together.
    """
    module = own.truth.modules[own.number]
    rig.rectify = partial(screen_picture, (calibration.camera.height, calibration.camera.width))
    lab = RigPlant.of(rig, [module], FIRST + exposures)
    digitiser = Digitiser.of(calibration, module.name, module.headlight)
    dark = torch.zeros(module.headlight.rows, module.headlight.cols)
    to = rig.params.platform
    with nullcontext() if to is None else udp_sender("platform.host", to.host, to.port) as platform:
        yield LivePlant(own, lab, digitiser.without(_dark_frames(lab)), Beam(own.late, dark), platform)


def refuse_unfit(params: RigParams) -> Path:
    """Path of the calibration file. Raises LuxloopError if the rig file has no calibration, or has a mark."""
    if params.mark is not None:
        raise LuxloopError("mark: lies in the light that is digitised; take it out, and give light.repeats against lost packets")
    if params.calibration is None:
        raise LuxloopError("calibration: is needed to digitise a beam; name the file of `luxloop rig calibrate` there")
    return params.calibration.file


def _dark_frames(lab: RigPlant) -> Image:
    """Pictures of the screen without the lamp's light."""
    dark = Utilisation(torch.zeros(lab.grids[0][0] * lab.grids[0][1]), slice(0, 0))
    found = list[Image]()
    for number in range(FIRST):
        (frame,) = lab.show(None, Exposure(number, 0.0, 0.0, (dark,)))[1].frames
        if frame.image is not None:
            found.append(frame.image.cpu().numpy())
            if found[0].ndim != found[-1].ndim:
                raise LuxloopError(ONE_FORMAT)
        if len(found) == DARKS:
            return np.stack(found)
    raise LuxloopError(f"{len(found)} of {DARKS} dark frames came in {FIRST} tries; measure [timing] with `luxloop rig blink`")


def _replace_frame(queue: UnderWay, arrivals: Arrivals, number: int, **changes: Any) -> tuple[UnderWay, Arrivals]:
    """Queue and arrivals with changes to the frame of an exposure, whether pending or arrived."""

    def swap(frame: Frame) -> Frame:
        return replace(frame, **changes) if frame.number == number else frame

    return tuple((due, swap(frame)) for due, frame in queue), replace(arrivals, frames=tuple(map(swap, arrivals.frames)))
