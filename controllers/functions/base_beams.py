"""Light below and above the lighting functions: base beam (T 3.4), raw frames (T 4.1) and painted pixels (T 4.2.2)."""

import base64
import binascii
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, Self

import cv2
import numpy as np
import torch
from pydantic import Field, field_validator
from torch import Tensor

from luxloop.controllers.pixels.morphing import Morph, turn
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import Situation
from luxloop.perception.birdseye import hull, span
from luxloop.world.errors import LuxloopError
from luxloop.world.images import decode
from luxloop.world.params import Params, Share

BeamName = Literal["low", "high", "town", "motorway", "adverse", "camera", "full", "off"]
AUTOMATIC: tuple[BeamName, ...] = ("low", "town", "motorway", "adverse")  # what `afs_beam` chooses from

TOWN_BELOW_M_S = 50 / 3.6  # our choice, close to the limits of class V (town) and class E (motorway) in UN R149
MOTORWAY_ABOVE_M_S = 110 / 3.6


@dataclass(frozen=True)
class BaseBeam:
    """A beam by name and its morphing in rad: bend to the left, level nose down, roll right side down.

    share: factor on the beam, 0..1. rest: name of the beam that gets the remaining share.
    """

    name: str
    bend: float = 0.0
    level: float = 0.0
    roll: float = 0.0
    share: float = 1.0
    rest: str = "off"

    @property
    def undimmed(self) -> Self:
        """The beam at its full share, or with the rest that replaces a part of it."""
        return replace(self, share=1.0) if self.rest == "off" else self

    @property
    def shares(self) -> str:
        """The shares in words, after the beam's name."""
        if self.share == 1:
            return ""
        return f" at {100 * self.share:.0f} %" + ("" if self.rest == "off" else f", {self.rest} beam at {100 * (1 - self.share):.0f} %")

    @property
    def morph(self) -> Morph:
        return turn(self.roll, self.level, self.bend)


class BaseBeamParams(Params):
    """The base beam below all functions."""

    beam: Literal[BeamName, "auto"] = Field("off", description="beam of the lamps; `auto` chooses by speed, wetness and street lighting")
    share: Share = Field(1.0, description="share of the beam, unless a function sets it")
    rest: BeamName = Field("off", description="beam that gets the remaining share, such as `low` below a beam for the camera")
    bend_deg: float = Field(0.0, ge=-20, le=20, description="digital turn to the left")
    level_deg: float = Field(0.0, ge=-10, le=10, description="digital turn down")
    roll_deg: float = Field(0.0, ge=-20, le=20, description="digital roll, right side down")
    follow_course: bool = Field(False, description="also bend the beam into curves by the car's course")
    look_ahead_s: float = Field(2.0, gt=0, le=5, description="how far ahead the bent beam points, as travel time at the car's speed")
    largest_bend_deg: float = Field(10.0, gt=0, le=20, description="limit of the bend by the course")

    @property
    def names(self) -> tuple[BeamName, ...]:
        """The beams that may be chosen, and the rest."""
        return (*(AUTOMATIC if self.beam == "auto" else (self.beam,)), self.rest)

    def at(self, now: Situation) -> BaseBeam:
        bend = math.radians(self.bend_deg)
        if self.follow_course:
            bend += bend_of_course(now.curvature_1_m, self.look_ahead_s * now.speed_m_s)
        largest = math.radians(self.largest_bend_deg)
        name = afs_beam(now) if self.beam == "auto" else self.beam
        bend = min(max(bend, -largest), largest) if self.follow_course else bend
        return BaseBeam(name, bend, math.radians(self.level_deg), math.radians(self.roll_deg), self.share, self.rest)


class RawParams(Params):
    """Pixel utilisations from files that replace the base beam of some modules (T 4.1)."""

    file: str = Field(
        min_length=1,
        examples=["./frames/*.png"],
        description="name of a shipped sequence, or path of an array (.npy, .npz, .csv) or grey picture (.png), a value a pixel of the "
        "modules, of a folder or pattern (./frames/*.png) of these, or of a video",
    )
    modules: tuple[str, ...] = Field((), description="lamps or modules that show the frames; left out: all")
    rate_hz: float | None = Field(None, gt=0, le=1000, description="frames per second; left out: the video's own rate, else 25")
    repeat: bool = Field(True, description="start again at the end; otherwise the last frame stays")


