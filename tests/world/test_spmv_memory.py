"""Memory for streaming holds what any memory holds."""

import sys
from pathlib import Path

import pytest
import torch

from luxloop.world.spmv import LARGE, zeros


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
