"""The field of the drawing modules: the part of a symbol outside the field, and places on a road inside the field."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate

from luxloop.controllers.symbol.sensing.projection import CELLS, ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import DrawingModule, Projector, SymbolParams
from luxloop.controllers.symbol.sensing.road_shape import HERE, LEAST_HEIGHT_M, height, ray_lengths, tangent_plane
from luxloop.world.frames import inverse, transform
from luxloop.world.texels import resample

SIDES = ("left", "right", "top", "bottom")  # of a module's light texture
EVERY = 8  # every eighth cell of a rectangle along and across is tested


def cut(projector: Projector, projection: ProjectionCommand) -> Tensor:
    """Shares `[..., 4]` of a symbol's white area cut off at left, right, top and bottom of the modules' fields; their sum is the cut-off
    share.

    A place is cut off if no module has a texel in its direction; it counts for the border that it exceeds most, of the nearest field. NaN
    if no symbol is drawn.
    """
    projection = projector.on_road(projection)
    if projection.raw is None and _wholly_lit(projector, projection):
        return projector.symbol.new_zeros(*projection.pose.shape[:-1], len(SIDES))
    rows, cols = (n // EVERY for n in CELLS)
    v, u = ((torch.arange(n).to(projector.symbol) + 0.5) / n for n in (rows, cols))
    rectangle = projector.rectangle(projection)
    origin, d1, d2 = (each[..., 0, :].to(u)[..., None, None] for each in (rectangle.origin, rectangle.d1, rectangle.d2))
    places = origin + u * d1 + v[:, None] * d2  # [..., 3, rows, cols]
    furthest, sides = torch.stack([beyond(module, places) for module in projector.modules]).max(-3)  # [m, ..., rows, cols]
    nearest, module = furthest.min(0, keepdim=True)  # [1, ..., rows, cols]
    nearest, side = (each[0].unsqueeze(-3) for each in (nearest, sides.gather(0, module)))  # [..., 1, rows, cols]
    white = _white(projector.symbol, projection, rows, cols)
    lost = white * (nearest > 0) * (side == torch.arange(len(SIDES)).to(side)[:, None, None])  # [..., 4, rows, cols]
    return lost.sum((-2, -1)) / white.sum()


def _wholly_lit(projector: Projector, projection: ProjectionCommand) -> bool:
    """Whether one module's field contains the corners of all symbols; False on an accelerator, to avoid synchronisation."""
    corners = projector.rectangle(projection).corners()[..., 0, :, :].mT[..., None]  # [..., 3, 4, 1]
    return corners.device.type == "cpu" and any(bool((beyond(module, corners) <= 0).all()) for module in projector.modules)


def beyond(module: DrawingModule, places: Tensor) -> Tensor:
    """Distances `[..., 4, rows, cols]` m of places `[..., 3, rows, cols]` m beyond the borders of a module's field, negative inside."""
    normals, offsets = module.borders.to(places).split([3, 1], 1)
    return (normals @ places.flatten(-2) + offsets).unflatten(-1, places.shape[-2:])


def _white(symbol: Tensor, projection: ProjectionCommand, rows: int, cols: int) -> Tensor:
    """White share `[rows, cols]` of the symbol on a projection's rectangle, mean of all modules."""
    coarse = adaptive_avg_pool2d(symbol[None, None], (rows, cols))
    if projection.raw is not None:
        return torch.zeros_like(coarse[0, 0])
    if projection.warp is None:
        return coarse[0, 0]
    u, v = interpolate(projection.warp.source, (rows, cols), mode="nearest-exact").unbind(1)
    coarse = coarse.expand(len(u), -1, -1, -1)
    return resample(coarse, u, v)[:, 0].mean(0)


FARTHEST = 2.4  # largest distance of the lit road point for an appearance, in distances of the target
PLACES_M, STEP_M = (5.0, 60.0), 0.25  # distances ahead, and their step, tried for a symbol whose target cannot be lit
SAME_M = 1e-3  # distance below which two places are equal


