"""The part of a symbol that lies outside of the field of the lamp modules that draw it, where they have no light."""

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate

from luxloop.controllers.symbol.sensing.projection import CELLS, ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import DrawingModule, Projector
from luxloop.world.texels import resample

SIDES = ("left", "right", "top", "bottom")  # of a module's light texture
EVERY = 8  # every eighth cell of a rectangle along and across is tested


def cut(projector: Projector, projection: ProjectionCommand) -> Tensor:
    """Shares `[..., 4]` of a symbol's white area that lie beyond the SIDES of every module's field; their sum is what is cut.

    A place is cut where no module has a texel in its direction. It counts for one side: of the module whose field is nearest, the one that
    it is furthest beyond. NaN where no symbol is drawn.
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
    """Whether one module's field holds the corners of all symbols; false on a device, which would have to be waited for."""
    corners = projector.rectangle(projection).corners()[..., 0, :, :].mT[..., None]  # [..., 3, 4, 1]
    return corners.device.type == "cpu" and any(bool((beyond(module, corners) <= 0).all()) for module in projector.modules)


def beyond(module: DrawingModule, places: Tensor) -> Tensor:
    """How far places `[..., 3, rows, cols]` m lie beyond the four borders of a module's field `[..., 4, rows, cols]` m, negative within."""
    normals, offsets = module.borders.to(places).split([3, 1], 1)
    return (normals @ places.flatten(-2) + offsets).unflatten(-1, places.shape[-2:])


def _white(symbol: Tensor, projection: ProjectionCommand, rows: int, cols: int) -> Tensor:
    """The symbol `[rows, cols]` as it lies on a projection's rectangle, mean of all modules."""
    coarse = adaptive_avg_pool2d(symbol[None, None], (rows, cols))
    if projection.raw is not None:
        return torch.zeros_like(coarse[0, 0])
    if projection.warp is None:
        return coarse[0, 0]
    u, v = interpolate(projection.warp.source, (rows, cols), mode="nearest-exact").unbind(1)
    coarse = coarse.expand(len(u), -1, -1, -1)
    return resample(coarse, u, v)[:, 0].mean(0)
