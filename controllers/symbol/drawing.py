"""What a controller wants to be drawn: a pose of the symbol's rectangle, and how the symbol is warped on it."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from controllers.symbol.relief import Relief

CELLS = (512, 256)  # of a warped symbol, along and across
FOLLOWED = 4  # along and across, one of so many cells' light is followed; between them places are interpolated
BEYOND = (0.4, 0.15)  # of the symbol's length and width, by which a warped symbol's rectangle is larger on every side
HIGHEST_M = 0.2  # of a road that light is drawn for


@dataclass(frozen=True)
class Warp:
    """The symbol laid anew over a rectangle of `size_m` (length, width) about the same centre.

    source: `[..., m, 2, h, w]`, where on the symbol the light of each cell comes from: u to the right and v down, -1 to 1 over the symbol;
    one for each of m modules, or with m = 1 one for all. dimming: `[..., m, h, w]`, 0..1.
    """

    source: Tensor
    dimming: Tensor
    size_m: tuple[float, float]

    def to(self, device: torch.device) -> "Warp":
        """The same on another device."""
        return Warp(self.source.to(device), self.dimming.to(device), self.size_m)


@dataclass(frozen=True)
class Drawing:
    """One symbol to be shown.

    pose: `[..., 4]` = x, y in m, roll, pitch in rad. z: `[...]` m, height of the centre above the assumed road, None for none.
    warp: None for the symbol as it is. raw: utilisations `[n_p]`, one a module, that are shown in place of any symbol.
    """

    pose: Tensor
    z: Tensor | None = None
    warp: Warp | None = None
    raw: tuple[Tensor, ...] | None = None

    def shows(self, other: "Drawing") -> bool:
        """Whether another drawing is the same; that of a state that was stored and read again is another object."""
        mine, others = self._values(), other._values()
        return len(mine) == len(others) and all(a.shape == b.shape and bool((a == b).all()) for a, b in zip(mine, others, strict=True))

    def _values(self) -> list[Tensor]:
        none = self.pose.new_zeros(0)
        warp = (none,) if self.warp is None else (self.warp.source, self.warp.dimming, self.pose.new_tensor(self.warp.size_m))
        return [self.pose, none if self.z is None else self.z, *warp, *(self.raw or ())]

    def singles(self) -> Iterator["Drawing"]:
        """The drawings of a batch, one by one."""
        n = self.pose.dim() - 1
        poses = self.pose.flatten(0, n - 1) if n else self.pose[None]
        for k, pose in enumerate(poses):
            z, warp = self.z, self.warp
            z = z if z is None else z.flatten()[k]
            if warp is not None and n:
                warp = Warp(warp.source.flatten(0, n - 1)[k], warp.dimming.flatten(0, n - 1)[k], warp.size_m)
            yield Drawing(pose, z, warp)


def warp_onto(relief: Relief, lamps: Tensor, centre: tuple[float, float], length_m: float, width_m: float) -> Warp:
    """Inverse ray tracing: the eye shall see a symbol about a centre (x, y) of the plane on the relief as it would on the plane.

    lamps: `[m, 3]` m. The light of a cell takes what of the symbol lies where the eye sees that light. What is brighter than the plane
    would be is dimmed.
    """
    size = (length_m * (1 + 2 * BEYOND[0]), width_m * (1 + 2 * BEYOND[1]))
    rows, cols = (n // FOLLOWED for n in CELLS)
    along, across = (0.5 - (torch.arange(n, device=relief.heights.device) + 0.5) / n for n in (rows, cols))
    x, y = (centre[0] + size[0] * along)[:, None].expand(rows, cols), (centre[1] + size[1] * across).expand(rows, cols)
    seen = torch.stack([torch.stack(relief.seen_from(lamp, x, y, HIGHEST_M)) for lamp in lamps])
    x_seen, y_seen = seen.unbind(1)
    brightness = relief.at(relief.brightness, x_seen.flatten(0, 1), y_seen.flatten(0, 1)).view_as(x_seen)
    source = [2 * (centre[1] - y_seen) / width_m, 2 * (centre[0] - x_seen) / length_m]
    fine = interpolate(torch.stack([*source, 1 / brightness.clamp(min=1)], 1), scale_factor=FOLLOWED, mode="bilinear")
    return Warp(fine[:, :2], fine[:, 2], size)
