"""Faults of the rig process, unknown to its user: of light input, lamp, screen, lens and camera."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.intrinsics import BoardParams
from luxloop.loop.scenario.disturbances import PoseErrorParams
from luxloop.loop.scenario.overrides import overridden
from luxloop.world.errors import locate
from luxloop.world.params import Params, Seed, Share
from luxloop.world.validation import read_toml, validate_model

PREFIX = "faults"
COEFFICIENTS = {"opencv": 5, "fisheye": 4, "division": 1}  # number of coefficients by lens model


class LightInputParams(Params):
    """Transmission of light from the network to the lamp."""

    gamma: float = Field(1.0, ge=0.2, le=5, description="exponent of the utilisation, by the code as a share of the largest; 1 is linear")
    latency_s: float = Field(0.0, ge=0, le=1, description="delay from the last packet of a frame to its light")
    packet_loss: Share = Field(0.0, description="probability that a packet is lost")
    mixed: bool = Field(False, description="whether an incomplete frame is shown, with older light in its gaps; otherwise the lamp waits")
    timeout_ms: float = Field(100.0, ge=1, le=60_000, description="time without a complete frame until the lamp darkens")


class LampErrorParams(PoseErrorParams):
    """Errors of the lamp: pose, intensity and pixels."""

    scale: float = Field(1.0, gt=0, le=10, description="intensity as a multiple of the scenario's")
    dead: Share = Field(0.0, description="share of pixels that never shine, in each module")
    stuck: Share = Field(0.0, description="share of pixels that are always fully on while the lamp is powered, in each module")


class ScreenParams(Params):
    """A glossy screen or road, brighter about the mirror direction."""

    gloss: float = Field(0.0, ge=0, le=100, description="additional luminance in the mirror direction, as a share of the diffuse one")
    gloss_width_deg: float = Field(
        15.0,
        gt=0.1,
        le=90,
        description="angle between the normal and the bisector of lamp and camera where this luminance is 1/e",
    )


class LensParams(Params):
    """Distortion and errors of the lens. Coefficients are those of OpenCV."""

    model: Literal["opencv", "fisheye", "division"] = Field(
        "opencv",
        description="opencv: k1, k2, p1, p2, k3; fisheye: k1 to k4 of an equidistant lens; division: k, radii shrink by 1 + k r^2",
    )
    coefficients: tuple[float, ...] = Field((), max_length=5, description="coefficients of the model; left out: no distortion")
    centre_px: tuple[float, float] = Field((0.0, 0.0), description="offset of the principal point to the right and down")
    chromatic_percent: float = Field(
        0.0, ge=-2, le=2, description="lateral chromatic aberration: magnification of red above, and of blue below, that of green"
    )
    blur_px: float = Field(0.0, ge=0, le=20, description="standard deviation of the image of a point")
    veil: float = Field(0.0, ge=0, le=0.5, description="share of the light that is scattered widely over the image (veiling glare)")
    veil_px: float = Field(60.0, ge=10, le=2000, description="standard deviation of the scattered light")
    vignetting: Share = Field(0.0, description="share of the light lost in the corners; the loss grows with the square of the radius")

    @model_validator(mode="after")
    def _as_many_as_the_model_has(self) -> Self:
        most = COEFFICIENTS[self.model]
        if len(self.coefficients) > most:
            raise ValueError(f"coefficients: the model {self.model} has {most}, not {len(self.coefficients)}; leave out the others")
        return self

    @property
    def k(self) -> Array:
        """All coefficients of the model, zeros added."""
        return np.pad(self.coefficients, (0, COEFFICIENTS[self.model] - len(self.coefficients)))


class CameraErrorParams(Params):
    """Exposure, response and transmission of the camera beyond the scenario's [camera]."""

    rate_hz: float = Field(30.0, ge=0.1, le=1000, description="frame rate; frames that cannot be rendered in time are skipped")
    trigger: Literal["free", "light"] = Field("free", description="free-running, or one frame per new frame of light")
    trigger_delay_s: float = Field(0.0, ge=0, le=1, description="delay from light to the triggered exposure")
    readout_s: float = Field(
        0.0, ge=0, le=1, description="rolling shutter: time from the first row's exposure to the last row's; 0: global shutter"
    )
    latency_s: float = Field(0.0, ge=0, le=5, description="delay from the end of an exposure to sending; at least the rendering time")
    jitter_s: float = Field(
        0.0, ge=0, le=1, description="largest additional delay, drawn uniformly for each frame; frames keep their order"
    )
    loss: Share = Field(0.0, description="probability that a frame is not sent")
    gamma: float | None = Field(None, ge=1, le=3, description="true gamma of the response; left out: that of [camera]")
    black_level: float = Field(0.0, ge=0, le=0.5, description="digital number without light, as a share of the largest")
    columns: int = Field(
        2, ge=1, le=8, description="samples over a pixel's width; over its height they are the scenario's camera.oversampling"
    )
    encoding: Literal["png", "jpeg"] = Field("png", description="encoding of frames; JPEG is lossy and for 8 bits only")
    quality: int = Field(95, ge=10, le=100, description="quality of JPEG")


class FlickerParams(Params):
    """Flicker of the ambient light."""

    depth: Share = Field(0.0, description="amplitude as a share of the mean")
    rate_hz: float = Field(100.0, gt=0, le=1000, description="frequency, twice that of the mains")


class BoardFaultParams(BoardParams):
    """A ChArUco board before the camera in room light, while no light is sent."""

    shown: bool = Field(False, description="whether the camera sees a board")


class FaultParams(Params):
    """All faults of a rig process; by default there are none."""

    light: LightInputParams = Field(LightInputParams(), description="transmission of the light")
    lamp: LampErrorParams = Field(LampErrorParams(), description="errors of the lamp")
    screen: ScreenParams = Field(ScreenParams(), description="reflectance of all surfaces")
    lens: LensParams = Field(LensParams(), description="distortion and errors of the lens")
    camera: CameraErrorParams = Field(CameraErrorParams(), description="shutter, response, delay and loss")
    flicker: FlickerParams = Field(FlickerParams(), description="flicker of the ambient light")
    board: BoardFaultParams = Field(BoardFaultParams(), description="a board for calibrating the lens")
    seed: Seed = Field(0, description="seed of losses, jitter and faulty pixels")


def read(file: Path | None, changes: Sequence[str] = ()) -> FaultParams:
    """Faults of a file with changes, given as `faults.KEY=VALUE` in TOML syntax. Raises LuxloopError with file, key and remedy."""
    data: Mapping[str, Any] = {} if file is None else read_toml(file)
    if changes:
        data = overridden({PREFIX: {**FaultParams().model_dump(mode="json"), **data}}, changes)[PREFIX]
    source = [*([] if file is None else [str(file)]), *(f"--set {each}" for each in changes)]
    with locate(" with ".join(source) or PREFIX):
        return validate_model(FaultParams, data, "docs/rig.md has an example")


def split(overrides: Sequence[str]) -> tuple[list[str], list[str]]:
    """Overrides of the scenario's keys, and of fault keys."""
    mine = [each for each in overrides if each.partition("=")[0].strip().partition(".")[0] == PREFIX]
    return [each for each in overrides if each not in mine], mine
