"""Which points something could hide from an eye, found on a grid of directions before rays are cast.

The road is a surface z(x, y): a ray that goes below it comes out again through a face that is turned away from the eye, a *far side*.
Only far sides and bodies hide points. Each marks the grid's cells that its bounding box covers, and those below, with its least depth.
"""

import math

import torch
from torch import Tensor

from luxloop.world.scene.triangles import Triangles

COLUMNS, ROWS = 256, 256  # of the grid over the directions of all points


def occlusion(triangles: Triangles, eye: Tensor, ways: Tensor, tolerance_m: float) -> tuple[Tensor, Tensor]:
    """Indices `[n]` of the points that something could hide, and far sides of the road that could `[M, 3 corners, 3]` m from the eye.

    eye: `[3]` m. ways: `[3, N]` m, from the eye to the points. All float64.
    """
    far_sides = torch.cat([_far_sides(*group.road, eye) for group in triangles.groups])
    everything = torch.arange(ways.shape[1]), far_sides
    ahead = torch.nn.functional.normalize(ways[:2].mean(1), dim=0)
    R = torch.stack([torch.stack([ahead[0], ahead[1]]), torch.stack([-ahead[1], ahead[0]])])
    R = torch.block_diag(R, torch.ones(1, 1).double())  # to ahead, left and up
    x, y, z = R @ ways
    if not ways.shape[1] or float(x.amin()) <= 0:
        return everything
    across, up = y.div_(x), z.div_(x)
    (right, left), (bottom, top) = (torch.stack(each.aminmax()).tolist() for each in (across, up))
    column_width, row_height = max(left - right, 1e-9) / COLUMNS, max(top - bottom, 1e-9) / ROWS

    bodies = [(each.box - eye) @ R.T for each in triangles.off_road.placed]
    boxes = [(far_sides @ R.T).aminmax(dim=1)] + ([torch.stack(bodies).aminmax(dim=1)] if bodies else [])
    low, high = (torch.cat(each) for each in zip(*boxes, strict=True))  # [M + bodies, 3] m
    near, far = low[:, 0].clamp(min=0), high[:, 0]
    least = low[:, 1] / torch.where(low[:, 1] < 0, near, far)
    most, highest = (each / torch.where(each > 0, near, far) for each in (high[:, 1], high[:, 2]))
    hides = (far > 0) & (near < x.amax()) & (least <= left) & (most >= right) & (highest >= bottom)
    near, least, most, highest = (each[hides] for each in (near, least, most, highest))
    first, last = (((each - right) / column_width).clamp(0, COLUMNS - 1).long() for each in (least, most))
    row = ((top - highest) / row_height).clamp(0, ROWS - 1).long()
    columns = last - first + 1  # that each covers
    which = torch.repeat_interleave(columns)
    column = first[which] + torch.arange(len(which)) - (columns.cumsum(0) - columns)[which]
    grid = torch.full((COLUMNS * ROWS,), math.inf)
    grid.scatter_reduce_(0, column * ROWS + row[which], (near - tolerance_m).float()[which], "amin")
    nearest = grid.view(COLUMNS, ROWS).cummin(1).values.flatten()
    column = across.sub_(right).div_(column_width).int().clamp_(max=COLUMNS - 1)
    row = up.sub_(top).div_(-row_height).int().clamp_(max=ROWS - 1)
    return torch.nonzero(x > nearest[column * ROWS + row])[:, 0], far_sides[hides[: len(far_sides)]]


def _far_sides(corners: Tensor, planes: Tensor, eye: Tensor) -> Tensor:
    below = torch.nonzero(torch.cat([eye, eye.new_ones(1)]) @ planes < 0)[:, 0]
    return corners[below] - eye
