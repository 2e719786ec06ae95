"""Detection of vehicles by their own lamps, for vehicles that are masked and otherwise dark."""

import torch
from torch import Tensor

from luxloop.world.traffic.tracked import Category

SHINE: frozenset[Category] = frozenset({"car", "truck"})
BRIGHT = 0.95  # of the largest digital number: threshold of light sources
ABOVE_M = 0.6  # height of a lamp's middle
APART = 0.5  # of a box's width: least distance of two lamps
BETWEEN = 0.1  # of a box's width, to both sides of their middle, where nothing shines: else it is one light
AROUND = 0.25  # of a box's width, within which its lamps are looked for at its sides


def by_lamps(frame: Tensor, boxes: Tensor, pixels_a_metre: Tensor, others: Tensor) -> Tensor:
    """Boxes `[n, 4]` px moved so that the bright spots inside them are two headlamps or rear lamps; NaN without such spots.

    The centre of a box goes to the centre of the outermost spots, and its foot below their mean row. frame: `[height, width]`, shares of
    the largest digital number. pixels_a_metre: `[n]`, px per m at the boxes. others: boxes `[m, 4]` px in which bright spots are no lamps.
    """
    v, u = (each.double().cpu() + 0.5 for each in (frame >= BRIGHT).nonzero().unbind(-1))
    u, v = (each[~_inside(u, v, others).any(0)] for each in (u, v))
    if not len(u):
        return torch.full_like(boxes, torch.nan)
    width = boxes[:, 2] - boxes[:, 0]
    near = _inside(u, v, boxes + width[:, None] * torch.tensor([-AROUND, 0.0, AROUND, 0.0]).double())
    first, last = torch.where(near, u, torch.inf).amin(1), torch.where(near, u, -torch.inf).amax(1)
    middle = (first + last) / 2
    two = (last - first >= APART * width) & ~(near & ((u - middle[:, None]).abs() < BETWEEN * width[:, None])).any(1)
    across = middle - (boxes[:, 0] + boxes[:, 2]) / 2
    down = (near * v).sum(1) / near.sum(1) + ABOVE_M * pixels_a_metre - boxes[:, 3]
    moved = boxes + torch.stack([across, down, across, down], -1)
    return torch.where(two[:, None], moved, torch.nan)


def _inside(u: Tensor, v: Tensor, boxes: Tensor) -> Tensor:
    """`[n, m]`: which points lie in which boxes `[n, 4]`."""
    left, top, right, bottom = boxes[..., None].unbind(1)
    return (u > left) & (u < right) & (v > top) & (v < bottom)
