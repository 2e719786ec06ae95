"""Sparse products against scipy, and their gradient against differences."""

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from luxloop.world.spmv import Csr, multiply, numbers, segment_bounds
from tests.world.spmv_matrices import matrices, random_matrix


def close(actual: torch.Tensor, expected: np.ndarray) -> None:
    # float64 sums of at most 30 numbers in 0..1.
    np.testing.assert_allclose(actual.cpu(), expected, rtol=1e-13, atol=1e-13)


@settings(deadline=None)
@given(matrices, st.data())
def test_products_are_those_of_scipy(matrix: sp.csr_array, data: st.DataObject) -> None:
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


@settings(deadline=None)
@given(matrices, st.data())
def test_a_part_has_the_chosen_rows_and_columns(matrix: sp.csr_array, data: st.DataObject) -> None:
    rows, columns = (sorted(data.draw(st.sets(st.integers(0, n - 1), max_size=n))) if n else [] for n in matrix.shape)
    number = [numbers(torch.tensor(chosen, dtype=torch.int64), n) for chosen, n in zip((rows, columns), matrix.shape, strict=True)]
    part = Csr.from_scipy(matrix, torch.float64).part(*number, (len(rows), len(columns)))
    assert (part.n_rows, part.n_cols) == (len(rows), len(columns))
    close(torch.from_numpy(part.to_scipy().toarray()), matrix.toarray()[np.ix_(rows, columns)])


def test_duplicates_are_summed() -> None:
    matrix = sp.csr_matrix(([1.0, 2.0], [0, 0], [0, 2]), shape=(1, 1))
    assert Csr.from_scipy(matrix).values.tolist() == [3.0]


@pytest.mark.parametrize("batch", [(), (3,)])
def test_gradient_is_the_transpose(batch: tuple[int, ...]) -> None:
    csr = Csr.from_scipy(random_matrix(1, 7, 5, 0.4), torch.float64)
    x = torch.rand(*batch, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(1), requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: multiply(csr, x), (x,))
    assert torch.autograd.gradgradcheck(lambda x: multiply(csr, x) ** 2, (x,))


def test_bounds_of_segments() -> None:
    first, last = segment_bounds(torch.tensor([2, 0, 2, 2]), torch.tensor([5, 7, 3, 4]), 3)
    assert first.tolist() == [7, torch.iinfo(torch.int64).max, 3]
    assert last.tolist() == [7, -1, 5]
