"""A pinhole view of the world: what a camera and a lamp's shadow map have in common."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


@dataclass(frozen=True)
class View:
    """Pinhole with OpenCV axes (x right, y down, z forward); pixel centres at integer + 0.5.

    width, height: px. fx, fy, cx, cy: px. T_world_view: `[4, 4]` float64, takes points of the view to the world.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    T_world_view: Tensor

    @property
    def origin(self) -> Tensor:
        """Centre of projection in the world, `[3]` m."""
        return self.T_world_view[:3, 3]

    def with_rows(self, rows: int) -> "View":
        """The same view with so many rows for each of its own."""
        return replace(self, height=rows * self.height, fy=rows * self.fy, cy=rows * self.cy)

    def within(self, rows: slice, columns: slice) -> "View":
        """The part of the view in these rows and columns."""
        size = {"height": rows.stop - rows.start, "width": columns.stop - columns.start}
        return replace(self, **size, cx=self.cx - columns.start, cy=self.cy - rows.start)

    def rays(self) -> Tensor:
        """World directions through all pixel centres, `[3, height, width]` float64, scaled to depth 1 along the optical axis."""
        R = self.T_world_view[:3, :3]
        u = (torch.arange(self.width).to(R) + 0.5 - self.cx) / self.fx
        v = (torch.arange(self.height).to(R) + 0.5 - self.cy) / self.fy
        return ((R[:, :1] * u)[:, None] + (R[:, 1:2] * v)[:, :, None]).add_(R[:, 2, None, None])

    def project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Image coordinates `[..., 2, N]` px and depth `[..., N]` m of world points `[..., 3, N]`; only depth > 0 is in front."""
        T = self.T_world_view.to(points)
        p = T[:3, :3].T @ (points - T[:3, 3:])
        depth = p[..., 2, :]
        u = self.fx * p[..., 0, :] / depth + self.cx
        v = self.fy * p[..., 1, :] / depth + self.cy
        return torch.stack([u, v], -2), depth

    def project_few(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """`project` of points `[3, N]` on the host, without gradients: of a few in a fifth of the time."""
        T = self.T_world_view.detach().cpu().numpy()
        x, y, depth = T[:3, :3].T @ (points - T[:3, 3:])
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.stack([self.fx * x / depth + self.cx, self.fy * y / depth + self.cy]), depth
