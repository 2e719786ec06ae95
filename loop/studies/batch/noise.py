"""The noise of `luxloop.perception.noise` in many windows at once, to the same bits."""

import torch
from torch import Tensor

from luxloop.loop.studies.batch.windows import Windows
from luxloop.perception.noise import FIRST, GOLDEN, PARTS, SECOND, FrameNoise, tables


def normal(frames: list[FrameNoise], windows: Windows, like: Tensor) -> Tensor:
    """Standard normal numbers `[B, height, width]` of a window of each frame, with the dtype and device of `like`."""
    bits = _integers(frames, windows, like.device)
    middle, sign, tail = tables(like.dtype, like.device)
    place = (bits >> 16 & PARTS - 1).flatten()
    drawn = middle.index_select(0, place)
    far = ((place == 0) | (place == PARTS - 1)).nonzero()[:, 0]  # one in 32,768
    further = bits.flatten()[far] & PARTS - 1
    drawn[far] = sign[place[far]] * tail[further]
    return drawn.view_as(bits)


def _integers(frames: list[FrameNoise], windows: Windows, device: torch.device) -> Tensor:
    """`FrameNoise.integers` of the windows, `[B, height, width]` int32."""
    keys = torch.tensor([each.key - (each.key >> 63 << 64) for each in frames], device=device)[:, None, None]
    v, u = torch.tensor(windows.starts, device=device).unbind(-1)
    odd = u % 2
    rows = torch.arange(windows.height, device=device) + v[:, None]
    pairs = torch.arange(windows.width // 2 + 1, device=device) + u[:, None] // 2
    mixed = ((rows[:, :, None] << 32) + pairs[:, None] + 1).mul_(GOLDEN).add_(keys)
    mixed.bitwise_xor_(mixed >> 30 & 2**34 - 1).mul_(FIRST)
    mixed.bitwise_xor_(mixed >> 27 & 2**37 - 1).mul_(SECOND)
    mixed.bitwise_xor_(mixed >> 31 & 2**33 - 1)
    halves = mixed.flatten().view(torch.int32).view(len(frames), windows.height, -1)
    even, shifted = halves[..., : windows.width], halves[..., 1 : windows.width + 1]
    if not bool(odd.any()):
        return even.contiguous()
    return torch.where(odd[:, None, None] > 0, shifted, even)
