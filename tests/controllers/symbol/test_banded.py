"""Solutions in bands are those of whole matrices."""

import pytest
import torch

from luxloop.controllers.symbol.heights import registration


@pytest.mark.parametrize(("n", "width"), [(30, 6), (8, 6), (6, 6)])  # a band that is narrow, and one of a grid of two rows
def test_bands_are_solved_as_whole_matrices(n, width, device):
    root = torch.randn(n, n, generator=torch.Generator().manual_seed(1), dtype=torch.float64).to(device).tril().triu(-(width - 1))
    A = root @ root.T + torch.eye(n, dtype=torch.float64, device=device)  # positive definite, and zero beyond its band
    band = torch.stack([torch.nn.functional.pad(A.diagonal(-d), (0, d)) for d in range(width)])
    right = torch.linspace(-1, 1, 2 * n, dtype=torch.float64, device=device).view(n, 2)
    torch.testing.assert_close(registration.solve(band, right), torch.linalg.solve(A, right))
