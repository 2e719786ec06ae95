"""Every format gives the product of the dense matrix, and stores what the thesis says."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from sparse import scipy_window
from sparse.formats import FORMATS, build, candidates
from sparse.padded import Sell
from sparse.protocol import SparseFormat, Storage
from sparse.scipy_window import ScipyWindow

from luxloop.world.errors import LuxloopError
from luxloop.world.spmv import Csr
from tests.world.spmv_matrices import matrices, random_matrix

each_format = pytest.mark.parametrize("name", FORMATS)

# 6 x 4, rows of 0, 2, 1, 0, 3 and 0 entries.
BY_HAND = np.array([[0, 0, 0, 0], [1, 0, 2, 0], [0, 3, 0, 0], [0, 0, 0, 0], [4, 0, 5, 6], [0, 0, 0, 0]], dtype=np.float64)


def matrix(dense: np.ndarray) -> Csr:
    return Csr.from_scipy(sp.csr_matrix(dense), torch.float64)


def stored(form: SparseFormat) -> int:
    """Cells of a padded or packed format, from its tensors."""
    if isinstance(form, ScipyWindow):
        return sum(part.nnz for _, _, part in form.parts)
    values = form.values if hasattr(form, "values") else form.csr.values
    return values.numel()


@each_format
@settings(deadline=None, max_examples=50)
@given(matrices)
def test_products_are_those_of_the_dense_matrix(name: str, sparse: sp.csr_array) -> None:
    form = build(Csr.from_scipy(sparse, torch.float64), name)
    x = torch.linspace(0.1, 1, 2 * 3 * sparse.shape[1], dtype=torch.float64).view(2, 3, -1)
    expected = x.numpy() @ sparse.toarray().T
    # float64 sums of at most 30 numbers in 0..1.
    np.testing.assert_allclose(form.multiply(x), expected, rtol=1e-13, atol=1e-13)
    garbage = torch.full(expected.shape, torch.nan, dtype=torch.float64)
    np.testing.assert_allclose(form.multiply(x, out=garbage), expected, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(form.refresh(2 * x, garbage), 2 * expected, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(form.multiply(x[0, 0]), expected[0, 0], rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(form.multiply(torch.stack([x, -x], -1)[0, 0, :, 0]), expected[0, 0], rtol=1e-13, atol=1e-13)
    assert stored(form) == form.storage.values


@pytest.mark.parametrize(
    ("name", "storage"),
    [
        ("coo", Storage(6, 6, 6)),  # 2 indices an entry
        ("csr", Storage(6 + 1, 6, 6)),  # n_t + 1
        ("window", Storage(4 + 2, 6, 6)),  # rows 1 to 4: an offset each, one at the end, and where they start
        ("scipy", Storage(4 + 2, 6, 6)),
        ("submatrix", Storage(2 * 3 + 1, 6, 6)),  # 2 n_gz + 1
        ("lgc", Storage(3 * 3, 6, 6)),  # 3 n_gz
        ("ell", Storage(0, 6 * 3, 6 * 3)),  # n_t times the longest
        ("sell", Storage(1 + 1, 32 * 3, 32 * 3)),  # one slice, padded
        # One tile of three rows and all four columns: its width, the first row and the last sum, and the places of rows 1 to 4.
        ("tiles", Storage(4 + 3, 4, 32 * 4)),
        ("tiles64", Storage(4 + 3, 4, 64 * 4)),
    ],
)
def test_storage_counted_by_hand(name: str, storage: Storage) -> None:
    assert FORMATS[name].count(matrix(BY_HAND)) == storage
    assert build(matrix(BY_HAND), name).storage == storage
    assert storage.bytes(torch.float64) == 4 * (storage.row_indices + storage.column_indices) + 8 * storage.values


@settings(deadline=None)
@given(matrices)
def test_storage_is_what_the_thesis_says(sparse: sp.csr_array) -> None:
    csr = Csr.from_scipy(sparse, torch.float64)
    lengths = (sparse.toarray() != 0).sum(1)
    lit, nnz = (lengths > 0).sum(), lengths.sum()
    assert FORMATS["coo"].count(csr).index_count == 2 * nnz
    assert FORMATS["csr"].count(csr).row_indices == len(lengths) + 1
    assert FORMATS["submatrix"].count(csr).row_indices == 2 * lit + 1
    assert FORMATS["lgc"].count(csr).row_indices == 3 * lit
    assert FORMATS["ell"].count(csr).column_indices == len(lengths) * lengths.max()


@settings(deadline=None)
@given(matrices, st.integers(1, 8))
def test_slices_of_any_height(sparse: sp.csr_array, height: int) -> None:
    csr = Csr.from_scipy(sparse, torch.float64)
    form = Sell(csr, height)
    x = torch.linspace(0.1, 1, csr.n_cols, dtype=torch.float64)
    np.testing.assert_allclose(form.multiply(x), sparse @ x.numpy(), rtol=1e-13, atol=1e-13)
    lengths = (sparse.toarray() != 0).sum(1)
    slices = [lengths[start : start + height] for start in range(0, len(lengths), height)]
    assert form.storage.row_indices == len(slices) + 1
    assert form.storage.values == sum(height * part.max() for part in slices) == len(form.values)


def test_a_uniformly_blurred_lamp_costs_sell_nothing() -> None:
    csr = matrix(np.kron(np.eye(16), np.ones((4, 3))))
    assert Sell.count(csr, 4).values == len(csr.values)


@each_format
def test_float32_on_every_device(name: str, device: torch.device) -> None:
    sparse = random_matrix(2, 200, 100, 0.1)
    csr = Csr.from_scipy(sparse).to(device)
    if name == "scipy" and device.type != "cpu":
        with pytest.raises(LuxloopError, match="format 'scipy' is for the CPU"):
            build(csr, name)
        return
    form = build(csr, name)
    x = torch.linspace(0, 1, 100, device=device)
    y = form.multiply(x)
    assert (y.dtype, y.device.type) == (torch.float32, device.type)
    # Sums of ten float32 products.
    np.testing.assert_allclose(y.cpu(), sparse @ x.cpu().double().numpy(), rtol=1e-5, atol=1e-6)


@each_format
@pytest.mark.parametrize("shape", [(3, 2), (1, 5), (0, 3), (3, 0), (0, 0)])
def test_matrices_without_entries(name: str, shape: tuple[int, int]) -> None:
    form = build(matrix(np.zeros(shape)), name)
    assert form.multiply(torch.ones(shape[1], dtype=torch.float64)).tolist() == [0] * shape[0]
    garbage = torch.full((2, shape[0]), torch.nan, dtype=torch.float64)
    assert form.multiply(torch.ones(2, shape[1], dtype=torch.float64), out=garbage).tolist() == [[0] * shape[0]] * 2


@each_format
def test_no_vectors_have_no_products(name: str) -> None:
    assert build(matrix(BY_HAND), name).multiply(torch.ones(0, 4, dtype=torch.float64)).shape == (0, 6)


@each_format
@settings(deadline=None)
@given(matrices)
def test_a_refresh_writes_the_rows_that_it_says(name: str, sparse: sp.csr_array) -> None:
    form = build(Csr.from_scipy(sparse, torch.float64), name)
    out = torch.full((form.n_rows,), torch.nan, dtype=torch.float64)
    form.refresh(torch.ones(form.n_cols, dtype=torch.float64), out)
    if form.storage.values:  # else there is nothing to multiply, and all is zeroed
        assert form.written_rows == (~out.isnan()).sum()


@settings(deadline=None)
@given(matrices, st.integers(1, 8))
def test_scipys_parts_of_any_height(sparse: sp.csr_array, height: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scipy_window, "ROWS_AT_ONCE", height)
        form = ScipyWindow(Csr.from_scipy(sparse, torch.float64))
    x = torch.linspace(0.1, 1, form.n_cols, dtype=torch.float64)
    np.testing.assert_allclose(form.multiply(x), sparse @ x.numpy(), rtol=1e-13, atol=1e-13)
    assert form.storage.row_indices == sum(part.shape[0] + 1 for _, _, part in form.parts) + 1
    assert stored(form) == form.storage.values


def test_scipy_reads_the_matrix_where_it_lies() -> None:
    csr = matrix(np.ones((10, 6)))
    (_, _, part), *_ = ScipyWindow(csr).parts
    assert np.shares_memory(part.data, csr.values.numpy()) and np.shares_memory(part.indices, csr.indices.numpy())


def test_scipys_private_parts_are_not_needed() -> None:
    """SciPy may move them in any release; a luxloop that wanted them would not even be imported."""
    package = Path(scipy_window.__file__).parent
    assert [path.name for path in package.glob("*.py") if re.search(r"scipy\S* import _|scipy\.\S*\b_\w", path.read_text("utf-8"))] == []


@each_format
def test_what_does_not_fit_is_named(name: str) -> None:
    form = build(matrix(BY_HAND), name)
    x = torch.ones(4, dtype=torch.float64)
    with pytest.raises(ValueError, match="4 columns cannot multiply a vector of 3"):
        form.multiply(x[:3])
    with pytest.raises(ValueError, match=r"contiguous \(6,\), it cannot go into \(5,\)"):
        form.multiply(x, out=torch.zeros(5, dtype=torch.float64))
    with pytest.raises(ValueError, match=r"float64 on cpu, torch.float32 on cpu"):
        form.multiply(x.float())
    with pytest.raises(ValueError, match=r"use world\.spmv\.multiply"):
        form.multiply(x.requires_grad_())


def test_unknown_formats_are_named() -> None:
    with pytest.raises(LuxloopError, match="no sparse format 'windw'; did you mean 'window'"):
        build(matrix(BY_HAND), "windw")
    with pytest.raises(LuxloopError, match="known are coo, csr"):
        build(matrix(BY_HAND), "?")


def test_padding_without_end_is_no_candidate() -> None:
    long_row = np.zeros((1000, 500))
    long_row[:, 0] = 1
    assert "ell" in candidates(Csr.from_scipy(sp.csr_matrix(long_row)))
    long_row[0] = 1
    names = candidates(Csr.from_scipy(sp.csr_matrix(long_row)))
    assert "ell" not in names
    assert {"csr", "window", "submatrix"} <= set(names)
    assert "tiles" in candidates(Csr.from_scipy(sp.csr_matrix(np.ones((200, 20)))))
    # As many pixels a texel, but no two texels share theirs.
    assert "tiles" not in candidates(Csr.from_scipy(sp.kron(sp.eye_array(200), np.ones((1, 20)))))
