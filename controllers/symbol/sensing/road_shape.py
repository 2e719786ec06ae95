"""The road's shape in four numbers, and planes on a road.

The road is `z = a + b (x - x0) + c y + d (x - x0)^2 / 2`, with the shape `[4]` = a in m, b and c without unit, d in 1/m, about x0 in m.
"""

from typing import Final

import torch
from torch import Tensor

from luxloop.perception import appearance
from luxloop.world.frames import pose, rotation, transform


def ray_lengths(shape: Tensor, x0_m: float, origin: Tensor, rays: Tensor) -> Tensor:
    """Lengths `[k, ...]`, in multiples of rays `[3, ...]` from an origin `[3]` m, up to roads of shapes `[k, 4]`; infinite if a ray misses.

    First positive root of a quadratic, in the form that also holds without curvature.
    """
    a, b, c, d = (each.view(-1, *(1,) * (rays.dim() - 1)) for each in shape.unbind(-1))
    x = origin[0] - x0_m
    square = d / 2 * rays[0] ** 2
    slope = (b + d * x) * rays[0] + c * rays[1] - rays[2]
    height = a + b * x + c * origin[1] + d / 2 * x**2 - origin[2]  # of the road over the origin, negative
    root = (slope**2 - 4 * square * height).clamp(min=0).sqrt()
    below = slope + root
    meets = (slope**2 >= 4 * square * height) & (below > 0) & (height < 0)
    return torch.where(meets, -2 * height / below.clamp(min=1e-9), torch.inf)


def height(shape: Tensor, x0_m: float, x: Tensor, y: Tensor) -> Tensor:
    """Height in m of a road of shape `[4]` at x and y in m, broadcast."""
    a, b, c, d = shape
    return a + b * (x - x0_m) + c * y + d / 2 * (x - x0_m) ** 2


HERE: Final = torch.eye(4, dtype=torch.float64)  # pose of the plane z = 0 under the vehicle
LEAST_HEIGHT_M = 0.25  # least height of a lamp above a plane; below it the plane is seen edge-on
MARGIN = 0.1  # margin of a rectangle on every side, of the light's length and width


def inclined_plane(at: Tensor, slope_x: Tensor, slope_y: Tensor) -> Tensor:
    """Pose `[..., 4, 4]` of a plane through points `[..., 3]` m with slopes `[...]` along x and y, without yaw."""
    pitch = -slope_x.atan()
    return pose(at, rotation((slope_y * pitch.cos()).atan(), pitch))


def tangent_plane(at: Tensor, slope_x: Tensor, slope_y: Tensor, x_m: float, y_m: float) -> Tensor:
    """The inclined plane `[..., 4, 4]` through points `[..., 3]` m, with the points at coordinates x_m, y_m, 0 of the plane."""
    T = inclined_plane(at, slope_x, slope_y)
    T[..., :3, 3] -= T[..., :3, :2] @ T.new_tensor([x_m, y_m])
    return T


def below_lamps(at: Tensor, slope_x: Tensor, slope_y: Tensor, lamps: Tensor) -> Tensor:
    """The inclined plane `[4, 4]` at a point `[3]` m, made less steep if needed to lie LEAST_HEIGHT_M below lamps `[m, 3]` m."""
    over = lamps - at  # [m, 3]
    steepest = ((LEAST_HEIGHT_M - over[:, 2] + slope_y * over[:, 1]) / -over[:, 0]).max()
    return inclined_plane(at, torch.maximum(slope_x, steepest), slope_y)


def bounding_rectangle(T: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, tuple[float, float]]:
    """Pose `[4, 4]`, length and width in m of a rectangle on a plane at `[4, 4]`, from low to high x, y `[2]` m with the MARGIN."""
    length, width = ((high - low) * (1 + 2 * MARGIN)).tolist()
    centre = transform(T, torch.cat([(low + high) / 2, low.new_zeros(1)])[:, None])[:, 0]
    return pose(centre, T[:3, :3]), (length, width)


def cells_of_rectangle(size_m: tuple[float, float], count: tuple[int, int], like: Tensor) -> Tensor:
    """Centres `[3, rows, cols]` m of the cells of a rectangle in its own frame. size_m: length and width. count: rows and columns."""
    x, y = (length * (0.5 - (torch.arange(n).to(like) + 0.5) / n) for length, n in zip(size_m, count, strict=True))
    return torch.stack([*torch.meshgrid(x, y, indexing="ij"), torch.zeros(count).to(like)])


def pose_of_rectangle(T: Tensor) -> tuple[Tensor, Tensor]:
    """Pose `[n]` (x, y in m, roll, pitch in rad) and height `[]` in m of a rectangle at `[4, 4]`, without its yaw.

    A moving body adds a yaw of some 1e-4 rad.
    """
    return torch.stack([degree.of_pose(T) for degree in appearance.DEGREES]), T[2, 3]
