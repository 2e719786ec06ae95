"""Memory for streaming holds what any memory holds."""

import sys
from pathlib import Path

import pytest
import torch
from sparse.formats import build

from luxloop.world.spmv import LARGE, Csr, zeros
from tests.world.spmv_matrices import random_matrix

DTYPES = (torch.float32, torch.float64, torch.int32)


@pytest.mark.parametrize("shape", [(2, 0, 3), (2, 3), (3, LARGE // 4)])
def test_zeros_are_zero_in_memory_that_was_used_before(shape: tuple[int, ...], device: torch.device) -> None:
    for dtype in DTYPES:
        for _ in range(2):
            tensor = zeros(shape, dtype, device)
            assert (tensor.shape, tensor.dtype, tensor.device.type) == (shape, dtype, device.type)
            assert tensor.is_contiguous() and not tensor.any()
            tensor.fill_(7)
            del tensor  # so that the next ones may get its memory


def test_a_format_streams_from_memory_of_its_own() -> None:
    """A matrix's arrays may lie anywhere, as those of a mirrored headlight do."""
    csr = Csr.from_scipy(random_matrix(1, 200, 50, 0.1))
    form = build(csr, "csr")
    own = form.csr  # type: ignore[attr-defined]
    for name in ("indptr", "indices", "values"):
        assert getattr(own, name).data_ptr() != getattr(csr, name).data_ptr()
        assert torch.equal(getattr(own, name), getattr(csr, name))


@pytest.mark.skipif(sys.platform != "linux", reason="large pages are asked for on Linux")
def test_large_arrays_lie_in_large_pages() -> None:
    pages = Path("/sys/kernel/mm/transparent_hugepage/enabled")
    if not pages.exists() or "[never]" in pages.read_text():
        pytest.skip("this system gives none")
    used = torch.ones(16 * LARGE, dtype=torch.uint8)  # small pages, for malloc to hand out again
    del used
    tensor = zeros((16 * LARGE,), torch.uint8, torch.device("cpu")).fill_(1)
    flags = Path("/proc/self/smaps").read_text().split("\n")
    address = tensor.data_ptr()
    inside = False
    for line in flags:
        first = line.split(" ", 1)[0]
        if "-" in first and ":" not in first:
            low, high = (int(part, 16) for part in first.split("-"))
            inside = low <= address < high
        elif inside and line.startswith("VmFlags:"):
            assert "hg" in line.split()
            return
    pytest.fail("the array is in no mapping")
