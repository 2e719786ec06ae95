"""Crops of one image, one per copy, in windows of one size; copies differ only in position and valid pixels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from luxloop.perception.appearance import Axes
from luxloop.perception.extraction import Crop

LEAST_PX = 2  # a crop of fewer rows or columns is empty
EMPTY = Crop(0, 0, 0, 0)


@dataclass(frozen=True)
class Windows:
    """Windows of height x width px around crops; all are empty where all crops are. image: its rows and columns in px.

    A window begins where its crop does, or a column before so that the column is even, unless the image ends too soon for that.
    """

    crops: tuple[Crop, ...]
    image: tuple[int, int]
    height: int
    width: int

    @classmethod
    def around(cls, crops: Sequence[Crop], image: tuple[int, int]) -> "Windows":
        """Windows around crops, those without visible pixels empty. image: its rows and columns in px."""
        whole = tuple(each if _holds_any(each) else EMPTY for each in crops)
        width = max(each.u_stop - each.u_start // 2 * 2 for each in whole)
        return cls(whole, image, max(each.v_stop - each.v_start for each in whole), min(width + width % 2, image[1]))

    def __len__(self) -> int:
        return len(self.crops)

    def __getitem__(self, part: slice) -> "Windows":
        """Some of the windows, as large."""
        return replace(self, crops=self.crops[part])

    @cached_property
    def starts(self) -> tuple[tuple[int, int], ...]:
        """First row and column of each window; windows of empty crops take those of another."""
        rows, cols = self.image[0] - self.height, self.image[1] - self.width
        found = [(min(each.v_start, rows), min(each.u_start // 2 * 2, cols)) if _holds_any(each) else None for each in self.crops]
        first = next((each for each in found if each is not None), (0, 0))
        return tuple(first if each is None else each for each in found)

    @cached_property
    def hull(self) -> Crop:
        """The smallest crop that contains all windows."""
        v, u = (sorted(each) for each in zip(*self.starts, strict=True))
        return Crop(v[0], v[-1] + self.height, u[0], u[-1] + self.width)

    @cached_property
    def empty(self) -> tuple[bool, ...]:
        """Whether the crop of each copy is empty."""
        return tuple(each == EMPTY for each in self.crops)

    def axes(self, like: Tensor) -> Axes:
        """Pixel centres, `[B, width]` and `[B, height]`, at integer + 0.5 of the image."""
        v, u = (like.new_tensor(each)[:, None] for each in zip(*self.starts, strict=True))
        count = torch.arange(max(self.height, self.width), dtype=like.dtype, device=like.device) + 0.5
        return Axes(count[: self.width] + u, count[: self.height] + v)

    def inside(self, device: torch.device) -> Tensor:
        """Pixels `[B, height, width]` bool that belong to the crops."""
        return self._between([(each.v_start, each.v_stop, each.u_start, each.u_stop) for each in self.crops], device)

    def ends(self, share: float, device: torch.device) -> Tensor:
        """Pixels `[B, height, width]` bool of the first and last rows of each crop, less those at the image's border. share: of its rows;
        one at least.
        """
        first, last = [], []
        for each in self.crops:
            rows = max(round(share * (each.v_stop - each.v_start)), 1)
            first.append((each.v_start, each.v_start + rows if each.v_start > 0 else 0, each.u_start, each.u_stop))
            last.append((each.v_stop - rows, each.v_stop if each.v_stop < self.image[0] else 0, each.u_start, each.u_stop))
        return self._between(first, device) | self._between(last, device)

    def cut(self, image: Tensor, at: Crop) -> Tensor:
        """The windows `[B, height, width]` of an image `[h, w]`, or of each `[B, h, w]`, that was cut at a crop which holds them."""
        images = image if image.dim() == 3 else [image] * len(self)
        places = [(v - at.v_start, u - at.u_start) for v, u in self.starts]
        return torch.stack([each[v : v + self.height, u : u + self.width] for each, (v, u) in zip(images, places, strict=True)])

    def _between(self, bounds: Sequence[tuple[int, int, int, int]], device: torch.device) -> Tensor:
        """Pixels `[B, height, width]` bool from row to row and from column to column of the image."""
        at = torch.tensor(self.starts, device=device)  # [B, 2]
        low, high = torch.tensor(bounds, device=device).view(-1, 2, 2).unbind(-1)  # [B, 2]
        found = []
        for k, n in enumerate((self.height, self.width)):
            place = torch.arange(n, device=device) + at[:, k, None]
            found.append((place >= low[:, k, None]) & (place < high[:, k, None]))
        return found[0][:, :, None] & found[1][:, None]


def _holds_any(crop: Crop) -> bool:
    return min(crop.v_stop - crop.v_start, crop.u_stop - crop.u_start) >= LEAST_PX


def hull(crops: Sequence[Crop]) -> Crop:
    """The smallest crop that contains all of one or more crops."""
    low = min(each.v_start for each in crops), min(each.u_start for each in crops)
    high = max(each.v_stop for each in crops), max(each.u_stop for each in crops)
    return Crop(low[0], high[0], low[1], high[1])
