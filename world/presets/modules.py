"""From a pixel model to a module's light, with coloured edges if wanted."""

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from luxloop.world.headlight import Headlight
from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.headlight.parametric import BlurredRectangles, GaussianPixels
from luxloop.world.spmv import Csr
from luxloop.world.texels import TexelGrid


def headlight(name: str, model: GaussianPixels | BlurredRectangles, grid: TexelGrid, chromatic_shift: float = 0.0) -> Headlight:
    """A module's light on a texture.

    chromatic_shift: by what share the lens images blue larger than red, about the beam axis (lateral chromatic aberration): a pixel's
    outer edge turns bluish and its inner edge yellowish (T 5.1). Zero: one colour.
    """
    matrix, pixel_rows, pixel_cols = model.matrix(grid)
    chroma = None
    if chromatic_shift:
        channels = [model.matrix(grid, 1 + 0.5 * share * chromatic_shift)[0] for share in (-1, 0, 1)]
        matrix, chroma = _coloured(channels)
    return Headlight(
        name=name,
        matrix=Csr.from_scipy(matrix),
        rows=grid.rows,
        cols=grid.cols,
        left=grid.left,
        right=grid.right,
        bottom=grid.bottom,
        top=grid.top,
        pixel_rows=pixel_rows,
        pixel_cols=pixel_cols,
        chroma=chroma,
    )


def _coloured(channels: list[sp.csr_array]) -> tuple[sp.csr_array, Tensor]:
    """The luminance of three channels, and what of each channel comes with an entry `[3, nnz]`."""
    luminance = sp.csr_array(sum(weight * channel for weight, channel in zip(LUMINANCE, channels, strict=True)))
    luminance.sort_indices()
    number = sp.csr_array((np.arange(1.0, luminance.nnz + 1), luminance.indices, luminance.indptr), luminance.shape)
    chroma = np.zeros((3, luminance.nnz))
    for share, channel in zip(chroma, channels, strict=True):
        ones = sp.csr_array((np.ones(channel.nnz), channel.indices, channel.indptr), channel.shape)
        entry = sp.csr_array(number.multiply(ones))
        entry.sort_indices()
        channel.sort_indices()
        where = entry.data.astype(np.int64) - 1
        share[where] = channel.data / luminance.data[where]
    return luminance, torch.from_numpy(chroma).float()