def afs_beam(now: Situation) -> BeamName:
    """The AFS beam for a situation (T 3.4): adverse weather first, then town, then motorway, else the low beam."""
    if now.wet:
        return "adverse"
    if now.street_lit or now.speed_m_s < TOWN_BELOW_M_S:
        return "town"
    return "motorway" if now.speed_m_s > MOTORWAY_ABOVE_M_S else "low"


def bend_of_course(curvature_1_m: float, distance_m: float) -> float:
    """Bearing in rad, to the left, of the point on the car's circular course at a distance: half the angle of the arc."""
    return math.asin(min(max(curvature_1_m * distance_m / 2, -1.0), 1.0))


Picture = np.ndarray  # `[rows, columns]` uint8
LONGEST = 2**24  # characters of a picture: 1.3 million pixels of noise are half of it
REMEDY = "give the text of an 8-bit PNG, grey or RGB, with transparency"


class PaintedParams(Params):
    """Painted pixel utilisations of one module (T 4.2.2)."""

    module: str = Field(min_length=1, max_length=200, examples=["left lores"], description="the module, by lamp and name")
    png: str = Field(
        min_length=1,
        max_length=LONGEST,
        examples=["iVBORw0KGgo..."],
        description="a picture of the module's pixels as the base64 text of an 8-bit PNG with transparency: white is full utilisation, "
        "opaque pixels are painted",
    )
    over: bool = Field(
        True, description="paint over the light of the functions, below masks; false: replace that light, dark where nothing is painted"
    )

    @field_validator("png")
    @classmethod
    def _is_one(cls, text: str) -> str:
        """Decode the picture once, so that an error names the key."""
        try:
            _pictures(text)
        except LuxloopError as error:
            raise ValueError(str(error)) from error
        return text

    @classmethod
    def of(cls, module: str, value: Picture, painted: Picture, over: bool) -> Self:
        """A layer from pictures: value, 255 for full utilisation; painted, 255 where the layer covers."""
        file = cv2.imencode(".png", np.dstack([value, value, value, painted]), (cv2.IMWRITE_PNG_COMPRESSION, 1))[1]
        return cls(module=module, png=base64.b64encode(file.tobytes()).decode(), over=over)

    @property
    def pictures(self) -> tuple[Picture, Picture]:
        """Pictures of the value, 255 for full utilisation, and of the cover, 255 where painted."""
        return _pictures(self.png)


@dataclass(frozen=True, eq=False)
class PaintLayer:
    """A painted layer. value: `[n_p]` in 0..1. cover: `[n_p]`, its opacity."""

    value: Tensor
    cover: Tensor
    over: bool

    @classmethod
    def of(cls, params: PaintedParams) -> Self:
        value, cover = (torch.from_numpy(each).flatten().float() / 255 for each in params.pictures)
        return cls(value, cover, params.over)

    def on(self, light: Utilisation, limit: Tensor | float = 1.0) -> Utilisation:
        """The light of a module with the layer: `cover * value + (1 - cover) * u`, `[..., n_p]`, or `cover * value` if over is False.

        limit: `[..., n_p]`, largest value that masks leave.
        """
        cover = self.cover.to(light.u)
        given, band = cover * self.value.to(cover).clamp(max=limit), span(self.cover * self.value != 0)
        if not self.over:
            return Utilisation(given.expand_as(light.u), band)
        return Utilisation(given + (1 - cover) * light.u, None if light.band is None else hull(band, light.band))


def paint_layers(params: Sequence[PaintedParams]) -> Mapping[str, PaintLayer]:
    """The layers by module. Raises LuxloopError for two layers of one module."""
    layers = dict[str, PaintLayer]()
    for k, each in enumerate(params):
        if each.module in layers:
            raise LuxloopError(f"lighting.painted[{k}].module: {each.module!r} is painted twice; give each module one picture")
        layers[each.module] = PaintLayer.of(each)
    return layers


@lru_cache(maxsize=16)
def _pictures(text: str) -> tuple[Picture, Picture]:
    """Grey value and opacity of a picture. Raises LuxloopError if the text is no 8-bit PNG with transparency."""
    try:
        file = base64.b64decode(text, validate=True)
    except binascii.Error as error:
        raise LuxloopError(f"is no base64 text; {REMEDY}") from error
    image = decode(file, "the picture") if file.startswith(b"\x89PNG") else None
    if image is None or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 4:
        raise LuxloopError(f"is no such picture; {REMEDY}")
    return cv2.cvtColor(image, cv2.COLOR_BGRA2GRAY), np.ascontiguousarray(image[..., 3])
