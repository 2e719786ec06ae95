"""The command of a symbol controller: pose of the symbol's rectangle, and warp of the symbol on the rectangle."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

CELLS = (512, 256)  # of a warped symbol, along and across


@dataclass(frozen=True)
class Warp:
    """A warp of the symbol on a rectangle of another size.

    source: `[..., m, 2, h, w]`, symbol coordinates u (right) and v (down), -1 to 1 over the symbol, of each cell of the rectangle, for each
    of m modules, or m = 1 for all. dimming: `[..., m, h, w]`, factor 0..1 of each cell. size_m: length and width of the rectangle.
    """

    source: Tensor
    dimming: Tensor
    size_m: tuple[float, float]

    def to(self, device: torch.device) -> "Warp":
        """The warp on another device."""
        return Warp(self.source.to(device), self.dimming.to(device), self.size_m)


@dataclass(frozen=True, eq=False)
class ProjectionCommand:
    """The command of one symbol.

    pose: `[..., 4]` = x, y in m, roll, pitch in rad, in the body frame. z: `[...]` m, height of the centre above the assumed road; None: 0.
    warp: warp of the symbol; None: undistorted. raw: utilisations `[n_p]`, one a module, instead of a symbol; None: a symbol. shape: `[4]`,
    road shape (`luxloop.controllers.symbol.sensing.road_shape`) on which the eye sees the image that pose and warp give on z = 0; None: z =
    0. aim: `[2]`, x and y in m of the symbol if its target cannot be lit; None: at the target. data: anything that the controller wants
    back with the frames that show this command, as `observation.shown.projection.data`.
    """

    pose: Tensor
    z: Tensor | None = None
    warp: Warp | None = None
    raw: tuple[Tensor, ...] | None = None
    shape: Tensor | None = None
    aim: Tensor | None = None
    data: Any = None

    def shows(self, other: "ProjectionCommand") -> bool:
        """Whether another command has equal values; after a restart equal commands are different objects."""
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
