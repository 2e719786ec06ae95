"""Joint pixel optimisation (JPO, T 3.5.2, 8.4): the utilisations of all pixels that together come closest to the target intensities.

`Jpo` minimises absolute or squared deviations (`luxloop.controllers.pixels.jpo_solvers`) with a budget of iterations per step. It starts
from SSC and has the protocol of all pixel controllers.
"""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.pixels.jpo_solvers import PixelGoal, least_error, least_squares, pixel_goal, reaching
from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import E_V, I_V, U_REL, Primitives
from luxloop.controllers.pixels.secondary import SecondaryRays
from luxloop.controllers.pixels.ssc import Ssc, Utilisation
from luxloop.world.headlight import Headlight
from luxloop.world.params import Params


class JpoParams(Params):
    """Real-time joint pixel optimisation."""

    objective: Literal["mae", "least_squares"] = Field("mae", description="objective: the sum of absolute (mae) or of squared deviations")
    iterations: int = Field(40, ge=1, le=100_000, description="iterations per step; docs/jpo.md shows their effect")


@dataclass(frozen=True)
class Jpo:
    """A pixel controller (see `luxloop.controllers.pixels.ssc.PixelController`) that starts from SSC and then optimises all pixels jointly.

    full: `[rows, cols]` cd, with all pixels on. Texels that no primitive covers have the default's light as setpoint. As with SSC, pixels
    that reach no hit keep their default.
    """

    ssc: Ssc
    params: JpoParams
    full: Tensor

    @classmethod
    def prepare(
        cls, headlight: Headlight, params: JpoParams | None = None, default: Tensor | None = None, mrpc: MrpcParams | None = None
    ) -> "Jpo":
        """Compute the tables of SSC once. mrpc: parameters of SSC. default: base pattern `[n_p]`, by default dark."""
        ssc = Ssc.prepare(headlight, mrpc, default)
        return cls(ssc, params or JpoParams(), headlight.light_texture(torch.ones_like(ssc.default)))

    @property
    def headlight(self) -> Headlight:
        return self.ssc.headlight

    @property
    def default(self) -> Tensor:
        return self.ssc.default

    def over(self, default: Tensor) -> "Jpo":
        """The controller over another base pattern `[n_p]`, with the same tables."""
        return replace(self, ssc=self.ssc.over(default))

    def utilisation(self, primitives: Primitives, T_world_headlight: Tensor, secondary: SecondaryRays | None = None) -> Utilisation:
        """Utilisation `[..., n_p]` in 0..1.

        Raises LuxloopError for values on the host that are not finite.
        """
        goal = self.goal(primitives, T_world_headlight, secondary)
        if self.params.objective == "mae":
            return Utilisation(least_error(self.headlight.matrix, goal, self.params.iterations, gap=None).u)
        return Utilisation(least_squares(self.headlight.matrix, goal, self.params.iterations))

    def goal(self, primitives: Primitives, T_world_headlight: Tensor, secondary: SecondaryRays | None = None) -> PixelGoal:
        """Setpoints of the light texture, the pixels that primitives touch, and their start from SSC.

        u_abs and u_rel become the light of all pixels at that utilisation.
        """
        grid, of_default = self.headlight, torch.zeros_like(self.full)
        if not self.ssc.dark:
            of_default = grid.light_texture(self.default)
        setpoints = self.ssc.ray_batch(primitives, T_world_headlight, secondary).setpoints()
        cut = (..., *setpoints.window.slices)
        hit, in_cd, relative = setpoints.hit, setpoints.portion(setpoints.in_cd, I_V, E_V), setpoints.portion(setpoints.relative, U_REL)
        unit = (
            in_cd + relative * of_default[cut] + (1 - in_cd - relative) * self.full[cut]
        )  # cd per unit of value (T 7.2.1), [..., rows, cols]
        asked = setpoints.value * unit
        weight = torch.ones_like(asked) if setpoints.weight is None else setpoints.weight
        texture = of_default.expand(*asked.shape[:-2], -1, -1).clone()
        weights, counts = torch.ones_like(texture), torch.zeros_like(texture, dtype=torch.bool)
        texture[cut] = torch.where(hit, asked, texture[cut])
        weights[cut] = torch.where(hit, weight, 1.0)
        counts[cut] = hit & (weight > 0)
        touched = reaching(grid.matrix.transpose, counts.flatten(-2))
        start = torch.where(touched, self.ssc.reduce(setpoints)[0], self.default)
        return pixel_goal(grid, texture, weights, start, touched)
