"""The idealised lamp: pixels of equal size that hardly overlap."""

import math

import numpy as np
import scipy.sparse as sp

from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr

NOTES = """Published (thesis, T 9.4.3): 332 x 1024 pixels, +-10 deg by +1.5 to -3.5 deg, minimal overlap.
Guessed: 50 kcd over the whole field, pixels of equal pitch on the texture's plane, linear edges 0.2 pitches to either side."""


FLANK = 0.2  # half the width of a pixel's sloping edge, in pixel pitches


def _profile(pixels: int, texels_per_pixel: int) -> sp.csr_array:
    """Trapezoid profile of a line of pixels, `[pixels * texels_per_pixel, pixels]`; the profiles of neighbours add up to one."""
    texel = (np.arange(pixels * texels_per_pixel) + 0.5) / texels_per_pixel
    nearest = np.floor(texel).astype(np.int32)
    row, col, weight = [], [], []
    for offset in (-1, 0, 1):
        pixel = nearest + offset
        w = np.clip((0.5 + FLANK - np.abs(texel - pixel - 0.5)) / (2 * FLANK), 0, 1)
        keep = (w > 0) & (pixel >= 0) & (pixel < pixels)
        row.append(np.flatnonzero(keep).astype(np.int32))
        col.append(pixel[keep])
        weight.append(w[keep])
    shape = (len(texel), pixels)
    return sp.csr_array((np.concatenate(weight), (np.concatenate(row), np.concatenate(col))), shape=shape)


def idealised(
    pixel_rows: int = 332,
    pixel_cols: int = 1024,
    texels_per_pixel: tuple[int, int] = (4, 2),
    half_width_deg: float = 10.0,
    top_deg: float = 1.5,
    bottom_deg: float = -3.5,
    intensity_cd: float = 50_000.0,
) -> Headlight:
    """The thesis' idealised lamp (T 9.4.3): 332 x 1024 pixels, +-10 deg, +1.5 to -3.5 deg, minimal overlap.

    Published: the pixel count, the angles, "minimal overlap". Guessed: 50 kcd over the whole field (about 1.5 klm), pixels of equal
    pitch on the texture's plane, and overlap as linear edges FLANK pitches to either side of a pixel's border, so that a texel has
    1.5 entries. pixel_rows, pixel_cols: their number.
    texels_per_pixel: (rows, columns); at 17 m the symbol spans only 40 pixel rows, so rows are sampled
    four times.
    """
    vertical = _profile(pixel_rows, texels_per_pixel[0])
    horizontal = _profile(pixel_cols, texels_per_pixel[1])
    side = math.tan(math.radians(half_width_deg))
    return Headlight(
        name=f"idealised-{pixel_rows}x{pixel_cols}",
        matrix=Csr.from_scipy(intensity_cd * sp.kron(vertical, horizontal, format="csr")),
        rows=vertical.shape[0],
        cols=horizontal.shape[0],
        left=side,
        right=-side,
        bottom=math.tan(math.radians(bottom_deg)),
        top=math.tan(math.radians(top_deg)),
        pixel_rows=pixel_rows,
        pixel_cols=pixel_cols,
    )


def light(chromatic_shift: float = 0.0) -> Headlight:
    """Raises LuxloopError for coloured edges: this lamp has none."""
    if chromatic_shift:
        raise LuxloopError("the idealised lamp has no coloured edges: leave chromatic_shift at 0")
    return idealised()
