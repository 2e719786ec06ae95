"""Common parts of both mappings: the band of pixels that may change, and the sums for the reduction (T eq. 7.4.5)."""

from dataclasses import dataclass

from torch import Tensor

from luxloop.controllers.pixels.pixel_major import PixelMajor
from luxloop.controllers.pixels.windows import Window
from luxloop.world.spmv import span_of
from luxloop.world.texels import TexelGrid

MOST = 0.7  # share of all pixels from which on a part of the matrix costs more than it saves


@dataclass(frozen=True)
class Sums:
    """Sums of each pixel in a band, `[..., band]` each. light, weight: numerator and denominator of T eq. 7.4.5 over rays of finite weight;
    weight is None if it is 1. forced_light, forced_weight: the same over rays of infinite weight, None if there are none. lit: number of
    lit setpoints. ruled_from: a weight from here on stands for an infinite one of a zero setpoint; None if infinite weights are summed
    separately.
    """

    light: Tensor
    weight: Tensor | None
    forced_light: Tensor | None = None
    forced_weight: Tensor | None = None
    lit: Tensor | None = None
    ruled_from: float | None = None


@dataclass(frozen=True)
class Band:
    """A contiguous range of pixels that reach some texture rows, and all texture rows that these pixels reach."""

    pixels: slice
    rows: slice

    @classmethod
    def touched(cls, pixels: PixelMajor, w: Window) -> "Band":
        """The band of the pixels that reach the rows of a window."""
        grid = pixels.grid
        if w.empty:
            return cls(slice(0, 0), slice(0, 0))
        if (w.row_start, w.row_stop) == (0, grid.rows):
            return cls(slice(0, grid.n_pixels), slice(0, grid.rows))
        low, high = span_of(pixels.pixel_first, pixels.pixel_last, slice(w.row_start, w.row_stop))
        first = min(low, grid.n_pixels)
        band = slice(first, max(high + 1, first))
        if band.stop - band.start > MOST * grid.n_pixels:
            return cls(slice(0, grid.n_pixels), slice(0, grid.rows))
        if band.stop == band.start:
            return cls(band, slice(w.row_start, w.row_stop))
        low, high = span_of(pixels.row_first, pixels.row_last, band)
        return cls(band, slice(min(low, w.row_start), max(high + 1, w.row_stop)))

    def blank(self, like: Tensor, batch: tuple[int, ...], grid: TexelGrid, filled: float) -> Tensor:
        """An image `[..., rows, cols]` of the texture, filled in the band's rows; the other rows are undefined and never read."""
        texture = like.new_empty(*batch, grid.rows, grid.cols)
        texture[..., self.rows, :].fill_(filled)  # three times as fast as an assignment
        return texture

    def texture(self, image: Tensor, w: Window, grid: TexelGrid, beside: float = 0.0) -> Tensor:
        """Texels `[..., rows * cols]` of an image on a window, with a constant outside it."""
        texture = self.blank(image, tuple(image.shape[:-2]), grid, beside)
        texture[..., *w.slices] = image
        return texture.flatten(-2)
