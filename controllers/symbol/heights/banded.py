"""Symmetric band matrices, stored as LAPACK does: `[width, n]`, whose row d holds the elements (j + d, j), and zero where j + d >= n."""

from functools import lru_cache

import torch
from scipy.linalg import solveh_banded
from torch import Tensor


def whole(band: Tensor) -> Tensor:
    """The whole matrix `[n, n]`."""
    width, n = band.shape
    matrix = band.new_zeros(n * (n + width))
    # Element (j, j + d) at d + j (n + 1), (j + d, j) at d n + j (n + 1). Those with j + d >= n are zero: of the first, which land in the
    # lower half, the second write over what is in the band.
    matrix.as_strided((width, n), (1, n + 1)).copy_(band)
    matrix.as_strided((width, n), (n, n + 1)).copy_(band)
    return matrix[: n * n].view(n, n)


def band_of(matrix: Tensor, width: int) -> Tensor:
    """Main diagonal and the width - 1 below it of a symmetric matrix `[n, n]`."""
    places, there = _places(width, len(matrix), matrix.device)
    return matrix.flatten()[places] * there


def solve(band: Tensor, right: Tensor) -> Tensor:
    """The `x [n]` with `A x = right [n]` of a positive definite band matrix A."""
    if band.device.type != "cpu":
        return solve_whole(whole(band), right)
    return torch.from_numpy(solveh_banded(band.numpy(), right.numpy(), lower=True, check_finite=False))


def solve_whole(matrix: Tensor, right: Tensor) -> Tensor:
    """The same of a matrix `[n, n]`."""
    return torch.cholesky_solve(right[:, None], torch.linalg.cholesky(matrix))[:, 0]


@lru_cache(maxsize=4)
def _places(width: int, n: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Where the elements (j + d, j) `[width, n]` are in a flattened matrix `[n, n]`, and which of them are in it."""
    d, j = torch.arange(width, device=device)[:, None], torch.arange(n, device=device)
    return (d * n + j * (n + 1)).clamp(max=n * n - 1), d + j < n
