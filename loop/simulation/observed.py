"""How observers see the symbols drawn for them: through a camera in their eye, filled by the wanted picture (T 7.2.2, fig. 7.16)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from luxloop.controllers.functions.planner import Plan
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.situation import Situation
from luxloop.loop.simulation.world import World
from luxloop.perception.metrics import iou
from luxloop.world.frames import View

WIDTH_PX = 640  # of a wanted picture in the observer's camera, which it fills
LIT = 0.5  # of what there would be if the picture were white


@dataclass(frozen=True, eq=False)
class ObservedSymbol:
    """One symbol from its observer's eye. share: luminance `[rows, cols]` as a share of what a white picture would have there; NaN where
    no lamp reaches. wanted: the picture `[rows, cols]`, 0..1.
    """

    share: Tensor
    wanted: Tensor

    @property
    def iou(self) -> float:
        """Overlap of what is lit with what is wanted white."""
        return float(iou(self.share > LIT, self.wanted > LIT))


def pictures(primitives: Primitives) -> list[int]:
    """Which primitives are pictures for an observer's eye; images with an opacity are a camera's, of where light shall be."""
    return [p for p in range(len(primitives)) if primitives.has_observer(p) and primitives.image_of(p).ndim == 2]


def in_white(plan: Plan) -> Plan | None:
    """The plan with white pictures for all observers, None where it has no observers."""
    if plan.primitives is None or not (shown := pictures(plan.primitives)):
        return None
    symbols = (*plan.primitives.symbols, torch.ones(1, 1).to(plan.primitives.origin))
    symbol_of = plan.primitives.symbol_of.index_fill(0, torch.tensor(shown), len(symbols) - 1)
    return replace(plan, primitives=replace(plan.primitives, symbols=symbols, symbol_of=symbol_of))


def observed_symbols(
    plan: Plan, lights: Sequence[Tensor], white: Sequence[Tensor], world: World, now: Situation
) -> tuple[ObservedSymbol, ...]:
    """All symbols of a plan that are meant for an observer, in its order; its lights and those of white pictures `[n_p]`, one a module."""
    primitives = plan.primitives
    if primitives is None or (who := primitives.observer) is None:
        return ()
    found = []
    for p in pictures(primitives):
        view = picture_view(*(each[p].double() for each in (who.eye, who.origin, who.d1, who.d2)))
        seen = world.through(view, now.time_s)
        (_, drawn), (_, full) = seen.light(lights, now.commands), seen.light(white, now.commands)
        symbol = primitives.symbols[int(primitives.symbol_of[p])].to(drawn)
        wanted = torch.nn.functional.interpolate(symbol[None, None], drawn.shape, mode="bilinear")[0, 0]
        found.append(ObservedSymbol(drawn / full, wanted))
    return tuple(found)


def picture_view(eye: Tensor, origin: Tensor, d1: Tensor, d2: Tensor) -> View:
    """The camera in an eye whose image is the flying picture, a rectangle: origin, d1, d2 `[3]` m."""
    right, down = (torch.nn.functional.normalize(edge, dim=0) for edge in (d1, d2))
    T = torch.eye(4, dtype=torch.float64)
    T[:3, :3], T[:3, 3] = torch.stack([right, down, torch.linalg.cross(right, down)], -1), eye
    x, y, depth = (T[:3, :3].T @ (origin - eye)).tolist()
    height = max(round(WIDTH_PX * float(d2.norm() / d1.norm())), 1)
    fx, fy = WIDTH_PX * depth / float(d1.norm()), height * depth / float(d2.norm())
    return View(WIDTH_PX, height, fx, fy, -x * fx / depth, -y * fy / depth, T)
