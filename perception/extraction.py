"""Symbol extraction by differential imaging (T 9.4.1): a symbol image, or the reason why there is none."""

from enum import IntEnum
from functools import cached_property
from typing import Annotated, Any, Literal

import torch
from pydantic import Field
from torch import Tensor
from torch.nn.functional import avg_pool2d, pad

from luxloop.perception.camera import CameraParams, luminance_of, noise_std
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.params import Distance, Params, Positive

NEIGHBOURHOOD = (3, 7)  # rows, columns in px: wider than an edge, narrower than the change of light over a symbol
WHOLLY_LIT = 0.6  # share of the brightest contrast nearby above which a pixel counts fully, so that noise inside the symbol has no effect


class ExtractionStatus(IntEnum):
    """SEEN, or the reason for a missing symbol image. COVERED: other light of the lamps covers too much of the symbol."""

    SEEN = 0
    NO_FRAME = 1
    NOTHING = 2
    TOO_SMALL = 3
    TOO_LARGE = 4
    COVERED = 5


class SearchParams(Params):
    """Detection thresholds and search window."""

    threshold_sigma: Positive = Field(
        5.0, description="detection threshold of the difference on - off, in standard deviations of the noise without a symbol"
    )
    footprint_margin_m: Distance = Field(
        0.15, description="unevenness of the road, up and down, that widens the search window around the predicted footprint"
    )
    visibility_m: float | None = Field(
        None, ge=10, le=100_000, description="visibility that the controller assumes for the symbol's backscatter; left out: clear air"
    )
    nothing_below: float = Field(0.08, ge=0, lt=1, description="share of the expected area below which the symbol counts as absent")
    area_low: float = Field(0.45, ge=0, lt=1, description="least share of the expected area that is accepted as the symbol")
    area_high: float = Field(1.9, gt=1, le=1e6, description="largest multiple of the expected area that is accepted as the symbol")


class ExtractionParams(SearchParams):
    """Extraction of the symbol image from two frames."""

    kind: Literal["differential"] = "differential"
    edges: Literal["grey", "binary", "soft"] = Field(
        "grey", description="weight of pixels: grey: lit share; binary: 1 for every lit pixel; soft: sigmoid as wide as the noise"
    )


class OwnExtractionParams(plugin.OwnPart, SearchParams):
    """A user-defined extractor `Name(**options)`, whose `symbol_image(contrast, limit)` replaces luxloop's."""

    @cached_property
    def extractor(self) -> Any:
        """The user-defined extractor. Raises LuxloopError if it does not exist, refuses its options or lacks the method."""
        return plugin.make(self.kind, "extraction.kind", {}, self.options, ("symbol_image",))

    def symbol_image(self, contrast: Tensor, limit: Tensor) -> Tensor:
        """The extractor's symbol image. Raises LuxloopError if the result is no image of the same size."""
        symbol = self.extractor.symbol_image(contrast, limit)
        if not isinstance(symbol, Tensor) or _like(symbol) != _like(contrast):
            what = f"symbol_image gives {_like(symbol) if isinstance(symbol, Tensor) else type(symbol).__name__} for {_like(contrast)}"
            raise LuxloopError(f"extraction.kind: {self.kind}: {what}; give an image like that")
        return symbol


def _like(image: Tensor) -> str:
    return f"{image.dtype} {list(image.shape)} on {image.device}"


Extraction = Annotated[
    ExtractionParams | OwnExtractionParams,
    plugin.KnownOrOwn("kind", "differential"),
]


def difference(on: Tensor, off: Tensor, camera: CameraParams) -> Tensor:
    """Signed luminance difference in cd/m^2 of two frames of digital numbers `[..., h, w]` (T 9.4.1)."""
    return luminance_of(on, camera) - luminance_of(off, camera)


def threshold(off: Tensor, camera: CameraParams, params: SearchParams) -> Tensor:
    """Absolute threshold `[..., h, w]` in cd/m^2 of each pixel, from the noise of the difference of two frames without a symbol.

    The light without a symbol is the mean of the off frame over 3 x 3 pixels. A single pixel that is dark by chance would underestimate the
    noise, and a thousand times as many pixels would exceed five sigma.
    """
    light = luminance_of(off, camera)
    mean = avg_pool2d(light.reshape(-1, 1, *light.shape[-2:]), 3, stride=1, padding=1, count_include_pad=False)
    return noise_limit(mean.reshape(light.shape), camera, params)


def noise_limit(light: Tensor, camera: CameraParams, params: SearchParams) -> Tensor:
    """Threshold `[..., h, w]` in cd/m^2 for the difference of two frames that both see this light `[..., h, w]` in cd/m^2."""
    return params.threshold_sigma * 2**0.5 * noise_std(light, camera)


def symbol_image(contrast: Tensor, limit: Tensor, params: Extraction) -> Tensor:
    """Symbol image `[..., h, w]` in 0..1 from luminance contrast and threshold, both `[..., h, w]` in cd/m^2.

    Binary edges: pixels above the threshold count 1. Grey edges: pixels count by their lit share, from 0 at the threshold to 1 near the
    brightest contrast around them. Edges are then known to a fraction of a pixel, and bright parts do not outweigh dark ones. Soft edges: a
    sigmoid as wide as the noise replaces the threshold.
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
    """Maximum of an image `[..., h, w]` over each pixel's neighbourhood. Doubling windows are far faster than max_pool2d."""
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
    """Codes of ExtractionStatus `[...]` int64 from the symbol's area and the expected area, both `[...]` in the same unit."""
    ratio = torch.nan_to_num(area / expected)
    code = torch.full(ratio.shape, ExtractionStatus.SEEN, dtype=torch.int64, device=ratio.device)
    code = torch.where(ratio > params.area_high, ExtractionStatus.TOO_LARGE, code)
    code = torch.where(ratio < params.area_low, ExtractionStatus.TOO_SMALL, code)
    return torch.where(ratio < params.nothing_below, ExtractionStatus.NOTHING, code)
