"""Band matrices are the whole ones."""

import torch

from controllers.symbol.heights import banded

N, WIDTH = 30, 6


def matrix(device: torch.device) -> torch.Tensor:
    """Positive definite, and zero beyond its band."""
    root = torch.randn(N, N, generator=torch.Generator().manual_seed(1), dtype=torch.float64).to(device)
    root = root.tril().triu(-(WIDTH - 1))
    return root @ root.T + torch.eye(N, dtype=torch.float64, device=device)


def test_a_band_holds_all_of_its_matrix(device: torch.device) -> None:
    A, ends = matrix(device), torch.ones(WIDTH, N, device=device).flip(1).cumsum(1).flip(1)
    band = banded.band_of(A, WIDTH)
    there = ends > torch.arange(WIDTH, device=device)[:, None]  # elements (j + d, j) with j + d < N
    assert torch.equal(banded.whole(band * there), A)


def test_bands_are_solved_as_whole_matrices(device: torch.device) -> None:
    A, right = matrix(device), torch.linspace(-1, 1, N, dtype=torch.float64, device=device)
    by_band = banded.solve(banded.band_of(A, WIDTH), right)
    torch.testing.assert_close(by_band, torch.linalg.solve(A, right))
    torch.testing.assert_close(banded.solve_whole(A, right), by_band)