def aim(shape: Tensor, symbol: SymbolParams, modules: Sequence[DrawingModule], eye: Tensor, observer: Tensor | None = None) -> Tensor:
    """Pose `[4, 4]` of the plane on which the symbol is drawn, with the symbol at its x_m, y_m; HERE for the appearance on z = 0.

    shape: `[4]` of the road. eye: `[3]` m. The plane is tangent to the road at the target if the lamps light the target's middle, else at
    the nearest place ahead where they light the whole symbol; HERE if there is none. observer: `[3]` m; then the plane is tangent where
    this eye sees the target's middle on the road.
    """
    shape, eye = shape.detach().cpu().double(), eye.cpu().double()
    if observer is not None:
        return _seen_plane(shape, symbol, observer.cpu().double())
    if symbol.target == "appearance" and _appears(shape, symbol, modules, eye):
        return HERE
    ahead = torch.arange(*PLACES_M, STEP_M, dtype=torch.float64)
    x = torch.cat([ahead.new_tensor([symbol.x_m]), ahead[(ahead - symbol.x_m).abs().argsort(stable=True)]])
    planes = _tangent_planes(shape, symbol, x)
    lit = _lit(planes, symbol, modules, eye)
    fine = torch.cat([lit[:1, 0], lit[1:].all(-1)])
    return planes[int(fine.to(torch.uint8).argmax())] if bool(fine.any()) else HERE


def _seen_plane(shape: Tensor, symbol: SymbolParams, observer: Tensor) -> Tensor:
    """The plane tangent to the road where an eye at `[3]` m sees the target's middle; HERE if it sees the road farther than FARTHEST."""
    way = observer.new_tensor([symbol.x_m, symbol.y_m, 0.0]) - observer
    share = ray_lengths(shape[None], symbol.x_m, observer, way)[0]
    if share > FARTHEST:
        return HERE
    at, (_, b, c, d) = observer + share * way, shape
    return tangent_plane(at, b + d * (at[0] - symbol.x_m), c, symbol.x_m, symbol.y_m)


def elsewhere(T_ground_plane: Tensor, symbol: SymbolParams) -> Tensor | None:
    """Ground coordinates x, y `[2]` m of a symbol on a plane `[4, 4]`; None at the target."""
    target = T_ground_plane.new_tensor([symbol.x_m, symbol.y_m, 0.0])
    place = transform(T_ground_plane, target[:, None])[:2, 0]
    at_target = (place - target[:2]).norm() < SAME_M
    return None if T_ground_plane.equal(HERE) or (at_target and symbol.target == "place") else place


def _appears(shape: Tensor, symbol: SymbolParams, modules: Sequence[DrawingModule], eye: Tensor) -> bool:
    """Whether the road point on the line of sight to the target's middle is within FARTHEST and in the field of a lamp."""
    way = torch.tensor([symbol.x_m, symbol.y_m, 0.0], dtype=torch.float64) - eye
    share = ray_lengths(shape[None], symbol.x_m, eye, way)[0]
    return bool(share < FARTHEST) and bool(_in_field((eye + share * way)[None, :, None], modules))


def _tangent_planes(shape: Tensor, symbol: SymbolParams, x: Tensor) -> Tensor:
    """Planes `[k, 4, 4]` tangent to the road at x `[k]` m."""
    _, b, c, d = shape
    y = torch.full_like(x, symbol.y_m)
    at = torch.stack([x, y, height(shape, symbol.x_m, x, y)], -1)
    return tangent_plane(at, b + d * (x - symbol.x_m), c.expand_as(x), symbol.x_m, symbol.y_m)


def _lit(planes: Tensor, symbol: SymbolParams, modules: Sequence[DrawingModule], eye: Tensor) -> Tensor:
    """Whether lamps light the middle and the corners of symbols on planes `[k, 4, 4]`, with lamps and eye above the planes: `[k, 5]`."""
    half_x, half_y = symbol.length_m / 2, symbol.width_m / 2
    spots = planes.new_tensor([[0, half_x, half_x, -half_x, -half_x], [0, half_y, -half_y, half_y, -half_y], [0] * 5])
    inside = _in_field(transform(planes, spots + spots.new_tensor([[symbol.x_m], [symbol.y_m], [0.0]])), modules)
    ends = torch.stack([eye, *(module.T_body_headlight[:3, 3].cpu().double() for module in modules)], 1)
    over = transform(inverse(planes), ends)[:, 2] > LEAST_HEIGHT_M
    return inside & over.all(-1, keepdim=True)


def _in_field(points: Tensor, modules: Sequence[DrawingModule]) -> Tensor:
    """Whether points `[k, 3, n]` m are in the field of any module: `[k, n]`."""
    places = points.transpose(0, 1)
    return torch.stack([(beyond(module, places) <= 0).all(0) for module in modules]).any(0)
