"""Memory for streaming holds what any memory holds."""

import torch

from world.spmv.memory import settled, zeros


def test_settled_is_a_copy(device: torch.device) -> None:
    for dtype in (torch.float32, torch.float64, torch.int32):
        tensor = torch.arange(6, dtype=dtype, device=device).view(2, 3)
        copy = settled(tensor)
        assert torch.equal(copy, tensor) and copy.data_ptr() != tensor.data_ptr()
        assert (copy.dtype, copy.device.type) == (dtype, device.type)
        assert not zeros((2, 0, 3), dtype, device).any()
