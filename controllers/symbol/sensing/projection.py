"""A controller's command: pose of the symbol's rectangle, and warp of the symbol on it."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

CELLS = (512, 256)  # of a warped symbol, along and across


@dataclass(frozen=True)
class Warp:
    """A warp of the symbol on another rectangle about the same centre.

    size_m: length and width of the rectangle. source: `[..., m, 2, h, w]`, place on the symbol of each cell: u to the right and v down, -1
    to 1 over the symbol; for each of m modules, or m = 1 for all. dimming: `[..., m, h, w]`, 0..1.
    """

    source: Tensor
    dimming: Tensor
    size_m: tuple[float, float]

    def to(self, device: torch.device) -> "Warp":
        """The same on another device."""
        return Warp(self.source.to(device), self.dimming.to(device), self.size_m)


@dataclass(frozen=True, eq=False)
class ProjectionCommand:
    """The command of one symbol.

    pose: `[..., 4]` = x, y in m, roll, pitch in rad, in the body frame. z: `[...]` m, height of the centre above the assumed road, None: 0.
    warp: None: undistorted. raw: utilisations `[n_p]`, one a module, shown instead of a symbol, or None. shape: `[4]` of a road on which
    the eye shall see the same image as of the other fields on z = 0 (see `luxloop.controllers.symbol.sensing.projector`), None for z = 0.
    aim: `[2]`, x and y in m of the symbol's place if its target cannot be lit, None for the target.
    """

    pose: Tensor
    z: Tensor | None = None
    warp: Warp | None = None
    raw: tuple[Tensor, ...] | None = None
    shape: Tensor | None = None
    aim: Tensor | None = None

    def shows(self, other: "ProjectionCommand") -> bool:
        """Whether another command is equal in value; commands of a restored state are different objects."""
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
        """The commands of a batch, one by one."""
        n = self.pose.dim() - 1
        poses = self.pose.flatten(0, n - 1) if n else self.pose[None]
        for k, pose in enumerate(poses):
            z, warp = self.z, self.warp
            z = z if z is None else z.flatten()[k]
            if warp is not None and n:
                warp = Warp(warp.source.flatten(0, n - 1)[k], warp.dimming.flatten(0, n - 1)[k], warp.size_m)
            yield ProjectionCommand(pose, z, warp)
