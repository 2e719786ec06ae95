"""The part of a symbol that lies outside of the field of the lamp modules that draw it, where they have no light."""

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from controllers.symbol.sensing.projection import CELLS, ProjectionCommand
from controllers.symbol.sensing.projector import DrawingModule, Projector
from world.resampling import resampled

SIDES = ("left", "right", "top", "bottom")  # of a module's light texture
EVERY = 8  # every eighth cell of a rectangle along and across is tested


def cut(projector: Projector, projection: ProjectionCommand) -> Tensor:
    """Shares `[..., 4]` of a symbol's white area that lie beyond the SIDES of every module's field; their sum is what is cut.

    A place is cut where no module has a texel in its direction. It counts for one side: of the module whose field is nearest, the one that
    it is furthest beyond. NaN where no symbol is drawn.
    """
    projection = projector.on_road(projection)
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


def beyond(module: DrawingModule, places: Tensor) -> Tensor:
    """How far places `[..., 3, rows, cols]` m lie beyond the four borders of a module's field `[..., 4, rows, cols]` m, negative within."""
    light, T = module.pixel_controller.headlight, module.T_world_headlight.to(places)
    x, y, z = torch.einsum("ji,...jrc->...irc", T[:3, :3], places - T[:3, 3, None, None]).unbind(-3)
    return torch.stack([y - light.left * x, light.right * x - y, z - light.top * x, light.bottom * x - z], -3)


def _white(symbol: Tensor, projection: ProjectionCommand, rows: int, cols: int) -> Tensor:
    """The symbol `[rows, cols]` as it lies on a projection's rectangle, mean of all modules."""
    coarse = adaptive_avg_pool2d(symbol[None, None], (rows, cols))
    if projection.raw is not None:
        return torch.zeros_like(coarse[0, 0])
    if projection.warp is None:
        return coarse[0, 0]
    u, v = projection.warp.source[..., EVERY // 2 :: EVERY, EVERY // 2 :: EVERY].unbind(1)
    coarse = coarse.expand(len(u), -1, -1, -1)
    return resampled(coarse, u, v)[:, 0].mean(0)
