"""CPU memory that streams fast: NumPy asks the operating system for large pages, torch does not, and products gain up to 30 % by them."""

import numpy as np
import torch
from torch import Tensor


def zeros(shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """As `torch.zeros`."""
    if device.type != "cpu":
        return torch.zeros(shape, dtype=dtype, device=device)
    return torch.from_numpy(np.zeros(shape, torch.empty(0, dtype=dtype).numpy().dtype))


def settled(tensor: Tensor) -> Tensor:
    """A copy that will be read again and again."""
    return zeros(tuple(tensor.shape), tensor.dtype, tensor.device).copy_(tensor)
