"""What both ways of mapping share: the band of pixels that may change, and the sums that reduction takes (T eq. 7.4.5)."""

from dataclasses import dataclass

from torch import Tensor

from controllers.pixels.pixel_major import PixelMajor
from controllers.pixels.windows import Window
from world.texels import TexelGrid

MOST = 0.7  # of all pixels: from here on a part of a matrix costs more than it spares


@dataclass(frozen=True)
class Sums:
    """Of each pixel of a band, all `[..., band]`: numerator and denominator of T eq. 7.4.5 over its rays of finite weight, the denominator
    None where it is one; the same over its rays of infinite weight, None where there are none; and how many of its setpoints are lit.
    ruled_from: a weight from which on it is infinite and its light zero, None where that is told apart.
    """

    light: Tensor
    weight: Tensor | None
    forced_light: Tensor | None = None
    forced_weight: Tensor | None = None
    lit: Tensor | None = None
    ruled_from: float | None = None


@dataclass(frozen=True)
class Band:
    """The contiguous pixels with texels in some texture rows, and all texture rows that those pixels have."""

    pixels: slice
    rows: slice

    @classmethod
    def touched(cls, pixels: PixelMajor, w: Window) -> "Band":
        """For the rows of a window."""
        grid = pixels.grid
        if w.empty:
            return cls(slice(0, 0), slice(0, 0))
        if (w.row_start, w.row_stop) == (0, grid.rows):
            return cls(slice(0, grid.n_pixels), slice(0, grid.rows))
        first = min(int(pixels.pixel_first[w.row_start : w.row_stop].min()), grid.n_pixels)
        band = slice(first, max(int(pixels.pixel_last[w.row_start : w.row_stop].max()) + 1, first))
        if band.stop - band.start > MOST * grid.n_pixels:
            return cls(slice(0, grid.n_pixels), slice(0, grid.rows))
        if band.stop == band.start:
            return cls(band, slice(w.row_start, w.row_stop))
        low = min(int(pixels.row_first[band].min()), w.row_start)
        return cls(band, slice(low, max(int(pixels.row_last[band].max()) + 1, w.row_stop)))

    def blank(self, like: Tensor, batch: tuple[int, ...], grid: TexelGrid, filled: float) -> Tensor:
        """An image `[..., rows, cols]` of the texture, filled in these rows; beyond them it is undefined and never read."""
        texture = like.new_empty(*batch, grid.rows, grid.cols)
        texture[..., self.rows, :].fill_(filled)  # an assignment takes three times as long
        return texture

    def texture(self, image: Tensor, w: Window, grid: TexelGrid, beside: float = 0.0) -> Tensor:
        """Texels `[..., rows * cols]` of an image on a window, a constant beside it."""
        texture = self.blank(image, tuple(image.shape[:-2]), grid, beside)
        texture[..., *w.slices] = image
        return texture.flatten(-2)
