"""How near a few iterations of joint pixel optimisation come to the optimum, and what they cost: `python benchmarks/jpo.py [--quick]`.

Prints the tables of docs/jpo.md. Process time of one thread; `--quick` takes three rectangles. The converged mean MAE is what
two presets are calibrated by (docs/lamps.md).
"""

from argparse import Namespace
from collections.abc import Callable, Sequence
from functools import partial
from statistics import median
from typing import Any

import numpy as np
import torch
from bench import Laps, interleaved, run, show
from torch import Tensor

from luxloop.controllers.pixels.jpo_solvers import PixelGoal, least_error, least_squares, pixel_goal
from luxloop.controllers.pixels.mrpc import reduce_setpoints
from luxloop.controllers.pixels.pixel_major import MrpcParams, PixelMajor
from luxloop.controllers.pixels.primitives import I_V
from luxloop.controllers.pixels.rthc import Setpoints
from luxloop.controllers.pixels.windows import whole
from luxloop.perception.metrics import mae
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.patterns import RECTANGLES
from luxloop.world.lamps.presets import lamp
from luxloop.world.spmv import multiply

START, CONVERGED = "SSC, a_m = a_r = 1", "joint, MAE, converged"
Way = Callable[[PixelGoal, Tensor], Tensor]


def ssc(light: Headlight, tables: PixelMajor, params: MrpcParams, _: PixelGoal | None, texture: Tensor) -> Tensor:
    """Utilisation of the MapReduce control, every texel being hit that shall be lit."""
    setpoints = Setpoints(texture, (texture > 0).to(texture), whole(light), (I_V,))
    return reduce_setpoints(setpoints, tables, params, torch.zeros(light.n_pixels), dark=True)[0]


def ways(light: Headlight, good: dict[str, MrpcParams], budgets: Sequence[int]) -> dict[str, Way]:
    """Ways to a wanted texture, by name; the joint ones begin at the SSC that is given to them."""

    def joint(iterations: int, gap: float | None = None) -> Way:
        return lambda goal, _: least_error(light.matrix, goal, iterations=iterations, gap=gap).u

    return {
        START: lambda goal, _: goal.start,
        **{name: partial(ssc, light, PixelMajor(light, params), params) for name, params in good.items()},
        "joint, least squares, converged": lambda goal, _: least_squares(light.matrix, goal),
        **{f"joint, MAE, {budget} iterations": joint(budget) for budget in budgets},
        CONVERGED: joint(20_000, 0.005),
    }


def compare(given: Namespace, name: str) -> dict[str, dict[str, Any]]:
    """A row for each way to draw every n-th rectangle; prints them."""
    light, params = lamp(name).modules[0].headlight, MrpcParams()
    good = {way: MrpcParams(**each) for way, each in given.good[name].items()}
    tables, all_ways, gaps = PixelMajor(light, params), ways(light, good, given.budgets), []
    errors, times = ({way: [] for way in all_ways} for _ in range(2))
    for rectangle in RECTANGLES[given.every // 2 :: given.every]:
        texture = rectangle.texture(light)
        goal = pixel_goal(light, texture, start=ssc(light, tables, params, None, texture))
        for way, draw in all_ways.items():
            laps = Laps()
            u = draw(goal, texture)
            times[way].append(laps.lap(way))
            errors[way].append(float(mae(light.light_texture(u), texture)))
        proof = least_error(light.matrix, goal)
        gaps.append(float(1 - proof.bound / proof.error))
    u, y = torch.rand(light.n_pixels), torch.rand(light.n_texels)
    pair_ms = interleaved({"": lambda: (multiply(light.matrix, u), multiply(light.matrix.transpose, y))}, 15)[""]
    best, rows = np.array(errors[CONVERGED]), {}
    for way, each in errors.items():
        ratios = {"over converged": float(np.mean(each) / best.mean()), "worst rectangle": float((each / best).max())}
        rows[way] = {"mean MAE": float(np.mean(each)), **ratios, "ms": median(times[way]), "SpMV pairs": median(times[way]) / pair_ms}
    show(f"`{name}`, {len(best)} rectangles, an SpMV pair takes {pair_ms:.2g} ms, largest gap {max(gaps):.2%}", rows)
    return rows


def measure(given: Namespace) -> dict[str, Any]:
    return {"lamps": {name: compare(given, name) for name in given.good}}


if __name__ == "__main__":
    run(measure, __doc__, "every")
