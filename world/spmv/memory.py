"""CPU memory that streams fast: in large pages, which torch does not ask for and by which products gain up to a fifth."""

import math
import mmap
from contextlib import suppress

import torch
from torch import Tensor

LARGE = 2**22  # bytes from which two pages of 2 MiB or more are filled


def zeros(shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """As `torch.zeros`."""
    bytes_ = math.prod(shape) * dtype.itemsize
    if device.type != "cpu" or bytes_ < LARGE or not hasattr(mmap, "MADV_HUGEPAGE"):
        return torch.zeros(shape, dtype=dtype, device=device)
    # Fresh from the system: what malloc hands out again keeps the pages that it has.
    memory = mmap.mmap(-1, bytes_, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    with suppress(OSError):  # a kernel without them
        memory.madvise(mmap.MADV_HUGEPAGE)
    return torch.frombuffer(memory, dtype=dtype).view(shape)


def settled(tensor: Tensor) -> Tensor:
    """A copy that will be read again and again."""
    return zeros(tuple(tensor.shape), tensor.dtype, tensor.device).copy_(tensor.detach())
