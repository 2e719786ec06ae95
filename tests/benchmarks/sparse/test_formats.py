"""Every format gives the product of the dense matrix, and stores what the thesis says; renewing what changed gives a full product."""

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from bench import captured
from hypothesis import given, settings
from hypothesis import strategies as st
from sparse import formats
from sparse.formats import FORMATS, ScipyWindow, Sell, Storage, build, candidates
from sparse.incremental import Bands, ChangedPixels

from luxloop.world.spmv import Csr, multiply
from tests.world.spmv_matrices import matrices, random_matrix

each_format = pytest.mark.parametrize("name", FORMATS)
heights = st.integers(1, 8)
changes = st.lists(st.tuples(st.integers(0, 29), st.integers(0, 30), st.integers(0, 2**32)), max_size=8)
CLOSE = {"rtol": 1e-13, "atol": 1e-13}  # float64 sums of at most 30 numbers in 0..1

# 6 x 4, rows of 0, 2, 1, 0, 3 and 0 entries.
BY_HAND = np.array([[0, 0, 0, 0], [1, 0, 2, 0], [0, 3, 0, 0], [0, 0, 0, 0], [4, 0, 5, 6], [0, 0, 0, 0]], dtype=np.float64)


def matrix(dense: np.ndarray) -> Csr:
    return Csr.from_scipy(sp.csr_matrix(dense), torch.float64)


@each_format
@settings(deadline=None, max_examples=25)
@given(matrices)
def test_products_are_those_of_the_dense_matrix(name, sparse):
    form = build(Csr.from_scipy(sparse, torch.float64), name)
    x = torch.linspace(0.1, 1, sparse.shape[1], dtype=torch.float64)
    expected, garbage, out = sparse.toarray() @ x.numpy(), *torch.full((2, form.n_rows), torch.nan, dtype=torch.float64)
    np.testing.assert_allclose(form.multiply(x, out=garbage), expected, **CLOSE)
    np.testing.assert_allclose(form.refresh(2 * x, garbage), 2 * expected, **CLOSE)
    form.refresh(x, out)
    if form.storage.values:  # else there is nothing to multiply, and nothing is written
        assert form.written_rows == (~out.isnan()).sum()


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
def test_storage_is_what_the_thesis_says(name, storage):
    assert FORMATS[name].count(matrix(BY_HAND)) == storage
    assert build(matrix(BY_HAND), name).storage == storage
    assert storage.bytes(torch.float64) == 4 * (storage.row_indices + storage.column_indices) + 8 * storage.values


@settings(deadline=None, max_examples=50)
@given(matrices, heights)
def test_slices_and_parts_of_any_height(sparse, height):
    csr = Csr.from_scipy(sparse, torch.float64)
    x = torch.linspace(0.1, 1, csr.n_cols, dtype=torch.float64)
    sell = type("OfHeight", (Sell,), {"height": height})(csr)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(formats, "ROWS_AT_ONCE", height)
        window = ScipyWindow(csr)
        np.testing.assert_allclose(window.multiply(x), sparse @ x.numpy(), **CLOSE)
    np.testing.assert_allclose(sell.multiply(x), sparse @ x.numpy(), **CLOSE)
    lengths = (sparse.toarray() != 0).sum(1)
    slices = [lengths[start : start + height] for start in range(0, len(lengths), height)]
    padded = sum(height * part.max() for part in slices)
    assert sell.storage == Storage(len(slices) + 1, padded, padded) and len(sell.values) == padded
    assert window.storage.row_indices == sum(part.shape[0] + 1 for part in window.parts) + 1


@each_format
def test_float32_on_every_device(name, device):
    if name == "scipy" and device.type != "cpu":
        pytest.skip("SciPy multiplies on the CPU")
    sparse, x = random_matrix(2, 200, 100, 0.1), torch.linspace(0, 1, 100, device=device)
    y = build(Csr.from_scipy(sparse).to(device), name).multiply(x)
    assert (y.dtype, y.device.type) == (torch.float32, device.type)
    # Sums of ten float32 products.
    np.testing.assert_allclose(y.cpu(), sparse @ x.cpu().double().numpy(), rtol=1e-5, atol=1e-6)


@each_format
@pytest.mark.parametrize("shape", [(3, 2), (0, 3), (3, 0)])
def test_matrices_without_entries(name, shape):
    garbage = torch.full(shape[:1], torch.nan, dtype=torch.float64)
    assert build(matrix(np.zeros(shape)), name).multiply(torch.ones(shape[1]).double(), out=garbage).tolist() == [0] * shape[0]


def test_padding_without_end_is_no_candidate():
    long_row = np.zeros((1000, 500))
    long_row[:, 0] = 1
    assert "ell" in candidates(Csr.from_scipy(sp.csr_matrix(long_row)))
    long_row[0] = 1
    names = candidates(Csr.from_scipy(sp.csr_matrix(long_row)))
    assert "ell" not in names and {"csr", "window", "submatrix"} <= set(names)
    assert "tiles" in candidates(Csr.from_scipy(sp.csr_matrix(np.ones((200, 20)))))
    # As many pixels a texel, but no two texels share theirs.
    assert "tiles" not in candidates(Csr.from_scipy(sp.kron(sp.eye_array(200), np.ones((1, 20)))))


@settings(deadline=None, max_examples=50)
@given(matrices, changes)
def test_updates_of_changed_pixels_are_exact(sparse, steps):
    csr = Csr.from_scipy(sparse, torch.float64)
    x = torch.linspace(0, 1, csr.n_cols, dtype=torch.float64)
    bands, changed, out = Bands(csr), ChangedPixels(csr, x), multiply(csr, x)
    np.testing.assert_allclose(changed.out, sparse @ x.numpy(), **CLOSE)
    for start, count, seed in steps:
        pixels = slice(start, start + count)
        x[pixels] = torch.rand(len(x[pixels]), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        rows = bands.rows_of(pixels)
        np.testing.assert_allclose(bands.refresh(x, out, rows), sparse @ x.numpy(), **CLOSE)
        reached = np.flatnonzero((sparse.toarray()[:, pixels] != 0).any(1))
        assert rows == ((reached[0], reached[-1] + 1) if len(reached) else (0, 0))
        x[torch.randint(csr.n_cols, (2,), generator=torch.Generator().manual_seed(seed))] = 0.5
        np.testing.assert_allclose(changed.refresh(x), sparse @ x.numpy(), **CLOSE)
        out.copy_(changed.out)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="CUDA graphs need CUDA")
@pytest.mark.parametrize("name", sorted(FORMATS.keys() - {"scipy"}))
def test_captured_products_are_those_of_the_dense_matrix(name):
    sparse = random_matrix(2, 200, 100, 0.1)
    form, x = build(Csr.from_scipy(sparse).to(torch.device("cuda")), name), torch.rand(100, device="cuda")
    out = form.multiply(x)
    graph = captured(lambda: form.refresh(x, out))
    x.copy_(torch.rand(100))
    graph.replay()
    np.testing.assert_allclose(out.cpu(), x.cpu().double().numpy() @ sparse.toarray().T, rtol=1e-5, atol=1e-6)
