"""Symbol extraction by differential imaging (T 9.4.1): a symbol image, or the reason why there is none."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Annotated, Any, Literal

import torch
from pydantic import Field, Tag
from torch import Tensor
from torch.nn.functional import avg_pool2d, pad

from perception.camera import CameraParams, luminance_of, noise_std
from world import plugin
from world.errors import LuxloopError
from world.params import Params

NEIGHBOURHOOD = (3, 7)  # rows, columns in px: wider than an edge, narrower than the change of light over a symbol
WHOLLY_LIT = 0.6  # of the brightest contrast nearby: above, a pixel counts wholly and the noise of the symbol's inside does not matter


class Loss(IntEnum):
    """Why a symbol was lost; SEEN is none. COVERED: other light of the lamps takes too much of its own to measure it."""

    SEEN = 0
    NO_FRAME = 1
    NOTHING = 2
    TOO_SMALL = 3
    TOO_LARGE = 4
    COVERED = 5


class SearchParams(Params):
    """What is told from noise and glare, and where it is looked for."""

    threshold_sigma: float = Field(
        5.0, gt=0, le=1e6, description="least difference on - off, in standard deviations of the noise without a symbol"
    )
    footprint_margin_m: float = Field(
        0.15, ge=0, le=10_000, description="unevenness of the road that the predicted footprint allows for, up and down"
    )
    nothing_below: float = Field(0.08, ge=0, lt=1, description="share of the expected area below which there is no symbol at all")
    area_low: float = Field(0.45, ge=0, lt=1, description="least share of the expected area that is taken for the symbol")
    area_high: float = Field(1.9, gt=1, le=1e6, description="largest multiple of the expected area that is taken for the symbol")


class ExtractionParams(SearchParams):
    """How a symbol is told from noise and glare."""

    kind: Literal["differential"] = "differential"
    edges: Literal["grey", "binary", "soft"] = Field(
        "grey", description="grey: by lit share; binary: every lit pixel wholly; soft: by a sigmoid as wide as the noise"
    )


class OwnExtractionParams(SearchParams):
    """`Name(**options)` of a module of the user's own makes the extractor, whose `symbol_image(contrast, limit)` is that of this module."""

    kind: plugin.OwnName
    options: dict[str, Any] = Field({}, description="keyword arguments of Name")

    @cached_property
    def extractor(self) -> Any:
        """Raises LuxloopError where there is none, it does not take its options, or lacks the method."""
        return plugin.make(self.kind, "extraction.kind", {}, self.options, ("symbol_image",))

    def symbol_image(self, contrast: Tensor, limit: Tensor) -> Tensor:
        """The extractor's. Raises LuxloopError where that is no image of the same size."""
        symbol = self.extractor.symbol_image(contrast, limit)
        if not isinstance(symbol, Tensor) or _like(symbol) != _like(contrast):
            what = f"symbol_image gives {_like(symbol) if isinstance(symbol, Tensor) else type(symbol).__name__} for {_like(contrast)}"
            raise LuxloopError(f"extraction.kind: {self.kind}: {what}; give an image like that")
        return symbol


def _like(image: Tensor) -> str:
    return f"{image.dtype} {list(image.shape)} on {image.device}"


Extraction = Annotated[
    Annotated[ExtractionParams, Tag("differential")] | Annotated[OwnExtractionParams, Tag(plugin.OWN)],
    plugin.known_or_own("kind", "differential"),
]


@dataclass(frozen=True)
class Crop:
    """A rectangle of the camera image.

    v_start, v_stop: first row and the row after the last. u_start, u_stop: first column and the column after the last.
    """

    v_start: int
    v_stop: int
    u_start: int
    u_stop: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Row and column slices of an image's last two dimensions."""
        return slice(self.v_start, self.v_stop), slice(self.u_start, self.u_stop)


def difference(on: Tensor, off: Tensor, camera: CameraParams) -> Tensor:
    """Signed luminance difference in cd/m^2 of two frames of digital numbers `[..., h, w]` (T 9.4.1)."""
    return luminance_of(on, camera) - luminance_of(off, camera)


def threshold(off: Tensor, camera: CameraParams, params: SearchParams) -> Tensor:
    """Absolute threshold in cd/m^2 a pixel `[..., h, w]`, from the noise that two frames without a symbol would differ by.

    The light without a symbol is the mean of the off frame over 3 x 3 pixels: a pixel of its own that happens to be dark would claim too
    little noise, and then let a thousand times as much of it pass as five sigma promise.
    """
    light = luminance_of(off, camera)
    mean = avg_pool2d(light.reshape(-1, 1, *light.shape[-2:]), 3, stride=1, padding=1, count_include_pad=False)
    return noise_limit(mean.reshape(light.shape), camera, params)


def noise_limit(light: Tensor, camera: CameraParams, params: SearchParams) -> Tensor:
    """Threshold `[..., h, w]` in cd/m^2 for the difference of two frames that both see this light `[..., h, w]` in cd/m^2."""
    return params.threshold_sigma * 2**0.5 * noise_std(light, camera)


def symbol_image(contrast: Tensor, limit: Tensor, params: Extraction) -> Tensor:
    """Symbol image `[..., h, w]` in 0..1 from luminance contrast and threshold, both `[..., h, w]` in cd/m^2.

    Binary edges: what exceeds the threshold counts wholly. Grey edges: it counts by its lit share, from nothing at the threshold to wholly
    near the brightest contrast around it, so that edges are known to a fraction of a pixel, and yet bright faces do not outweigh dark ones.
    Soft edges: a sigmoid as wide as the noise in place of the threshold.
    """
    if isinstance(params, OwnExtractionParams):
        return params.symbol_image(contrast, limit)
    if params.edges == "soft":
        return torch.sigmoid((contrast - limit) * (params.threshold_sigma / limit))
    if params.edges == "binary":
        return (contrast > limit).to(contrast)
    brightest = _largest_around(contrast)
    return ((contrast - limit) / torch.maximum(WHOLLY_LIT * brightest - limit, limit / 2)).clamp(0, 1)


def _largest_around(image: Tensor) -> Tensor:
    """Maximum of an image `[..., h, w]` over the neighbourhood of each pixel. Windows that double are far faster than max_pool2d."""
    rows, columns = NEIGHBOURHOOD
    image = pad(image, (columns // 2, columns // 2, rows // 2, rows // 2), value=-torch.inf)
    for dim, size in ((-2, rows), (-1, columns)):
        reach = 1
        while reach < size:
            step = min(reach, size - reach)
            length = image.shape[dim] - step
            image = torch.maximum(image.narrow(dim, 0, length), image.narrow(dim, step, length))
            reach += step
    return image


def gate(area: Tensor, expected: Tensor, params: SearchParams) -> Tensor:
    """Loss codes `[...]` int64 by comparing the symbol's area with the expected one, both `[...]` in the same unit."""
    ratio = torch.nan_to_num(area / expected)
    code = torch.full(ratio.shape, Loss.SEEN, dtype=torch.int64, device=ratio.device)
    code = torch.where(ratio > params.area_high, Loss.TOO_LARGE, code)
    code = torch.where(ratio < params.area_low, Loss.TOO_SMALL, code)
    return torch.where(ratio < params.nothing_below, Loss.NOTHING, code)
