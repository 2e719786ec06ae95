"""Secondary rays before control: what they find of a primitive's points is drawn into its symbol, for one module after the other.

The points are texels of the primitive instead of hits of the module's own rays, so borders of shadows are as fine as these texels.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from controllers.observer import seen_symbol
from controllers.planner import LightingParams
from controllers.primitives import E_V, U_ABS, Primitives
from controllers.secondary import Caster, Light, SecondaryRays
from world.scene import StreetLamp

MIN_COS_M = 1e-3  # cosine times distance, below which light grazes a primitive
TEXEL_M, FEWEST, MOST = 0.02, 24, 320  # extent of a texel, and how many there are at least and at most in either direction


@dataclass(frozen=True, eq=False)
class Asking:
    """lights: of all modules, by name. street_lamps: whose light is taken off. occluded: what blocks secondary rays, None for nothing."""

    params: LightingParams
    lights: tuple[tuple[str, Light], ...]
    street_lamps: tuple[StreetLamp, ...] = ()
    occluded: Caster | None = None

    def asked(self, own: int, primitives: Primitives) -> Primitives:
        """The primitives `[P]` as the module of that number shall draw them."""
        symbols, symbol_of = list(primitives.symbols), primitives.symbol_of.clone()
        for p in range(len(primitives)):
            if self._asks(primitives, p):
                symbol_of[p] = len(symbols)
                symbols.append(self._drawn(primitives, p, own))
        return replace(primitives, symbols=tuple(symbols), symbol_of=symbol_of, observer=None)

    def _asks(self, primitives: Primitives, p: int) -> bool:
        in_light = int(primitives.quantity[p]) < U_ABS and float(primitives.value[p]) > 0
        return _watched(primitives, p) or (in_light and (self.params.share or bool(self.street_lamps) or self.occluded is not None))

    def _drawn(self, primitives: Primitives, p: int, own: int) -> Tensor:
        """Setpoints as shares of the primitive's value, an image `[rows, cols]` of its rectangle."""
        origin, d1, d2, normal = (v[p].double() for v in (primitives.origin, primitives.d1, primitives.d2, primitives.normal))
        cols, rows = (int(min(max(float(d.norm()) / TEXEL_M, FEWEST), MOST)) for d in (d1, d2))
        u, v = ((torch.arange(n, dtype=torch.float64, device=d1.device) + 0.5) / n for n in (cols, rows))
        points = origin[:, None, None] + d1[:, None, None] * u + d2[:, None, None] * v[:, None]
        symbol = primitives.symbols[int(primitives.symbol_of[p])].double()
        if _watched(primitives, p) and (who := primitives.observer) is not None:
            eye, corner, right, down = (each[p].double() for each in (who.eye, who.origin, who.d1, who.d2))
            image = seen_symbol(points.flatten(1), eye, corner, right, down, symbol).view(rows, cols)
        else:
            image = torch.nn.functional.interpolate(symbol[None, None], (rows, cols), mode="bilinear", antialias=True)[0, 0]
        in_cd = torch.ones_like(image)
        if int(primitives.quantity[p]) == E_V:
            away = self.lights[own][1].T_world_headlight[:3, 3, None, None].to(points) - points
            in_cd = away.square().sum(0) ** 1.5 / (normal[:, None, None] * away).sum(0).clamp(min=MIN_COS_M)
        full = primitives.value[p].double().clamp(min=torch.finfo(torch.float32).tiny) * in_cd
        lights, number = (self.lights, own) if self.params.share else ((self.lights[own],), 0)
        rays = SecondaryRays(lights, number, self.street_lamps, self.occluded)
        return (rays.adjusted(full * image, points, primitives, p) / full).to(primitives.value)


def _watched(primitives: Primitives, p: int) -> bool:
    return primitives.observer is not None and bool(primitives.observer.active[p])
