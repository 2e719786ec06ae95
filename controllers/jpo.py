"""Joint pixel optimisation (T 3.5.2, 8.4): all pixels together, as close to the wanted light as they can come.

`Jpo` looks for the least absolute deviations (`controllers.jpo_mae`) or least squares (`controllers.jpo_squares`) within a budget of
iterations a step, warm from SSC and from its last step, behind the protocol of all pixel controllers.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from controllers.jpo_mae import least_error
from controllers.jpo_part import Wanted, reaching, wanted
from controllers.jpo_squares import least_squares
from controllers.primitives import E_V, I_V, U_REL, Primitives
from controllers.rthc import Setpoints, masks, trace
from controllers.secondary import SecondaryRays
from controllers.ssc import Ssc, Utilisation
from controllers.windows import projected_windows
from world.headlight import Headlight
from world.params import Params
from world.spmv import multiply


class JpoParams(Params):
    """Real-time joint pixel optimisation."""

    objective: Literal["mae", "least_squares"] = Field("mae", description="what is least: the sum of absolute or of squared deviations")
    iterations: int = Field(40, ge=1, le=100_000, description="budget of a step; what they bring is in docs/jpo.md")


@dataclass(frozen=True)
class JpoState:
    """What a step leaves for the next: u `[..., n_p]`."""

    u: Tensor


@dataclass(frozen=True)
class Jpo:
    """A pixel controller (see `controllers.ssc.PixelController`) that starts from SSC and then optimises all pixels jointly.

    Texels that no primitive covers shall keep the light of the default. As with SSC, pixels that reach no hit keep their default.
    """

    ssc: Ssc
    params: JpoParams

    @classmethod
    def prepare(cls, headlight: Headlight, params: JpoParams | None = None, default: Tensor | None = None) -> "Jpo":
        """Make the tables of SSC once; the default base pattern is dark."""
        return cls(Ssc.prepare(headlight, default=default), params or JpoParams())

    @property
    def headlight(self) -> Headlight:
        return self.ssc.headlight

    @property
    def default(self) -> Tensor:
        return self.ssc.default

    def over(self, default: Tensor) -> "Jpo":
        """The same tables over another base pattern `[n_p]`."""
        return replace(self, ssc=self.ssc.over(default))

    def start(self) -> JpoState:
        """Nothing drawn yet."""
        return JpoState(self.default)

    def utilisation(self, primitives: Primitives, T_world_headlight: Tensor, secondary: SecondaryRays | None = None) -> Utilisation:
        """Utilisation `[..., n_p]` for one moment, warm from SSC."""
        return self._optimised(self.goal(primitives, T_world_headlight, secondary))

    def step(self, state: JpoState, primitives: Primitives, T_world_headlight: Tensor) -> tuple[JpoState, Utilisation]:
        """The same, warm from the last step where that serves better than SSC."""
        goal = self.goal(primitives, T_world_headlight)
        last = replace(goal, start=torch.where(goal.free, state.u, goal.start))
        better = (self._error(last) < self._error(goal))[..., None]
        seen = self._optimised(replace(goal, start=torch.where(better, last.start, goal.start)))
        return JpoState(seen.u), seen

    def goal(self, primitives: Primitives, T_world_headlight: Tensor, secondary: SecondaryRays | None = None) -> Wanted:
        """What the primitives ask of the light texture, the pixels they touch, and where SSC would have these start.

        u_abs and u_rel become the light that all pixels would give so.
        """
        grid = self.headlight
        single = primitives.origin.ndim == 2 and primitives.origin.device.type == "cpu"
        windows = projected_windows(primitives, grid, T_world_headlight, masks(primitives)) if single else None
        setpoints = trace(primitives, grid, T_world_headlight, windows, secondary)
        cut = (..., *setpoints.window.slices)
        hit, in_cd, relative = setpoints.hit, _share(setpoints, setpoints.in_cd, I_V, E_V), _share(setpoints, setpoints.relative, U_REL)
        unit = in_cd + relative * self._light_of_default[cut] + (1 - in_cd - relative) * self._light_of_full[cut]
        asked = (setpoints.value * unit).to(self.default)
        weight = torch.ones_like(asked) if setpoints.weight is None else setpoints.weight.to(asked)
        if setpoints.forced is not None:
            weight = weight.masked_fill(setpoints.forced > 0, torch.inf)
        texture = self._light_of_default.expand(*asked.shape[:-2], -1, -1).clone()
        weights, counts = torch.ones_like(texture), torch.zeros_like(texture, dtype=torch.bool)
        texture[cut] = torch.where(hit, asked, texture[cut])
        weights[cut] = torch.where(hit, weight, 1.0)
        counts[cut] = hit & (weight > 0)
        touched = reaching(grid.matrix.transposed, counts.flatten(-2))
        start = torch.where(touched, self.ssc.utilisation(primitives, T_world_headlight, secondary).u, self.default)
        return wanted(grid, texture, weights, start, touched)

    def _optimised(self, goal: Wanted) -> Utilisation:
        if self.params.objective == "mae":
            return Utilisation(least_error(self.headlight.matrix, goal, self.params.iterations, gap=None).u)
        return Utilisation(least_squares(self.headlight.matrix, goal, self.params.iterations))

    def _error(self, goal: Wanted) -> Tensor:
        """The objective at the start: the weighted sum of deviations in cd, or of their squares, `[...]`."""
        deviation = multiply(self.headlight.matrix, goal.start) - goal.target
        return (goal.weight * (deviation.abs() if self.params.objective == "mae" else deviation.square())).sum(-1)

    @cached_property
    def _light_of_full(self) -> Tensor:
        return self.headlight.light_texture(torch.ones_like(self.default))

    @cached_property
    def _light_of_default(self) -> Tensor:
        return self.headlight.light_texture(self.default)


def _share(setpoints: Setpoints, image: Tensor | None, *codes: int) -> Tensor | float:
    """1 where a setpoint is of these quantities, else 0."""
    return float(setpoints.quantities[0] in codes) if image is None else image
