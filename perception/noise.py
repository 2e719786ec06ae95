"""The noise of frames: a standard normal number for each pixel, a function of seed, step, frame and pixel.

A part of a frame equals that part of the whole to the bit, on every device. The integers are those of SplitMix64, a counter-based generator
(Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014), from a key of 64 bits for a frame and a counter for two
pixels. Of a pixel's 32 bits the upper half chooses one of 65,536 equally probable parts of the normal distribution, the lower half one of
as many parts of its first and last part, whose tails reach 6.3 standard deviations.
"""

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Final

import numpy as np
import torch
from torch import Tensor

from luxloop.world.caches import Part

GOLDEN: Final = 0x9E3779B97F4A7C15 - 2**64
FIRST: Final = 0xBF58476D1CE4E5B9 - 2**64
SECOND: Final = 0x94D049BB133111EB - 2**64
PARTS: Final = 2**16
_30, _27, _31, _FIRST, _SECOND = (np.uint64(each % 2**64) for each in (30, 27, 31, FIRST, SECOND))
STEP: Final = 2.0**-20  # of tabled numbers: far coarser than rounding errors, so that the table is the same on all machines


@dataclass(frozen=True)
class FrameNoise:
    """The noise of one frame, without state, so that a run can resume at any step."""

    key: int

    @classmethod
    def of(cls, seed: int, step: int, frame: int) -> "FrameNoise":
        """The noise of a step's on frame (0) or off frame (1)."""
        return cls(int(np.random.SeedSequence(seed, spawn_key=(step, frame)).generate_state(1, np.uint64)[0]))

    def integers(self, part: Part, device: torch.device | str = "cpu") -> Tensor:
        """32 random bits of each pixel of a part, `[height, width]` int32; two neighbours have the low and the high half of 64."""
        rows, columns = part
        pairs = columns.start // 2, (columns.stop + 1) // 2
        mixed = _counters(rows.start, rows.stop, *pairs, torch.device(device)) + (self.key - (self.key >> 63 << 64))
        mixed.bitwise_xor_(mixed >> 30 & 2**34 - 1).mul_(FIRST)
        mixed.bitwise_xor_(mixed >> 27 & 2**37 - 1).mul_(SECOND)
        mixed.bitwise_xor_(mixed >> 31 & 2**33 - 1)
        halves = mixed.view(torch.int32)
        return halves[:, columns.start % 2 :][:, : columns.stop - columns.start]

    def part(self, part: Part, like: Tensor) -> Tensor:
        """Standard normal numbers `[height, width]` of a part of the frame, in the dtype and on the device of like."""
        if like.device.type == "cpu" and like.dtype in (torch.float32, torch.float64):
            return torch.from_numpy(self._on_host(part, like.dtype))
        bits = self.integers(part, like.device)
        middle, sign, tail = tables(like.dtype, like.device)
        place, further = (each.flatten() for each in (bits >> 16 & PARTS - 1, bits & PARTS - 1))
        drawn = middle.index_select(0, place).addcmul_(sign.index_select(0, place), tail.index_select(0, further))
        return drawn.view_as(bits)

    def _on_host(self, part: Part, dtype: torch.dtype) -> np.ndarray:
        """`part` in NumPy, in half the time, by unsigned shifts and by tails only where they occur."""
        rows, columns = part
        height, width, odd = rows.stop - rows.start, columns.stop - columns.start, columns.start % 2
        mixed = _counters_on_host(rows.start, rows.stop, columns.start // 2, (columns.stop + 1) // 2) + np.uint64(self.key)
        mixed ^= mixed >> _30
        mixed *= _FIRST
        mixed ^= mixed >> _27
        mixed *= _SECOND
        mixed ^= mixed >> _31
        halves = mixed.view(np.uint32)[:, odd : odd + width].ravel()
        place, further = (halves >> np.uint32(16)).astype(np.intp), halves.astype(np.uint16)
        middle, sign, tail = (each.numpy() for each in tables(dtype, torch.device("cpu")))
        drawn: np.ndarray = middle.take(place)
        ends = np.flatnonzero((place == 0) | (place == PARTS - 1))
        drawn[ends] = sign[place[ends]] * tail[further[ends]]
        return drawn.reshape(height, width)


@lru_cache(2)  # both frames of a step read the same part
def _counters(top: int, bottom: int, left: int, right: int, device: torch.device) -> Tensor:
    """The counter of each pair of pixels, multiplied as SplitMix64 does, `[rows, pairs]` int64."""
    v, u = torch.arange(top, bottom, device=device), torch.arange(left, right, device=device)
    return ((v[:, None] << 32) + u + 1).mul_(GOLDEN)


@lru_cache(2)
def _counters_on_host(top: int, bottom: int, left: int, right: int) -> np.ndarray:
    """`_counters` in unsigned integers."""
    v, u = np.arange(top, bottom, dtype=np.uint64), np.arange(left, right, dtype=np.uint64)
    return ((v[:, None] << np.uint64(32)) + u + np.uint64(1)) * np.uint64(GOLDEN % 2**64)


@cache
def tables(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Medians of the parts of the distribution, 0 for the two tails; signs of the tails, 0 for all other parts; medians of the parts of the
    upper tail. Multiples of `STEP` below 8, and their sums and products with signs, are exact in 32 bits.
    """
    shares = (torch.arange(PARTS, dtype=torch.float64) + 0.5) / PARTS
    middle, sign = torch.special.ndtri(shares), torch.zeros_like(shares)
    middle[[0, -1]], sign[0], sign[-1] = 0.0, -1.0, 1.0
    tail = -torch.special.ndtri(shares / PARTS)
    middle, sign, tail = (each.div_(STEP).round_().mul_(STEP).to(device, dtype) for each in (middle, sign, tail))
    return middle, sign, tail
