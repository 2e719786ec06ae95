"""From boxes in the image to boxes on the road, by where the foot's line of sight meets the plane of the ground."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.world.frames import View
from luxloop.world.traffic.tracked import Category

FARTHEST_M = 150.0  # distance assumed for objects on the horizon
LOWEST_M = 0.05  # of a camera, below which feet and horizon cannot be distinguished
LENGTH_M: Mapping[Category, float] = {"pedestrian": 0.5, "cyclist": 1.0, "animal": 1.0, "motorcycle": 1.5, "car": 4.0, "truck": 8.0}
OTHER_LENGTH_M = 0.2


@dataclass(frozen=True, eq=False)
class RoadBoxes:
    """Boxes on the road. T_world_box: `[n, 4, 4]`, origin at the centre of the foot, x away from the camera. size_m: `[n, 3]`, length,
    width, height.
    """

    T_world_box: Tensor
    size_m: Tensor


def place_boxes(boxes: Tensor, categories: tuple[Category, ...], view: View) -> RoadBoxes:
    """Upright boxes whose side facing the camera fills the image boxes `[n, 4]` px; their length is that of their class.

    An error of one pixel at the foot moves a box by `d^2 / (f h)` along the line of sight (1.6 m at 50 m for f = 1194 px and a camera
    height h = 1.3 m), but not in the image.
    """
    T = view.T_world_view
    left, top, right, bottom = boxes.to(T).unbind(-1)
    middle = (left + right) / 2
    foot, head = (_direction(view, middle, v) for v in (bottom, top))
    depth = 1 / nearness(view, middle, bottom)
    near = view.origin[:2] + depth[:, None] * foot[:, :2]
    forward = torch.nn.functional.normalize(foot[:, :2], dim=-1)
    high = _height(view) + depth * foot[:, :2].norm(dim=-1) * head[:, 2] / head[:, :2].norm(dim=-1)
    length = torch.tensor([LENGTH_M.get(each, OTHER_LENGTH_M) for each in categories]).to(T)
    size = torch.stack([length, (right - left) / view.fx * depth, high.clamp(min=0.01)], -1)
    T_world_box = torch.eye(4).to(T).repeat(len(boxes), 1, 1)
    T_world_box[:, :2, 0] = forward
    T_world_box[:, :2, 1] = torch.stack([-forward[:, 1], forward[:, 0]], -1)
    T_world_box[:, :2, 3] = near + length[:, None] / 2 * forward
    return RoadBoxes(T_world_box, size)


def nearness(view: View, u: Tensor, v: Tensor) -> Tensor:
    """Inverse depth in 1/m of the road z = 0 at image points `[...]` px, at least that of `FARTHEST_M`."""
    return (-_direction(view, u, v)[..., 2] / _height(view)).clamp(min=1 / FARTHEST_M)


def road_rows(view: View, u: Tensor) -> tuple[Tensor, float]:
    """Row of the horizon in columns `[...]` px, and the inverse of the camera's height in 1/m along its view.

    The latter is the growth of a metre on the road, in px, from row to row.
    """
    _, down, ahead = view.T_world_view[2, :3].unbind()
    across = view.T_world_view[2, 0] * (u - view.cx) / view.fx
    return view.cy - view.fy * (across + ahead) / down, float(-down * view.fx / view.fy / _height(view))


def _height(view: View) -> float:
    return max(float(view.origin[2]), LOWEST_M)


def _direction(view: View, u: Tensor, v: Tensor) -> Tensor:
    """`[..., 3]` in the world, of depth 1."""
    return torch.stack([(u - view.cx) / view.fx, (v - view.cy) / view.fy, torch.ones_like(u)], -1) @ view.T_world_view[:3, :3].T
