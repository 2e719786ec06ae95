"""How long a control step takes on one core, beside the same step in NumPy and SciPy: `python benchmarks/step.py`.

Both close the loop of the shipped scenario `snowflake`, step by step in turn; so does luxloop with its default controller, whose steps are
divided by those of the same loop with `thesis_pid`. Each takes every step four times and the fastest counts, so that neither pays for what
the other left in the caches. Luxloop exposes frames only where the symbol is looked for, the baseline whole. Before that, without noise,
both must see the same errors. Rendering is in none of the parts, for it happens only when geometry moves.
"""

import sys
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from baseline_numpy import Baseline, Lap
from bench import Goal, Laps, medians, run, show

from luxloop import Observation, Simulation, load
from luxloop.controllers.symbol.sensing.symbol_sensor import Projection
from luxloop.loop.simulation.result import SimulationState
from luxloop.perception.camera import expose
from luxloop.perception.noise import FrameNoise
from luxloop.world.caches import PartialImage
from luxloop.world.light.illumination import added_light

TAKES = 4
RAW = ("functions.symbol.features.view='raw'", "functions.symbol.features.shape='quadrants'", "judge_every=0")
DEFAULT = "functions.symbol.controller={name='luxloop'}"
CHECKED_STEPS, TOLERANCE_PX = 4, 0.01  # sums of float32 in another order turn a few of the rounded digital numbers by one


def parts(simulation: Simulation, state: SimulationState, lap: Lap) -> tuple[SimulationState, torch.Tensor]:
    """The symbol's part of `Simulation.step`, without the evaluator. Returns the next state and the four errors in px."""
    scenario, symbol = simulation.scenario, simulation.symbol
    ((name, held),) = state.symbols.items()
    view = simulation.world.lit(state.arrivals.time_s)
    lap("render")
    projection = symbol.controller.projection(held.controller, simulation.ego(state.samples, state.arrivals.time_s))
    lights = symbol.projector.draw(projection)
    lap("light")
    luminance = added_light(view.transports, lights, view.base), view.base
    lap("luminance")
    crop, frames = symbol.footprint(projection), []
    for frame, each in enumerate(luminance):
        noise = FrameNoise.of(scenario.seed, state.step, frame)
        digital = partial(lambda each, noise, part: expose(each[part], scenario.camera, noise.part(part, each)), each, noise)
        frames.append(PartialImage.of(*each.shape, each[:0], digital))
        frames[-1][crop.slices]  # which is where the symbol is looked for
    lap("camera")
    seen = symbol.sensor.measure(tuple(frames), projection, lights)
    lap("perceive")
    observation = Observation(seen, tuple(frames), Projection(projection, lights))
    held = replace(held, controller=symbol.controller.step(held.controller, observation))
    lap("control")
    return replace(state, step=state.step + 1, symbols={name: held}), seen.errors


def fastest(step: Callable[[Lap], Any]) -> dict[str, float]:
    """Ms of the parts of the fastest of several takes of the same step, and of all of them, without rendering."""
    takes = []
    for _ in range(TAKES):
        laps = Laps()
        step(laps.lap)
        laps.parts.pop("render", None)
        takes.append({**laps.parts, "step": sum(laps.parts.values())})
    return min(takes, key=lambda each: each["step"])


def difference_px(*overrides: str) -> float:
    """Largest difference of the errors that both see without noise, over the first steps; NaN where one sees nothing."""
    simulation = Simulation.prepare(load("snowflake", [*RAW, *overrides, "camera.noise=false"]))
    baseline = Baseline(simulation)
    state, pids, apart = simulation.start(), baseline.start, []
    for _ in range(CHECKED_STEPS):
        pids, theirs = baseline.step(pids, lambda part: None)
        state, ours = parts(simulation, state, lambda part: None)
        apart.append((ours - torch.from_numpy(theirs)).abs().max())
    return float(torch.stack(apart).max())


def whole(simulation: Simulation, state: SimulationState, lap: Lap) -> tuple[SimulationState, None]:
    state, _ = simulation.step(state)
    lap("step")
    return state, None


def compare(repeats: int, *overrides: str) -> dict[str, dict[str, float]]:
    """Median ms of each part over the first steps of all loops, run in turn, and of whole steps of both controllers."""
    simulation, default = (Simulation.prepare(load("snowflake", [*RAW, *overrides, *more])) for more in ((), (DEFAULT,)))
    baseline = Baseline(simulation)
    loops = {
        "numpy": (baseline.step, baseline.start),
        "luxloop": (partial(parts, simulation), simulation.start()),
        "run": (partial(whole, simulation), simulation.start()),
        "run, default controller": (partial(whole, default), default.start()),
    }
    taken = {name: [] for name in loops}
    for _ in range(repeats):
        for name, (step, state) in loops.items():
            taken[name].append(fastest(partial(step, state)))
        loops = {name: (step, step(state, lambda part: None)[0]) for name, (step, state) in loops.items()}
    return {name: medians(steps) for name, steps in taken.items()}


def measure(given: Namespace) -> dict[str, Any]:
    found = []
    for width, height in given.sizes_px:
        overrides = (f"camera={{width_px={width}, height_px={height}}}", *given.set)
        if not (apart := difference_px(*overrides)) <= TOLERANCE_PX:
            sys.exit(f"not the same work: at {width} x {height} px the errors differ by {apart:.3g} px, more than {TOLERANCE_PX} px")
        ms = compare(given.repeats, *overrides)
        ratios = {"ratio": ms["numpy"]["step"] / ms["run"]["step"], "default": ms["run, default controller"]["step"] / ms["run"]["step"]}
        rows = {part: {name: each.get(part) for name, each in ms.items()} for part in ms["luxloop"]}
        show(f"ms a step, {width} x {height} px; errors differ by {apart:.1g} px, ratio {ratios['ratio']:.3g}", rows)
        found.append({"size": [width, height], "errors differ by px": apart, "ms": ms, **ratios})
    goals = [
        Goal("step of a run at 640 x 480 px, times as fast as the baseline", found[0]["ratio"], 24.0, True),
        Goal("step with the default controller, times thesis_pid", found[0]["default"], 2.5),
    ]
    return {"set": given.set, "results": found, "goals": goals}


if __name__ == "__main__":
    run(measure, __doc__, "repeats", "set")
