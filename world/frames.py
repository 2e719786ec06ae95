"""Frames of reference, ISO 8855 for world, vehicle and headlight (x forward, y left, z up) and OpenCV for cameras, and pinhole views."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

# Columns are the OpenCV camera axes (x right, y down, z forward) in an ISO 8855 frame.
T_ISO_OPENCV = torch.tensor([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)


def rotation(roll: Tensor, pitch: Tensor, yaw: Tensor | None = None) -> Tensor:
    """Rotation matrix `Rz(yaw) Ry(pitch) Rx(roll)`.

    Parameters: angles in rad, broadcastable `[...]`; positive pitch is nose down (ISO 8855); without yaw it is zero.
    Returns `[..., 3, 3]`.
    """
    roll, pitch, *turned = torch.broadcast_tensors(roll, pitch, *([] if yaw is None else [yaw]))
    cr, sr = roll.cos(), roll.sin()
    cp, sp = pitch.cos(), pitch.sin()
    if not turned:
        flat = torch.stack([cp, sp * sr, sp * cr, torch.zeros_like(cr), cr, -sr, -sp, cp * sr, cp * cr], -1)
        return flat.unflatten(-1, (3, 3))
    cy, sy = turned[0].cos(), turned[0].sin()
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def pose(position: Tensor, rotation_matrix: Tensor) -> Tensor:
    """Homogeneous pose `[..., 4, 4]` from a position `[..., 3]` in m and a rotation `[..., 3, 3]`."""
    batch = np.broadcast_shapes(position.shape[:-1], rotation_matrix.shape[:-2])  # torch.broadcast_shapes would import sympy
    T = torch.zeros(*batch, 4, 4, dtype=position.dtype, device=position.device)
    T[..., :3, :3] = rotation_matrix
    T[..., :3, 3] = position
    T[..., 3, 3] = 1.0
    return T


def pose_from_degrees(
    position_m: tuple[float, float, float], roll_deg: float = 0.0, pitch_deg: float = 0.0, yaw_deg: float = 0.0
) -> Tensor:
    """Homogeneous pose `[4, 4]`, float64, from a position in m and angles in degrees as scenario files write them."""
    angles = torch.deg2rad(torch.tensor([roll_deg, pitch_deg, yaw_deg], dtype=torch.float64))
    return pose(torch.tensor(position_m, dtype=torch.float64), rotation(*angles))


def unit(vectors: Tensor) -> Tensor:
    """Vectors `[3, ...]` scaled to length 1, zero vectors left as they are; many times as fast as torch's normalize over dim 0."""
    return vectors / (vectors * vectors).sum(0).sqrt().clamp(min=1e-12)


def inverse(T: Tensor) -> Tensor:
    """Inverse of a rigid pose `[..., 4, 4]`."""
    R_t = T[..., :3, :3].transpose(-1, -2)
    return pose(-(R_t @ T[..., :3, 3:])[..., 0], R_t)


def is_rigid(T: NDArray[np.floating[Any]], tolerance: float = 1e-6) -> bool:
    """Whether `[4, 4]` is a pose: finite, a rotation within the tolerance, and a position."""
    R = T[:3, :3].clip(-2, 2)  # so that products do not overflow
    turns = np.abs(R @ R.T - np.eye(3)).max() <= tolerance and np.linalg.det(R) > 0
    return bool(turns and np.isfinite(T).all() and (T[3] == (0, 0, 0, 1)).all())


def transform(T: Tensor, points: Tensor) -> Tensor:
    """Take points `[..., 3, N]` in m of frame b to frame a with `T_a_b` `[..., 4, 4]`."""
    return T[..., :3, :3] @ points + T[..., :3, 3:]


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

    @property
    def whole(self) -> tuple[slice, slice]:
        """All rows and columns."""
        return slice(0, self.height), slice(0, self.width)

    def with_rows(self, rows: int) -> "View":
        """The same view with `rows` rows for each of its own."""
        return replace(self, height=rows * self.height, fy=rows * self.fy, cy=rows * self.cy)

    def with_columns(self, step: int) -> "View":
        """The same view with a column for each `step` of its own."""
        return replace(self, width=self.width // step, fx=self.fx / step, cx=self.cx / step)

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
        """`project` of a few points `[3, N]` on the host, without gradients, in a fifth of its time."""
        T = self.T_world_view.detach().cpu().numpy()
        x, y, depth = T[:3, :3].T @ (points - T[:3, 3:])
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.stack([self.fx * x / depth + self.cx, self.fy * y / depth + self.cy]), depth
