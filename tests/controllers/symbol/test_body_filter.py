"""The body filter's measurements, against Gaussian conditioning in information form."""

import pytest
import torch

from luxloop.controllers.symbol.heights.body_filter import BODY, CELL_M, LEVEL, BodyFilter, BodyParams, exact


@pytest.mark.parametrize("over_wheels", [False, True])
def test_a_measurement_gets_its_share_by_the_covariances(over_wheels):
    cells, drawn = 4, torch.Generator().manual_seed(0)
    n = BODY + 2 * cells
    root = torch.randn(n, n, generator=drawn, dtype=torch.float64)
    P, x = root @ root.T / n + 0.1 * torch.eye(n).double(), torch.randn(n, generator=drawn, dtype=torch.float64)
    before = BodyFilter(BodyParams(), 0.0, 0.0, 20.0, 1.0, 1.0, 0.0, (2.0, -1.0), x, P, 17.0, over_wheels)
    z, variance = exact(torch.tensor([[0.3, -0.1], [0.2, 0.4]])), exact(torch.tensor([[0.5, 1.0], [2.0, 0.2]]))
    after = before.with_road(1.0 + CELL_M * torch.tensor([1.0, 3.0], dtype=torch.float64), z, variance)
    H = torch.zeros(4, n, dtype=torch.float64)
    for row, (side, cell) in enumerate(((1, 1), (1, 3), (-1, 1), (-1, 3))):  # left track: mean + difference / 2, right: mean - that
        H[row, BODY + cell], H[row, BODY + cells + cell] = 1, side / 2
        H[row, LEVEL] = over_wheels * (1.0 + CELL_M * cell - 0.5)  # lever of the pitch then, about the pivot between the axles
    seen = z.flatten() + H[:, LEVEL] * x[LEVEL]
    weighted = H.T / variance.flatten()  # H' R^-1
    information = torch.linalg.inv(P) + weighted @ H
    # Both are exact; inverting a matrix of condition 300 costs three digits of float64's sixteen.
    torch.testing.assert_close(after.covariance, torch.linalg.inv(information), rtol=1e-9, atol=1e-11)
    torch.testing.assert_close(
        after.mean, torch.linalg.solve(information, torch.linalg.solve(P, x) + weighted @ seen), rtol=1e-9, atol=1e-11
    )
