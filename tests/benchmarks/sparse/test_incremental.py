"""Renewing what changed gives what a full product gives, after any number of steps."""

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from sparse.formats import FORMATS, build
from sparse.graph import CapturedProduct
from sparse.incremental import Bands, ChangedPixels

from luxloop.world.errors import LuxloopError
from luxloop.world.spmv import Csr, multiply
from tests.world.spmv_matrices import matrices, random_matrix

changes = st.lists(st.tuples(st.integers(0, 29), st.integers(0, 30), st.integers(0, 2**32)), max_size=8)


@settings(deadline=None)
@given(matrices, changes)
def test_bands_of_changed_pixels_are_exact(sparse: sp.csr_array, steps: list[tuple[int, int, int]]) -> None:
    csr = Csr.from_scipy(sparse, torch.float64)
    bands = Bands(csr)
    x = torch.linspace(0, 1, csr.n_cols, dtype=torch.float64)
    out = multiply(csr, x)
    for start, count, seed in steps:
        pixels = slice(start, start + count)
        x[pixels] = torch.rand(len(x[pixels]), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        rows = bands.rows_of(pixels)
        assert bands.refresh(x, out, rows) is out
        # float64 sums of at most 30 numbers in 0..1.
        np.testing.assert_allclose(out, sparse @ x.numpy(), rtol=1e-13, atol=1e-13)
        reached = np.flatnonzero((sparse.toarray()[:, pixels] != 0).any(1))
        assert rows == ((reached[0], reached[-1] + 1) if len(reached) else (0, 0))


@settings(deadline=None)
@given(matrices, changes)
def test_flagged_rows_are_exact(sparse: sp.csr_array, steps: list[tuple[int, int, int]]) -> None:
    csr = Csr.from_scipy(sparse, torch.float64)
    x = torch.linspace(0, 1, csr.n_cols, dtype=torch.float64)
    changed = ChangedPixels(csr, x)
    np.testing.assert_allclose(changed.out, sparse @ x.numpy(), rtol=1e-13, atol=1e-13)
    for _, count, seed in steps:
        generator = torch.Generator().manual_seed(seed)
        pixels = torch.randint(csr.n_cols, (count,), generator=generator)
        x[pixels] = torch.rand(count, generator=generator, dtype=torch.float64)
        np.testing.assert_allclose(changed.refresh(x), sparse @ x.numpy(), rtol=1e-13, atol=1e-13)


def test_nothing_drifts_in_float32(device: torch.device) -> None:
    """After a thousand renewals the result is as good as a fresh one; sums of differences would be 1.5e-6 off by then."""
    sparse = random_matrix(3, 400, 60, 0.05)
    csr = Csr.from_scipy(sparse).to(device)
    bands, x = Bands(csr), torch.rand(60, generator=torch.Generator().manual_seed(1)).to(device)
    out, changed = multiply(csr, x), ChangedPixels(csr, x)
    for step in range(1000):
        pixels = slice(step % 55, step % 55 + 5)
        x[pixels] = (x[pixels] * 1.37 + 0.11) % 1
        bands.refresh(x, out, bands.rows_of(pixels))
        changed.refresh(x)
    fresh = multiply(csr, x).cpu()
    # The same few products, added up in the order of another row position: an ulp of their sum at most.
    np.testing.assert_allclose(out.cpu(), fresh, rtol=2e-7, atol=1e-7)
    np.testing.assert_allclose(changed.out.cpu(), fresh, rtol=2e-7, atol=1e-7)


def test_rows_outside_the_band_are_left_alone() -> None:
    csr = Csr.from_scipy(sp.eye_array(6), torch.float64)
    out = torch.full((6,), 7.0, dtype=torch.float64)
    bands = Bands(csr)
    bands.refresh(torch.arange(6, dtype=torch.float64), out, (2, 4))
    assert out.tolist() == [7, 7, 2, 3, 7, 7]
    assert bands.rows_of(np.array([4, 1])) == (1, 5)
    assert bands.rows_of(slice(3, 3)) == (0, 0)


def test_capture_is_refused_without_cuda() -> None:
    with pytest.raises(LuxloopError, match=r"this one is on cpu: move it with Csr\.to first"):
        CapturedProduct(build(Csr.from_scipy(sp.eye_array(3)), "csr"))


def misfits(x: torch.Tensor) -> list[torch.Tensor]:
    """What `copy_` into x would broadcast, convert or move, and what would lose its gradient."""
    return [x[..., :1], x.flatten()[: x.shape[-1] - 1], x.expand(3, *x.shape), x.double(), x.clone().requires_grad_()]


@pytest.mark.parametrize("batch", [(), (2,)])
def test_a_captured_product_takes_only_its_own_shape_dtype_and_device(batch: tuple[int, ...]) -> None:
    """As it would be on CUDA: an object with nothing captured, which must not even be asked to copy."""
    captured = object.__new__(CapturedProduct)
    captured.form = build(Csr.from_scipy(sp.eye_array(4)), "csr")
    captured.input = torch.zeros(*batch, 4)
    captured.output = captured.form.multiply(captured.input)
    x = torch.ones(*batch, 4)
    for wrong in [*misfits(x), x.to("meta"), *([x[0]] if batch else [])]:
        with pytest.raises(ValueError, match=r"cannot|alike|gradient"):
            captured(wrong)
        assert not captured.input.any()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="CUDA graphs need CUDA")
@pytest.mark.parametrize("batch", [(), (2,)])
def test_what_does_not_fit_a_captured_product_is_refused(batch: tuple[int, ...]) -> None:
    x = torch.ones(*batch, 100, device="cuda")
    captured = CapturedProduct(build(Csr.from_scipy(random_matrix(2, 200, 100, 0.1)).to(torch.device("cuda")), "csr"), batch)
    before = captured(x).clone()
    for wrong in [*misfits(2 * x), 2 * x.cpu(), *([2 * x[0]] if batch else [])]:
        with pytest.raises(ValueError, match=r"cannot|alike|gradient"):
            captured(wrong)
        assert torch.equal(captured.replay(), before)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="CUDA graphs need CUDA")
@pytest.mark.parametrize("batch", [(), (2,)])
@pytest.mark.parametrize("name", [name for name in FORMATS if name != "scipy"])
def test_a_captured_product_follows_its_input(name: str, batch: tuple[int, ...]) -> None:
    sparse = random_matrix(2, 200, 100, 0.1)
    captured = CapturedProduct(build(Csr.from_scipy(sparse).to(torch.device("cuda")), name), batch)
    output = captured.output.data_ptr()
    for seed in range(3):
        x = torch.rand(*batch, 100, generator=torch.Generator().manual_seed(seed))
        y = captured(x.cuda())
        # Sums of ten float32 products.
        np.testing.assert_allclose(y.cpu(), x.double().numpy() @ sparse.toarray().T, rtol=1e-5, atol=1e-6)
        assert y.data_ptr() == output
