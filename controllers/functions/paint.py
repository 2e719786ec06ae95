"""Utilisations that were painted pixel by pixel: over what the lighting functions give, or in its place (T 4.2.2)."""

import base64
import binascii
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import cv2
import numpy as np
import torch
from pydantic import Field, field_validator
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.world.errors import LuxloopError
from luxloop.world.images import decode
from luxloop.world.params import Params

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
        "what is opaque is painted",
    )
    over: bool = Field(True, description="over what the functions give; false: in its place, dark where nothing is painted")

    @field_validator("png")
    @classmethod
    def _is_one(cls, text: str) -> str:
        """Checked here, so that the key is named; decoded once."""
        try:
            _pictures(text)
        except LuxloopError as error:
            raise ValueError(str(error)) from error
        return text

    @classmethod
    def of(cls, module: str, value: Picture, painted: Picture, over: bool) -> Self:
        """The same from pictures: value, 255 for full utilisation; painted, 255 where it holds."""
        file = cv2.imencode(".png", np.dstack([value, value, value, painted]), (cv2.IMWRITE_PNG_COMPRESSION, 1))[1]
        return cls(module=module, png=base64.b64encode(file.tobytes()).decode(), over=over)

    @property
    def pictures(self) -> tuple[Picture, Picture]:
        """Value, 255 for full utilisation, and painted, 255 where it holds."""
        return _pictures(self.png)


@dataclass(frozen=True, eq=False)
class PaintLayer:
    """A painted layer. value: `[n_p]` in 0..1. cover: `[n_p]`, the share in which it hides what is below. size: rows and columns."""

    value: Tensor
    cover: Tensor
    over: bool
    size: tuple[int, int]

    @classmethod
    def of(cls, params: PaintedParams) -> Self:
        value, cover = (torch.from_numpy(each).flatten().float() / 255 for each in params.pictures)
        rows, columns = params.pictures[0].shape
        return cls(value, cover, params.over, (rows, columns))

    def on(self, light: Utilisation) -> Utilisation:
        """The light of a module under the layer: `cover * value + (1 - cover) * u`, `[..., n_p]`; without u where it is not over it."""
        given, cover = (self.cover * self.value).to(light.u), self.cover.to(light.u)
        lit = given.nonzero()
        band = slice(int(lit[0]), int(lit[-1]) + 1) if len(lit) else slice(0, 0)
        if not self.over:
            return Utilisation(given.expand_as(light.u), band)
        return Utilisation(given + (1 - cover) * light.u, None if light.band is None else _both(band, light.band))


def paint_layers(params: Sequence[PaintedParams]) -> Mapping[str, PaintLayer]:
    """The layers by module. Raises LuxloopError for two of one."""
    layers = dict[str, PaintLayer]()
    for k, each in enumerate(params):
        if each.module in layers:
            raise LuxloopError(f"lighting.painted[{k}].module: {each.module!r} is painted twice; give each module one picture")
        layers[each.module] = PaintLayer.of(each)
    return layers


def _both(one: slice, other: slice) -> slice:
    """The least range that has both."""
    there = [each for each in (one, other) if each.stop > each.start]
    return slice(min(each.start for each in there), max(each.stop for each in there)) if there else slice(0, 0)


@lru_cache(maxsize=16)
def _pictures(text: str) -> tuple[Picture, Picture]:
    """Grey value and opacity of a picture. Raises LuxloopError where it is none."""
    try:
        file = base64.b64decode(text, validate=True)
    except binascii.Error as error:
        raise LuxloopError(f"is no base64 text; {REMEDY}") from error
    image = decode(file, "the picture") if file.startswith(b"\x89PNG") else None
    if image is None or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 4:
        raise LuxloopError(f"is no such picture; {REMEDY}")
    return cv2.cvtColor(image, cv2.COLOR_BGRA2GRAY), np.ascontiguousarray(image[..., 3])
