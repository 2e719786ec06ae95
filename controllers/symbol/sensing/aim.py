"""Where on a road the symbol goes whose shape was acquired: to its target, or else to the nearest place that can be lit."""

from collections.abc import Sequence

import torch
from torch import Tensor

from luxloop.controllers.symbol.sensing.field import beyond
from luxloop.controllers.symbol.sensing.planes import HERE, LEAST_HEIGHT_M, touching
from luxloop.controllers.symbol.sensing.projector import DrawingModule, SymbolParams
from luxloop.controllers.symbol.sensing.shape import height, reached
from luxloop.world.frames import inverse, transform

FARTHEST = 2.4  # of the target's distance: where light is too far off for an appearance
PLACES_M, STEP_M = (5.0, 60.0), 0.25  # ahead, where the symbol may go in place of its target
SAME_M = 1e-3  # between places


def aimed(shape: Tensor, symbol: SymbolParams, modules: Sequence[DrawingModule], eye: Tensor) -> Tensor:
    """The plane `[4, 4]` of the ground on which the symbol shall lie at its x and y; HERE where it shall look as on z = 0.

    shape: `[4]` of the road. eye: `[3]` m. The plane touches the road at the target's place if lamps light its middle, or else at the
    nearest place ahead where they light all of the symbol. Where there is no such place the target stays what it is.
    """
    shape, eye = shape.detach().cpu().double(), eye.cpu().double()
    if symbol.target == "appearance" and _appears(shape, symbol, modules, eye):
        return HERE
    ahead = torch.arange(*PLACES_M, STEP_M, dtype=torch.float64)
    x = torch.cat([ahead.new_tensor([symbol.x_m]), ahead[(ahead - symbol.x_m).abs().argsort(stable=True)]])
    planes = _touching(shape, symbol, x)
    lit = _lit(planes, symbol, modules, eye)
    fine = torch.cat([lit[:1, 0], lit[1:].all(-1)])
    return planes[int(fine.to(torch.uint8).argmax())] if bool(fine.any()) else HERE


def elsewhere(T_ground_plane: Tensor, symbol: SymbolParams) -> Tensor | None:
    """Where on the ground, x and y `[2]` m, a symbol lies on a plane `[4, 4]`; None where that is its target."""
    target = T_ground_plane.new_tensor([symbol.x_m, symbol.y_m, 0.0])
    place = transform(T_ground_plane, target[:, None])[:2, 0]
    at_target = (place - target[:2]).norm() < SAME_M
    return None if T_ground_plane.equal(HERE) or (at_target and symbol.target == "place") else place


def _appears(shape: Tensor, symbol: SymbolParams, modules: Sequence[DrawingModule], eye: Tensor) -> bool:
    """Whether what looks like the middle of the target is on the road, not far behind it, and in the field of a lamp."""
    way = torch.tensor([symbol.x_m, symbol.y_m, 0.0], dtype=torch.float64) - eye
    share = reached(shape[None], symbol.x_m, eye, way)[0]
    return bool(share < FARTHEST) and bool(_in_field((eye + share * way)[None, :, None], modules))


def _touching(shape: Tensor, symbol: SymbolParams, x: Tensor) -> Tensor:
    """Planes `[k, 4, 4]` that touch the road at x `[k]` m ahead."""
    _, b, c, d = shape
    y = torch.full_like(x, symbol.y_m)
    at = torch.stack([x, y, height(shape, symbol.x_m, x, y)], -1)
    return touching(at, b + d * (x - symbol.x_m), c.expand_as(x), symbol.x_m, symbol.y_m)


def _lit(planes: Tensor, symbol: SymbolParams, modules: Sequence[DrawingModule], eye: Tensor) -> Tensor:
    """Whether lamps light the middle and the corners of symbols on planes `[k, 4, 4]`, and lamps and eye are well over these: `[k, 5]`."""
    half_x, half_y = symbol.length_m / 2, symbol.width_m / 2
    spots = planes.new_tensor([[0, half_x, half_x, -half_x, -half_x], [0, half_y, -half_y, half_y, -half_y], [0] * 5])
    inside = _in_field(transform(planes, spots + spots.new_tensor([[symbol.x_m], [symbol.y_m], [0.0]])), modules)
    ends = torch.stack([eye, *(module.T_world_headlight[:3, 3].cpu().double() for module in modules)], 1)
    over = transform(inverse(planes), ends)[:, 2] > LEAST_HEIGHT_M
    return inside & over.all(-1, keepdim=True)


def _in_field(points: Tensor, modules: Sequence[DrawingModule]) -> Tensor:
    """Whether points `[k, 3, n]` m are in the field of any module: `[k, n]`."""
    places = points.transpose(0, 1)
    return torch.stack([(beyond(module, places) <= 0).all(0) for module in modules]).any(0)
