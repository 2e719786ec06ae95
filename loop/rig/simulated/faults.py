"""Faults of the rig process, unknown to its user: of light input, lamp, screen, lens and camera."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.intrinsics import BoardParams
from luxloop.loop.scenario.disturbances import PoseErrorParams
from luxloop.loop.scenario.overrides import overridden
from luxloop.world.errors import locate
from luxloop.world.params import Params, Seed, Share
from luxloop.world.validation import read_toml, validate_model

PREFIX: Final = "faults"
COEFFICIENTS: Final = {"opencv": 5, "fisheye": 4, "division": 1}  # of each model of a lens


class LightInputParams(Params):
    """Transmission of light from the network to the lamp."""

    gamma: float = Field(1.0, ge=0.2, le=5, description="utilisation is the code, as a share of the largest, to this power; 1 is linear")
    latency_s: float = Field(0.0, ge=0, le=1, description="delay from the last packet of a frame to its light")
    packet_loss: Share = Field(0.0, description="probability that a packet is lost")
    mixed: bool = Field(False, description="whether an incomplete frame is lit, with older light in its gaps; else the lamp waits")
    timeout_ms: float = Field(100.0, ge=1, le=60_000, description="time without a complete frame after which the lamp darkens")


class LampErrorParams(PoseErrorParams):
    """Differences of the lamp from the scenario: its pose, its intensity, its pixels."""

    scale: float = Field(1.0, gt=0, le=10, description="intensity as a multiple of the scenario's")
    dead: Share = Field(0.0, description="share of pixels that never shine, in each module")
    stuck: Share = Field(0.0, description="share of pixels that are always fully on while the lamp is powered, in each module")


class ScreenParams(Params):
    """A screen or road that is not Lambertian: it reflects more about the mirror direction."""

    gloss: float = Field(0.0, ge=0, le=100, description="additional luminance in the mirror direction, as a share of the diffuse one")
    gloss_width_deg: float = Field(
        15.0, gt=0.1, le=90, description="angle between the normal and the bisector of lamp and camera at which it has fallen to 1/e"
    )


class LensParams(Params):
    """Distortion and errors of the lens. Coefficients are those of OpenCV."""

    model: Literal["opencv", "fisheye", "division"] = Field(
        "opencv",
        description="opencv: k1, k2, p1, p2, k3; fisheye: k1 to k4 of an equidistant lens; division: one, radii shrink by 1 + k r^2",
    )
    coefficients: tuple[float, ...] = Field((), max_length=5, description="coefficients of the model; left out: no distortion")
    centre_px: tuple[float, float] = Field((0.0, 0.0), description="offset of the principal point to the right and down")
    chromatic_percent: float = Field(
        0.0, ge=-2, le=2, description="lateral chromatic aberration: by how much red is magnified more, and blue less, than green"
    )
    blur_px: float = Field(0.0, ge=0, le=20, description="standard deviation of the image of a point")
    veil: float = Field(0.0, ge=0, le=0.5, description="share of the light that is scattered widely over the image (veiling glare)")
    veil_px: float = Field(60.0, ge=10, le=2000, description="standard deviation of the scattered light")
    vignetting: Share = Field(0.0, description="share of the light that is lost in the corners; it grows with the radius' square")

    @model_validator(mode="after")
    def _as_many_as_the_model_has(self) -> Self:
        most = COEFFICIENTS[self.model]
        if len(self.coefficients) > most:
            raise ValueError(f"coefficients: the model {self.model} has {most}, not {len(self.coefficients)}; leave out the others")
        return self

    @property
    def k(self) -> Array:
        """All coefficients of the model."""
        return np.pad(self.coefficients, (0, COEFFICIENTS[self.model] - len(self.coefficients)))


class CameraErrorParams(Params):
    """How the camera exposes, responds and sends, beyond the scenario's [camera]."""

    rate_hz: float = Field(30.0, ge=0.1, le=1000, description="frame rate; frames that cannot be rendered in time are skipped")
    trigger: Literal["free", "light"] = Field("free", description="free-running, or one frame of each new frame of light")
    trigger_delay_s: float = Field(0.0, ge=0, le=1, description="delay from light to the exposure that it triggers")
    readout_s: float = Field(
        0.0, ge=0, le=1, description="rolling shutter: time from the first row's exposure to the last one's; 0: global"
    )
    latency_s: float = Field(0.0, ge=0, le=5, description="delay from the end of an exposure to sending it; at least the rendering time")
    jitter_s: float = Field(
        0.0, ge=0, le=1, description="largest additional delay, drawn uniformly for each frame; frames keep their order"
    )
    loss: Share = Field(0.0, description="probability that a frame is not sent")
    gamma: float | None = Field(None, ge=1, le=3, description="true gamma of the response; left out: that of [camera]")
    black_level: float = Field(0.0, ge=0, le=0.5, description="digital number without light, as a share of the largest")
    columns: int = Field(
        2, ge=1, le=8, description="samples over a pixel's width, beside the scenario's camera.oversampling over its height"
    )
    encoding: Literal["png", "jpeg"] = Field("png", description="encoding of frames; JPEG is lossy and for cameras of 8 bits")
    quality: int = Field(95, ge=10, le=100, description="quality of JPEG")


class FlickerParams(Params):
    """Flicker of the ambient light."""

    depth: Share = Field(0.0, description="amplitude as a share of the mean")
    rate_hz: float = Field(100.0, gt=0, le=1000, description="frequency, twice that of the mains")


class BoardFaultParams(BoardParams):
    """A ChArUco board before the camera in room light, while no light is sent."""

    shown: bool = Field(False, description="whether the camera sees a board")


class FaultParams(Params):
    """All faults of a rig process; without them it is as its scenario says."""

    light: LightInputParams = Field(LightInputParams(), description="transmission of the light")
    lamp: LampErrorParams = Field(LampErrorParams(), description="errors of the lamp")
    screen: ScreenParams = Field(ScreenParams(), description="reflectance of all surfaces")
    lens: LensParams = Field(LensParams(), description="distortion and errors of the lens")
    camera: CameraErrorParams = Field(CameraErrorParams(), description="shutter, response, delay and loss")
    flicker: FlickerParams = Field(FlickerParams(), description="flicker of the ambient light")
    board: BoardFaultParams = Field(BoardFaultParams(), description="no fault: a board to calibrate the lens with")
    seed: Seed = Field(0, description="seed of losses, jitter and faulty pixels")


def read(file: Path | None, changes: Sequence[str] = ()) -> FaultParams:
    """Faults of a file with changes, as `faults.KEY=VALUE` in TOML syntax. Raises LuxloopError that names the file, the key, the remedy."""
    data: Mapping[str, Any] = {} if file is None else read_toml(file)
    if changes:
        data = overridden({PREFIX: {**FaultParams().model_dump(mode="json"), **data}}, changes)[PREFIX]
    source = [*([] if file is None else [str(file)]), *(f"--set {each}" for each in changes)]
    with locate(" with ".join(source) or PREFIX):
        return validate_model(FaultParams, data, "docs/rig.md has an example")


def split(overrides: Sequence[str]) -> tuple[list[str], list[str]]:
    """Overrides of the scenario's keys, and those of faults."""
    mine = [each for each in overrides if each.partition("=")[0].strip().partition(".")[0] == PREFIX]
    return [each for each in overrides if each not in mine], mine
