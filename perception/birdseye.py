"""The z = 0 plane seen from above: rectified views of a camera image."""

from dataclasses import dataclass

import torch
from kornia.geometry.transform import remap
from torch import Tensor

from perception.appearance import Axes
from world.view import View


@dataclass(frozen=True)
class Region:
    """A rectangle of the assumed road plane in m, and the edge of its cells."""

    x_near_m: float
    x_far_m: float
    y_left_m: float
    y_right_m: float
    cell_m: float = 0.04


def region_around(x_m: float, y_m: float, length_m: float, width_m: float) -> Region:
    """Where a symbol of this size, meant for (x, y), may come to lie: farther beyond than before, since grazing light runs far."""
    return Region(max(x_m - 2 * length_m, 1.0), x_m + 3.5 * length_m, y_m + 2.5 * width_m, y_m - 2.5 * width_m)


@dataclass(frozen=True)
class BirdsEye:
    """A rectified view; row 0 is far, column 0 is left.

    map_u, map_v: `[rows, cols]`, where each cell looks in the camera image, normalised to -1..1 over the image's borders.
    axes: metres, u to the right (-y) and v towards the car (-x), so that the image's errors keep their signs.
    """

    map_u: Tensor
    map_v: Tensor
    axes: Axes


def birds_eye(region: Region, view: View, dtype: torch.dtype = torch.float32) -> BirdsEye:
    """Where the cells of a region lie in a view's image."""
    rows = round((region.x_far_m - region.x_near_m) / region.cell_m)
    cols = round((region.y_left_m - region.y_right_m) / region.cell_m)
    x = region.x_far_m - (torch.arange(rows, dtype=torch.float64) + 0.5) * region.cell_m
    y = region.y_left_m - (torch.arange(cols, dtype=torch.float64) + 0.5) * region.cell_m
    ground = torch.stack([x[:, None].expand(rows, cols), y.expand(rows, cols), torch.zeros(rows, cols, dtype=torch.float64)])
    uv, depth = view.project(ground.flatten(1))
    uv = torch.where(depth > 0, uv, -1e6)
    u, v = (2 * uv[0] / view.width - 1).to(dtype), (2 * uv[1] / view.height - 1).to(dtype)
    return BirdsEye(u.view(rows, cols), v.view(rows, cols), Axes(-y.to(dtype), -x.to(dtype)))


def rectify(view: BirdsEye, image: Tensor) -> Tensor:
    """Sample camera images `[..., height, width]` onto the plane: `[..., rows, cols]`, zero outside the camera's field of view."""
    flat = image.reshape(-1, 1, *image.shape[-2:])
    map_u, map_v = (m.to(image)[None].expand(flat.shape[0], -1, -1) for m in (view.map_u, view.map_v))
    plane = remap(flat, map_u, map_v, padding_mode="zeros", align_corners=False, normalized_coordinates=True)
    return plane.reshape(*image.shape[:-2], *plane.shape[-2:])
