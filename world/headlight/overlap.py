"""Overlap reduction: fewer pixels per texel, for a cheaper headlight matrix, and the resulting errors (T 5.2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
import torch

from luxloop.world.errors import LuxloopError
from luxloop.world.spmv import Csr

Method = Literal["threshold", "proportional", "least_squares"]
Array = npt.NDArray[np.float64]

# Regularisation towards the proportional solution, as a share of the use cases' energy. A millionth overfits: errors on unseen random
# utilisations were half as large again as with proportional sharing (64 x 256 pixels, 8 a texel); with this value they are alike.
PULL = 0.1
SWEEPS = 100  # of coordinate descent, in rows where least squares turn a value negative
CHUNK_ROWS = 16_384  # bounds the memory of least squares: 16,384 rows of 24 entries in 20 use cases are 60 MB


@dataclass(frozen=True)
class OverlapErrors:
    """Relative errors of a reduced matrix over some use cases.

    rmse: of all texels in all use cases, relative to the root mean square of their intensities. largest: greatest difference at a texel,
    relative to the brightest texel. darkening: mean over the use cases of the lost share of all light, negative where light was added.
    """

    rmse: float
    largest: float
    darkening: float


def strongest(matrix: Csr, keep: int | None = None, bound_cd: float = 0.0) -> npt.NDArray[np.bool_]:
    """Mask `[nnz]` of the kept entries: the `keep` largest of each row (lower columns first at ties) that are at least bound_cd.

    Raises: LuxloopError where keep is less than one or bound_cd negative.
    """
    if keep is not None and keep < 1:
        raise LuxloopError(f"overlap reduction to {keep} pixels a texel: keep at least one, or the lamp is dark")
    if bound_cd < 0:
        raise LuxloopError(f"overlap reduction below {bound_cd:g} cd: the bound must not be negative")
    csr = matrix.to_scipy()
    stays: npt.NDArray[np.bool_] = csr.data >= bound_cd
    if keep is not None:
        length = np.diff(csr.indptr)
        row = np.repeat(np.arange(matrix.n_rows), length)
        order = np.lexsort((csr.indices, -csr.data, row))
        rank = np.empty(len(order), dtype=np.int64)
        rank[order] = np.arange(len(order)) - np.repeat(csr.indptr[:-1], length)
        stays &= rank < keep
    return stays


def reduce(
    matrix: Csr,
    keep: int | None = None,
    method: Method = "proportional",
    use_cases: Sequence[npt.ArrayLike] = (),
    bound_cd: float = 0.0,
) -> Csr:
    """The matrix reduced to the strongest entries of each row, in the same order; computed in float64.

    threshold: the others' intensity is lost. proportional: the row's remaining entries share it in proportion, which keeps the row's sum (T
    eq. 5.2.1, 5.2.2). least_squares: the remaining entries take the non-negative values that come nearest to the row's intensity in the
    use_cases (utilisations `[n_p]`), regularised towards the proportional ones: never worse in these, and equal to the proportional ones
    where no use case decides. A row whose entries are all below bound_cd turns dark.

    Raises: LuxloopError where keep or bound_cd make no sense, or least squares have no use cases of n_p pixels.
    """
    stays = strongest(matrix, keep, bound_cd)
    csr = matrix.to_scipy().astype(np.float64)
    row = np.repeat(np.arange(matrix.n_rows), np.diff(csr.indptr))
    counts = np.bincount(row[stays], minlength=matrix.n_rows)
    indptr = np.concatenate([[0], np.cumsum(counts)])
    reduced = sp.csr_matrix((csr.data[stays], csr.indices[stays], indptr), shape=csr.shape)
    if method != "threshold":
        lost = np.bincount(row[~stays], csr.data[~stays], matrix.n_rows)
        left = np.bincount(row[stays], csr.data[stays], matrix.n_rows)
        reduced.data *= np.repeat(1 + lost / np.where(left > 0, left, 1), counts)
        if method == "least_squares":
            changed = np.flatnonzero((lost > 0) & (left > 0))
            _fit_rows(csr, reduced, changed, _use_case_table(use_cases, matrix.n_cols))
    return Csr(
        torch.from_numpy(reduced.indptr.astype(np.int32)),
        torch.from_numpy(reduced.indices.astype(np.int32)),
        torch.from_numpy(reduced.data).to(matrix.values.dtype),
        matrix.n_cols,
    ).to(matrix.values.device)


def errors(matrix: Csr, reduced: Csr, use_cases: Sequence[npt.ArrayLike]) -> OverlapErrors:
    """Compare the light of a reduced matrix with that of the full one. Raises LuxloopError without use cases of n_p pixels."""
    full, less = (each.to_scipy().astype(np.float64) for each in (matrix, reduced))
    squares = energy = largest = brightest = darkening = 0.0
    cases = _use_case_table(use_cases, matrix.n_cols)
    for u in cases:
        light = full @ u
        difference = less @ u - light
        squares += difference @ difference
        energy += light @ light
        largest = max(largest, np.abs(difference).max(initial=0))
        brightest = max(brightest, light.max(initial=0))
        darkening -= difference.sum() / max(light.sum(), np.finfo(float).tiny) / len(cases)
    tiny = np.finfo(float).tiny
    return OverlapErrors(float(np.sqrt(squares / max(energy, tiny))), float(largest / max(brightest, tiny)), float(darkening))


def standard_use_cases(pixel_rows: int, pixel_cols: int, randoms: int = 8, seed: int = 0) -> list[Array]:
    """Utilisations `[n_p]` relevant for any lamp: all on, a checkerboard and its inverse, and random ones."""
    row, col = np.indices((pixel_rows, pixel_cols)).reshape(2, -1)
    checkerboard = ((row + col) % 2).astype(np.float64)
    generator = np.random.default_rng(seed)
    return [np.ones(len(row)), checkerboard, 1 - checkerboard, *generator.random((randoms, len(row)))]


def _use_case_table(use_cases: Sequence[npt.ArrayLike], n_pixels: int) -> Array:
    cases = np.array([np.asarray(u, dtype=np.float64) for u in use_cases])
    if cases.ndim != 2 or cases.shape[1] != n_pixels:
        shape = f"not {cases.shape}" if len(use_cases) else "but there are none"
        raise LuxloopError(f"use cases are utilisations of {n_pixels} pixels each, {shape}; give at least one, all pixels on for example")
    return cases


def _fit_rows(full: sp.csr_matrix, reduced: sp.csr_matrix, rows: npt.NDArray[np.int64], cases: Array) -> None:
    """Least squares in place on some `rows` of `reduced`; rows of one length are solved together."""
    counts = np.diff(reduced.indptr)[rows]
    for length in np.unique(counts):
        of_length = rows[counts == length]
        for chunk in np.array_split(of_length, -(-len(of_length) // CHUNK_ROWS)):
            entry = reduced.indptr[chunk][:, None] + np.arange(length)
            seen = np.moveaxis(cases[:, reduced.indices[entry]], 0, 1)  # [B, use cases, length]
            wanted = (full[chunk] @ cases.T)[:, :, None]
            reduced.data[entry] = _non_negative(seen, wanted, reduced.data[entry])


def _non_negative(seen: Array, wanted: Array, prior: Array) -> Array:
    """Minimise `|seen x - wanted|^2 + pull |x - prior|^2` over x >= 0; `[B, m, n]`, `[B, m, 1]`, `[B, n]` to `[B, n]`."""
    transposed = seen.transpose(0, 2, 1)
    gram = transposed @ seen
    n = prior.shape[1]
    pull = PULL * np.trace(gram, axis1=1, axis2=2) / n
    pull[pull == 0] = 1.0  # no use case lights these pixels: the prior it is
    gram += pull[:, None, None] * np.eye(n)
    right = (transposed @ wanted)[:, :, 0] + pull[:, None] * prior
    x: Array = np.linalg.solve(gram, right[:, :, None])[:, :, 0]
    bounded = x.min(1) < 0
    if bounded.any():
        x[bounded] = _descend(gram[bounded], right[bounded], prior[bounded])
    return x


def _descend(gram: Array, right: Array, start: Array) -> Array:
    """Coordinate descent of `x.gram.x / 2 - right.x` over x >= 0."""
    x = start.copy()
    for _ in range(SWEEPS):
        for j in range(x.shape[1]):
            slope = np.einsum("bi,bi->b", gram[:, j], x) - right[:, j]
            x[:, j] = np.maximum(x[:, j] - slope / gram[:, j, j], 0)
    return x
