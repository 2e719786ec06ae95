"""Band matrices are the whole ones."""

import pytest
import torch

from luxloop.controllers.symbol.heights import registration


def matrix(n: int, width: int, device: torch.device) -> torch.Tensor:
    """Positive definite, and zero beyond its band."""
    root = torch.randn(n, n, generator=torch.Generator().manual_seed(1), dtype=torch.float64).to(device)
    root = root.tril().triu(-(width - 1))
    A = root @ root.T + torch.eye(n, dtype=torch.float64, device=device)
    return (A + A.T) / 2  # a product by BLAS is symmetric but for rounding


@pytest.mark.parametrize(("n", "width"), [(30, 6), (8, 6), (6, 6)])  # a band that is narrow, and one of a grid of two rows
def test_bands_are_whole_matrices(n, width, device):
    A, right = matrix(n, width, device), torch.linspace(-1, 1, n, dtype=torch.float64, device=device)
    band = registration.band_of(A, width)
    assert torch.equal(registration.whole(band), A)
    torch.testing.assert_close(registration.solve(band, right), torch.linalg.solve(A, right))
    torch.testing.assert_close(registration.solve_whole(A, right), registration.solve(band, right))
