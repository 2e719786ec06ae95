"""Every format gives the product of the dense matrix, and stores what the thesis says; renewing what changed gives a full product."""

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from bench import captured
from hypothesis import given, settings
from hypothesis import strategies as st
from sparse import formats
from sparse.formats import FORMATS, ScipyWindow, Sell, SparseFormat, Storage, build, candidates
from sparse.incremental import Bands, ChangedPixels

from luxloop.world.spmv import Csr, multiply
from tests.refusal import refusal
from tests.world.spmv_matrices import matrices, random_matrix

each_format = pytest.mark.parametrize("name", FORMATS)
heights = st.integers(1, 8)
changes = st.lists(st.tuples(st.integers(0, 29), st.integers(0, 30), st.integers(0, 2**32)), max_size=8)
CLOSE = {"rtol": 1e-13, "atol": 1e-13}  # float64 sums of at most 30 numbers in 0..1

# 6 x 4, rows of 0, 2, 1, 0, 3 and 0 entries.
BY_HAND = np.array([[0, 0, 0, 0], [1, 0, 2, 0], [0, 3, 0, 0], [0, 0, 0, 0], [4, 0, 5, 6], [0, 0, 0, 0]], dtype=np.float64)


def matrix(dense: np.ndarray) -> Csr:
    return Csr.from_scipy(sp.csr_matrix(dense), torch.float64)


def stored(form: SparseFormat) -> int:
    """Cells of a padded or pack format, from its tensors."""
    if isinstance(form, ScipyWindow):
        return sum(part.nnz for _, part in form.parts)
    return form.values.numel()


@each_format
@settings(deadline=None, max_examples=25)
@given(matrices)
def test_products_are_those_of_the_dense_matrix(name: str, sparse: sp.csr_array) -> None:
    form = build(Csr.from_scipy(sparse, torch.float64), name)
    x = torch.linspace(0.1, 1, 2 * 3 * sparse.shape[1], dtype=torch.float64).view(2, 3, -1)
    expected = x.numpy() @ sparse.toarray().T
    garbage = torch.full(expected.shape, torch.nan, dtype=torch.float64)
    np.testing.assert_allclose(form.multiply(x, out=garbage), expected, **CLOSE)
    np.testing.assert_allclose(form.refresh(2 * x, garbage), 2 * expected, **CLOSE)
    np.testing.assert_allclose(form.multiply(torch.stack([x, -x], -1)[0, 0, :, 0]), expected[0, 0], **CLOSE)
    assert stored(form) == form.storage.values
    out = torch.full((form.n_rows,), torch.nan, dtype=torch.float64)
    form.refresh(x[0, 0], out)
    if form.storage.values:  # else there is nothing to multiply, and all is zeroed
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
def test_storage_is_what_the_thesis_says(name: str, storage: Storage) -> None:
    assert FORMATS[name].count(matrix(BY_HAND)) == storage
    assert build(matrix(BY_HAND), name).storage == storage
    assert storage.bytes(torch.float64) == 4 * (storage.row_indices + storage.column_indices) + 8 * storage.values


@settings(deadline=None, max_examples=50)
@given(matrices, heights)
def test_slices_and_parts_of_any_height(sparse: sp.csr_array, height: int) -> None:
    csr = Csr.from_scipy(sparse, torch.float64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(formats, "ROWS_AT_ONCE", height)
        window = ScipyWindow(csr)
    sell, x = type("OfHeight", (Sell,), {"height": height})(csr), torch.linspace(0.1, 1, csr.n_cols, dtype=torch.float64)
    for form in (sell, window):
        np.testing.assert_allclose(form.multiply(x), sparse @ x.numpy(), **CLOSE)
    lengths = (sparse.toarray() != 0).sum(1)
    slices = [lengths[start : start + height] for start in range(0, len(lengths), height)]
    assert sell.storage.row_indices == len(slices) + 1
    assert sell.storage.values == sum(height * part.max() for part in slices) == len(sell.values)
    assert window.storage.row_indices == sum(part.shape[0] + 1 for _, part in window.parts) + 1
    assert stored(window) == window.storage.values


@each_format
def test_float32_on_every_device(name: str, device: torch.device) -> None:
    sparse = random_matrix(2, 200, 100, 0.1)
    csr = Csr.from_scipy(sparse).to(device)
    if name == "scipy" and device.type != "cpu":
        with refusal("format 'scipy' is for the CPU"):
            build(csr, name)
        return
    x = torch.linspace(0, 1, 100, device=device)
    y = build(csr, name).multiply(x)
    assert (y.dtype, y.device.type) == (torch.float32, device.type)
    # Sums of ten float32 products.
    np.testing.assert_allclose(y.cpu(), sparse @ x.cpu().double().numpy(), rtol=1e-5, atol=1e-6)


@each_format
@pytest.mark.parametrize("shape", [(3, 2), (0, 3), (3, 0)])
def test_matrices_without_entries(name: str, shape: tuple[int, int]) -> None:
    form = build(matrix(np.zeros(shape)), name)
    garbage = torch.full((2, shape[0]), torch.nan, dtype=torch.float64)
    assert form.multiply(torch.ones(2, shape[1], dtype=torch.float64), out=garbage).tolist() == [[0] * shape[0]] * 2
    assert form.multiply(torch.ones(0, shape[1], dtype=torch.float64)).shape == (0, shape[0])  # no vectors have no products


@each_format
def test_what_does_not_fit_is_named(name: str) -> None:
    form = build(matrix(BY_HAND), name)
    x = torch.ones(4, dtype=torch.float64)
    for wrong, out, message in (
        (x[:3], None, r"6 x 4 torch.float64 on cpu cannot multiply \(3,\)"),
        (x, torch.zeros(5, dtype=torch.float64), r"cannot multiply \(4,\) .* into \(5,\)"),
        (x, torch.zeros(12, dtype=torch.float64)[::2], "cannot multiply"),
        (x.float(), None, r"cannot multiply \(4,\) torch.float32"),
        (x.clone().requires_grad_(), None, r"use world\.spmv\.multiply"),
    ):
        with pytest.raises(ValueError, match=message):
            form.multiply(wrong, out=out)


def test_unknown_formats_are_named() -> None:
    with refusal("no sparse format 'windw'; did you mean 'window'"):
        build(matrix(BY_HAND), "windw")


def test_padding_without_end_is_no_candidate() -> None:
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
def test_updates_of_changed_pixels_are_exact(sparse: sp.csr_array, steps: list[tuple[int, int, int]]) -> None:
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
def test_captured_products_are_those_of_the_dense_matrix(name: str) -> None:
    sparse = random_matrix(2, 200, 100, 0.1)
    form, x = build(Csr.from_scipy(sparse).to(torch.device("cuda")), name), torch.rand(100, device="cuda")
    out = form.multiply(x)
    graph = captured(lambda: form.refresh(x, out))
    x.copy_(torch.rand(100))
    graph.replay()
    np.testing.assert_allclose(out.cpu(), x.cpu().double().numpy() @ sparse.toarray().T, rtol=1e-5, atol=1e-6)
