"""What a controller wants to be drawn: a pose of the symbol's rectangle, and how the symbol is warped on it."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

CELLS = (512, 256)  # of a warped symbol, along and across


@dataclass(frozen=True)
class Warp:
    """The symbol laid anew over another rectangle about the same centre.

    size_m: length and width of that. source: `[..., m, 2, h, w]`, where on the symbol the light of each cell comes from: u to the right and
    v down, -1 to 1 over the symbol; one for each of m modules, or with m = 1 one for all. dimming: `[..., m, h, w]`, 0..1.
    """

    source: Tensor
    dimming: Tensor
    size_m: tuple[float, float]

    def to(self, device: torch.device) -> "Warp":
        """The same on another device."""
        return Warp(self.source.to(device), self.dimming.to(device), self.size_m)


@dataclass(frozen=True, eq=False)
class ProjectionCommand:
    """One symbol to be shown.

    pose: `[..., 4]` = x, y in m, roll, pitch in rad, in the body frame. z: `[...]` m, height of the centre above the assumed road, None for
    none. warp: None for the symbol as it is. raw: utilisations `[n_p]`, one a module, that are shown in place of any symbol, None for the
    symbol. shape: `[4]` of a road on which the eye shall see what it would see of the rest on the plane z = 0, see
    `luxloop.controllers.symbol.sensing.projector`, None for that plane. aim: `[2]`, x and y in m of the road where the symbol lies because
    its target cannot be lit, None for the target.
    """

    pose: Tensor
    z: Tensor | None = None
    warp: Warp | None = None
    raw: tuple[Tensor, ...] | None = None
    shape: Tensor | None = None
    aim: Tensor | None = None

    def shows(self, other: "ProjectionCommand") -> bool:
        """Whether another projection is the same; that of a state that was stored and read again is another object."""
        if self is other:
            return True
        mine, others = self._values(), other._values()
        return len(mine) == len(others) and all(a.shape == b.shape and bool((a == b).all()) for a, b in zip(mine, others, strict=True))

    def _values(self) -> list[Tensor]:
        none = self.pose.new_zeros(0)
        warp = (none,) if self.warp is None else (self.warp.source, self.warp.dimming, self.pose.new_tensor(self.warp.size_m))
        given = [none if each is None else each for each in (self.z, self.shape)]
        return [self.pose, *given, *warp, *(self.raw or ())]

    def singles(self) -> Iterator["ProjectionCommand"]:
        """The projections of a batch, one by one."""
        n = self.pose.dim() - 1
        poses = self.pose.flatten(0, n - 1) if n else self.pose[None]
        for k, pose in enumerate(poses):
            z, warp = self.z, self.warp
            z = z if z is None else z.flatten()[k]
            if warp is not None and n:
                warp = Warp(warp.source.flatten(0, n - 1)[k], warp.dimming.flatten(0, n - 1)[k], warp.size_m)
            yield ProjectionCommand(pose, z, warp)
