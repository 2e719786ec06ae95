"""Bounded least squares against scipy's solver, and what must hold for any matrix."""

import numpy as np
import scipy.sparse as sp
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from luxloop.world.spmv import Csr, multiply, solve


def problem(seed: int, m: int = 60, n: int = 25, signed: bool = False) -> tuple[sp.csr_array, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    dense = rng.random((m, n)) * (rng.random((m, n)) < 0.3)
    if signed:
        dense *= rng.choice([-1, 1], (m, n))
    return sp.csr_array(dense), 3 * rng.random(m) - 0.5, 0.2 + rng.random(m)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), signed=st.booleans(), highest=st.sampled_from([0.4, 1.0]))
def test_the_optimum_is_scipys(seed: int, signed: bool, highest: float) -> None:
    A, b, w = problem(seed, signed=signed)
    n = A.shape[1]
    expected = lsq_linear((sp.diags_array(w) @ A).toarray(), w * b, (0, highest), tol=1e-14).x
    u = solve(
        Csr.from_scipy(A, torch.float64),
        torch.tensor(b),
        weight=torch.tensor(w),
        upper=torch.full((n,), highest),
        iterations=5000,
        tolerance=1e-10,
    )
    # Random columns may nearly depend on each other; a step of 1e-10 then leaves about 1e-6.
    np.testing.assert_allclose(u, expected, atol=1e-5)
    cost, best = (float(np.sum((w * (A @ x - b)) ** 2)) for x in (u.numpy(), expected))
    assert cost <= best * (1 + 1e-9) + 1e-12


def test_values_between_bounds_cost_nothing_and_bounds_hold_where_they_can() -> None:
    matrix = Csr.from_scipy(sp.csr_array(np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])), torch.float64)
    inf = float("inf")
    low = torch.tensor([0.2, 0.5, -inf], dtype=torch.float64)
    high = torch.tensor([inf, inf, 0.3], dtype=torch.float64)
    u = solve(matrix, (low, high), iterations=2000, tolerance=1e-9)
    light = multiply(matrix, u)
    assert bool((light >= low - 1e-6).all()) and bool((light <= high + 1e-6).all())
    welcome = torch.tensor([0.8, 0.25], dtype=torch.float64)
    assert torch.equal(solve(matrix, (low, high), start=welcome), welcome)
