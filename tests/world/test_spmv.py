"""Sparse products, their memory, and utilisations that come closest to wanted light."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from luxloop.world.spmv import LARGE, Csr, multiply, solve, zeros
from tests.world.spmv_matrices import matrices, random_matrix


def close(actual: torch.Tensor, expected: np.ndarray) -> None:
    # float64 sums of at most 30 numbers in 0..1.
    np.testing.assert_allclose(actual.cpu(), expected, rtol=1e-13, atol=1e-13)


@given(matrices, st.data())
def test_products_are_those_of_scipy(matrix, data):
    csr = Csr.from_scipy(matrix, torch.float64)
    x = torch.linspace(0, 1, 2 * 3 * matrix.shape[1], dtype=torch.float64).view(2, 3, -1)
    expected = x.numpy() @ matrix.T.toarray()
    close(multiply(csr, x), expected)
    close(multiply(csr, x[0, 0]), expected[0, 0])
    close(multiply(csr.transpose, torch.ones(csr.n_rows, dtype=torch.float64)), matrix.sum(0))

    start = data.draw(st.integers(0, csr.n_rows))
    stop = data.draw(st.integers(start, csr.n_rows))
    close(multiply(csr.band(start, stop), x), expected[..., start:stop])
    close(multiply(csr.band(start, stop), x[0, 0]), expected[0, 0, start:stop])


@given(matrices, st.data())
def test_a_part_has_the_chosen_rows_and_columns(matrix, data):
    rows, columns = (sorted(data.draw(st.sets(st.integers(0, n - 1), max_size=n))) if n else [] for n in matrix.shape)
    part = Csr.from_scipy(matrix, torch.float64).part(*(torch.tensor(chosen, dtype=torch.int64) for chosen in (rows, columns)))
    assert (part.n_rows, part.n_cols) == (len(rows), len(columns))
    close(torch.from_numpy(part.to_scipy().toarray()), matrix.toarray()[np.ix_(rows, columns)])


def test_duplicates_are_summed():
    matrix = sp.csr_matrix(([1.0, 2.0], [0, 0], [0, 2]), shape=(1, 1))
    assert Csr.from_scipy(matrix).values.tolist() == [3.0]


@pytest.mark.parametrize("batch", [(), (3,)])
def test_gradient_is_the_transpose(batch):
    csr = Csr.from_scipy(random_matrix(1, 7, 5, 0.4), torch.float64)
    x = torch.rand(*batch, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(1), requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: multiply(csr, x), (x,))
    assert torch.autograd.gradgradcheck(lambda x: multiply(csr, x) ** 2, (x,))


@pytest.mark.skipif(sys.platform != "linux", reason="large pages are asked for on Linux")
def test_large_arrays_lie_in_large_pages():
    pages = Path("/sys/kernel/mm/transparent_hugepage/enabled")
    if not pages.exists() or "[never]" in pages.read_text():
        pytest.skip("this system gives none")
    used = torch.ones(16 * LARGE, dtype=torch.uint8)  # small pages, for malloc to hand out again
    del used
    tensor = zeros((16 * LARGE,), torch.uint8, torch.device("cpu")).fill_(1)
    for mapping in re.split(r"^(?=[0-9a-f]+-[0-9a-f]+ )", Path("/proc/self/smaps").read_text(), flags=re.M)[1:]:
        low, high = (int(part, 16) for part in mapping.split(" ", 1)[0].split("-"))
        if low <= tensor.data_ptr() < high:
            assert "hg" in mapping.rpartition("VmFlags:")[2].split()
            return
    pytest.fail("the array is in no mapping")


def problem(seed: int, m: int = 60, n: int = 25, signed: bool = False) -> tuple[sp.csr_array, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    dense = rng.random((m, n)) * (rng.random((m, n)) < 0.3)
    if signed:
        dense *= rng.choice([-1, 1], (m, n))
    return sp.csr_array(dense), 3 * rng.random(m) - 0.5, 0.2 + rng.random(m)


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), signed=st.booleans(), highest=st.sampled_from([0.4, 1.0]))
def test_the_optimum_is_scipys(seed, signed, highest):
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


def test_values_between_bounds_cost_nothing_and_bounds_hold_where_they_can():
    matrix = Csr.from_scipy(sp.csr_array(np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])), torch.float64)
    inf = float("inf")
    low = torch.tensor([0.2, 0.5, -inf], dtype=torch.float64)
    high = torch.tensor([inf, inf, 0.3], dtype=torch.float64)
    u = solve(matrix, (low, high), iterations=2000, tolerance=1e-9)
    light = multiply(matrix, u)
    assert bool((light >= low - 1e-6).all()) and bool((light <= high + 1e-6).all())
    welcome = torch.tensor([0.8, 0.25], dtype=torch.float64)
    assert torch.equal(solve(matrix, (low, high), start=welcome), welcome)
