"""Sampling weights of a pixel's texels: supersampling patterns and simplified pixels (T 3.2, 3.5.1, 8.5)."""

from typing import Literal

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from luxloop.world.spmv import Csr, row_of_entries
from luxloop.world.texels import TexelGrid

Sampling = Literal["all", "brightest", "centroid", "uniform", "rotated", "n_rooks", "quincunx"]

EXTENT = 0.5  # a pixel's rectangle bounds its texels of at least this share of its maximum
FAINT = 1e-3  # share of the pixel's maximum given to texels of its rectangle that the real pixel does not light

# Sample positions within a pixel's rectangle, along columns and rows in 0..1, and weights.
_TILT = np.arctan(0.5)
_PATTERNS: dict[str, list[tuple[float, float, float]]] = {
    "uniform": [(c, r, 1.0) for r in (0.25, 0.75) for c in (0.25, 0.75)],
    "rotated": [(0.5 + 0.395 * np.cos(_TILT + k * np.pi / 2), 0.5 + 0.395 * np.sin(_TILT + k * np.pi / 2), 1.0) for k in range(4)],
    "n_rooks": [(0.125, 0.625, 1.0), (0.375, 0.125, 1.0), (0.625, 0.875, 1.0), (0.875, 0.375, 1.0)],
    "quincunx": [(0.5, 0.5, 0.5), *((c, r, 0.125) for r in (0.0, 1.0) for c in (0.0, 1.0))],
}


def sample_weights(entries: Csr, grid: TexelGrid, sampling: Sampling) -> Tensor:
    """Sampling weight `[nnz]` of each entry of a pixel-major headlight matrix `[n_p, n_t]`: how much its texel counts for its pixel.

    brightest, centroid: one sample per pixel; of several brightest texels, the one nearest to their centre. uniform, rotated, n_rooks: four
    samples in the pixel's rectangle. quincunx: its centre with 1/2 and its corners, which neighbours share, with 1/8. A sample falls on the
    nearest texel that the pixel reaches.
    """
    values = entries.values.double()
    if sampling == "all":
        return torch.ones_like(entries.values)
    pixel = row_of_entries(entries)
    row, col = _places(entries, grid)
    peak = _of_pixels(values, pixel, entries.n_rows, "amax")[pixel]
    if sampling in ("brightest", "centroid"):
        mass = values if sampling == "centroid" else (values == peak).double()
        total = _of_pixels(mass, pixel, entries.n_rows, "sum")[pixel]
        middle = [_of_pixels(mass * at, pixel, entries.n_rows, "sum")[pixel] / total for at in (row, col)]  # sum m_i x_i / sum m_i, [nnz]
        away = (row - middle[0]) ** 2 + (col - middle[1]) ** 2
        return _nearest_entry(torch.where(mass > 0, away, torch.inf), pixel, entries.n_rows).to(entries.values)
    within = values >= EXTENT * peak
    low, high = [], []
    for at in (row, col):
        low.append(_of_pixels(torch.where(within, at, torch.inf), pixel, entries.n_rows, "amin")[pixel] - 0.5)
        high.append(_of_pixels(torch.where(within, at, -torch.inf), pixel, entries.n_rows, "amax")[pixel] + 0.5)
    weight = torch.zeros_like(values)
    for across, down, share in _PATTERNS[sampling]:
        r, c = low[0] + down * (high[0] - low[0]), low[1] + across * (high[1] - low[1])
        weight += share * _nearest_entry((row - r) ** 2 + (col - c) ** 2, pixel, entries.n_rows)  # w_ij += share of the sample, [nnz]
    return weight.to(entries.values)


def rectangular(entries: Csr, grid: TexelGrid, threshold: float) -> Csr:
    """Pixels `[n_p, n_t]` simplified to bounding rectangles of their texels of at least `threshold` times their maximum (T 3.5.1, 8.5).

    Inside, texels that the pixel does not reach get a little light, taken from the others; outside, the pixel has none.
    """
    matrix = entries.to_scipy().tocsr()
    rows, cols, data = [], [], []
    for j in range(entries.n_rows):
        mine = slice(matrix.indptr[j], matrix.indptr[j + 1])
        texel, value = matrix.indices[mine], matrix.data[mine].astype(np.float64)
        if not len(texel):
            continue
        r, c = np.divmod(texel[value >= threshold * value.max()], grid.cols)
        box = np.zeros((r.max() - r.min() + 1, c.max() - c.min() + 1))
        at_r, at_c = texel // grid.cols - r.min(), texel % grid.cols - c.min()
        inside = (at_r >= 0) & (at_r < box.shape[0]) & (at_c >= 0) & (at_c < box.shape[1])
        box[at_r[inside], at_c[inside]] = value[inside]
        total = box.sum()
        box[box == 0] = FAINT * value.max()
        box *= total / box.sum()
        r_box, c_box = np.indices(box.shape)
        rows.append(np.full(box.size, j))
        cols.append(((r_box + r.min()) * grid.cols + c_box + c.min()).ravel())
        data.append(box.ravel())
    shape = (entries.n_rows, entries.n_cols)
    coo = sp.coo_array((np.concatenate(data), (np.concatenate(rows), np.concatenate(cols))), shape) if rows else sp.coo_array(shape)
    return Csr.from_scipy(coo.tocsr(), entries.values.dtype).to(entries.values.device)


def pixel_spread(entries: Csr, grid: TexelGrid) -> tuple[float, float]:
    """Standard deviation of a typical pixel's light in texels, along rows and columns: the median over the pixels."""
    pixel, values = row_of_entries(entries), entries.values.double()
    total = _of_pixels(values, pixel, entries.n_rows, "sum")
    spread = []
    for at in _places(entries, grid):
        mean = _of_pixels(values * at, pixel, entries.n_rows, "sum") / total
        variance = _of_pixels(values * (at - mean[pixel]) ** 2, pixel, entries.n_rows, "sum") / total
        spread.append(float(variance[total > 0].median().sqrt()) if bool((total > 0).any()) else 0.0)
    return spread[0], spread[1]


def _places(entries: Csr, grid: TexelGrid) -> tuple[Tensor, Tensor]:
    """Row and column of every entry's texel."""
    texel = entries.indices.long()
    return (texel // grid.cols).double(), (texel % grid.cols).double()


def _of_pixels(values: Tensor, pixel: Tensor, n_pixels: int, reduction: str) -> Tensor:
    """Sum, least or greatest of the values of each pixel's entries, `[n_p]`."""
    return values.new_zeros(n_pixels).scatter_reduce(0, pixel, values, reduction, include_self=False)


def _nearest_entry(away: Tensor, pixel: Tensor, n_pixels: int) -> Tensor:
    """1 for the first of each pixel's entries at the least distance, else 0: `[nnz]` float64."""
    least = away <= _of_pixels(away, pixel, n_pixels, "amin")[pixel]
    place = torch.arange(len(away), device=away.device)
    first = place.new_full((n_pixels,), len(away)).scatter_reduce(0, pixel, torch.where(least, place, len(away)), "amin")
    return (place == first[pixel]).double()
