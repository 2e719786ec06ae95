"""Tune thesis_pid on a scenario by random search: `python tune_gains.py snowflake --trials 20`.

The scenario is made ready once; a trial only exchanges the controller. What counts is the mean over all steps of 1 - IoU, as the evaluator
sees it: slow is bad, and so is a symbol that ends up distorted.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel

from luxloop import Simulation, build_controller, load, prepare

RATES = ("x_rate_m", "y_rate_m", "roll_rate_deg", "pitch_rate_deg")
GAINS = ("kp", "ki", "kd")
LOOPS = ("position", "rotation")
SPREAD = 0.25  # standard deviation of a factor's logarithm: most trials stay within 0.6 and 1.6 times the scenario's value


def varied(params: BaseModel, rng: np.random.Generator) -> BaseModel:
    """The same controller with all gains and rate limits multiplied by random factors."""

    def near(model: BaseModel, keys: Sequence[str]) -> dict[str, float]:
        return {key: round(float(getattr(model, key) * rng.lognormal(sigma=SPREAD)), 3) for key in keys}

    gains = {loop: getattr(params, loop).model_copy(update=near(getattr(params, loop), GAINS)) for loop in LOOPS}
    return params.model_copy(update=near(params, RATES) | gains)


def cost(simulation: Simulation, params: BaseModel) -> float:
    """Mean of 1 - IoU over a run with this controller."""
    controller = build_controller(params, simulation.symbol.sensor)
    return float(np.mean([1 - float(result.symbol.metrics.iou) for result in simulation.with_controller(controller).evaluations()]))


def as_toml(params: BaseModel) -> str:
    """What to write into a scenario file."""

    def pairs(model: BaseModel) -> list[str]:
        return [f"{key} = {value:g}" for key, value in model if isinstance(value, float)]

    loops = [f"{loop} = {{ {', '.join(pairs(getattr(params, loop)))} }}" for loop in LOOPS]
    return "\n".join(["[functions.symbol.controller]", 'name = "thesis_pid"', *loops, *pairs(params)])


def main() -> None:
    parser = argparse.ArgumentParser(description="Tune thesis_pid on a scenario by random search.")
    parser.add_argument("scenario", nargs="?", default="snowflake", help="shipped name or file")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--steps", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0, help="seed of the search; the scenario's noise keeps its own")
    given = parser.parse_args()

    scenario = load(given.scenario, steps=given.steps)
    if scenario.symbol.controller.name != "thesis_pid":
        parser.error(f"{given.scenario} is not controlled by thesis_pid; take a scenario that is")
    simulation = prepare(scenario)
    best = scenario.symbol.controller
    least = before = cost(simulation, best)
    print(f"as the scenario has it: {before:.4f}")
    rng = np.random.default_rng(given.seed)
    for trial in range(1, given.trials + 1):
        # from the best so far on: a random walk that only goes down
        candidate = varied(best, rng)
        reached = cost(simulation, candidate)
        if reached < least:
            best, least = candidate, reached
            print(f"trial {trial}: {least:.4f}")
    print(f"\n1 - IoU, mean over {given.steps} steps: {before:.4f} -> {least:.4f} with\n\n{as_toml(best)}")


if __name__ == "__main__":
    main()
