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
from statistics import median
from typing import Any

import torch
from baseline_numpy import Baseline, Lap
from bench import Goal, Laps, run, show

from luxloop.controllers.symbol.sensing.protocol import Observation, Projection
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.result import SimulationState
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.camera import expose
from luxloop.perception.noise import FrameNoise
from luxloop.world.caches import PartialImage
from luxloop.world.light.illumination import added_light

SIZES, QUICK_SIZES = ((640, 480), (1280, 720)), ((320, 180),)  # px
TAKES = 4
RAW = ("functions.symbol.features.view='raw'", "functions.symbol.features.shape='quadrants'", "judge_every=0")
DEFAULT = "functions.symbol.controller={name='luxloop'}"
CHECKED_STEPS, TOLERANCE_PX = 4, 0.01  # sums of float32 in another order turn a few of the rounded digital numbers by one


def parts(simulation: Simulation, state: SimulationState, lap: Lap) -> tuple[SimulationState, torch.Tensor]:
    """The symbol's part of `Simulation.step`, without the judge. Returns the next state and the four errors in px."""
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
    """Ms of the parts of the fastest of several takes of the same step, without rendering."""
    takes = []
    for _ in range(TAKES):
        laps = Laps()
        step(laps.lap)
        takes.append({part: ms for part, ms in laps.parts.items() if part != "render"})
    return min(takes, key=lambda each: sum(each.values()))


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


def compare(repeats: int, *overrides: str) -> dict[str, Any]:
    """Median ms of each part over the first steps of all loops, run in turn, and of whole steps of both controllers."""
    simulation = Simulation.prepare(load("snowflake", [*RAW, *overrides]))
    baseline, default = Baseline(simulation), Simulation.prepare(load("snowflake", [*RAW, *overrides, DEFAULT]))

    def whole(of: Simulation, state: SimulationState, lap: Lap) -> tuple[SimulationState, None]:
        state, _ = of.step(state)
        lap("step")
        return state, None

    loops: dict[str, Callable[[Any, Lap], tuple[Any, Any]]] = {
        "numpy": baseline.step,
        "luxloop": partial(parts, simulation),
        "run": partial(whole, simulation),
        "run, default controller": partial(whole, default),
    }
    states = dict(zip(loops, (baseline.start, simulation.start(), simulation.start(), default.start()), strict=True))
    taken: dict[str, list[dict[str, float]]] = {name: [] for name in loops}
    for _ in range(repeats):
        for name, step in loops.items():
            taken[name].append(fastest(partial(step, states[name])))
        states = {name: step(states[name], lambda part: None)[0] for name, step in loops.items()}
    ms = {name: {part: median(each[part] for each in steps) for part in steps[0]} for name, steps in taken.items()}
    ms |= {name: each | {"step": median(sum(step.values()) for step in taken[name])} for name, each in ms.items()}
    whole_ms, default_ms = (ms[name]["step"] for name in ("run", "run, default controller"))
    return {"ms": ms, "ratio": ms["numpy"]["step"] / whole_ms, "default to thesis_pid": default_ms / whole_ms}


def measure(given: Namespace) -> dict[str, Any]:
    found = []
    for width, height in QUICK_SIZES if given.quick else SIZES:
        overrides = (f"camera.width_px={width}", f"camera.height_px={height}", *given.set)
        if not (apart := difference_px(*overrides)) <= TOLERANCE_PX:
            sys.exit(f"not the same work: at {width} x {height} px the errors differ by {apart:.3g} px, more than {TOLERANCE_PX} px")
        each = {"size": [width, height], "errors differ by px": apart, **compare(2 if given.quick else given.repeats, *overrides)}
        rows = {part: {name: each["ms"][name][part] for name in ("numpy", "luxloop")} for part in each["ms"]["luxloop"]}
        rows |= {f"step of a {name}": {"luxloop": each["ms"][name]["step"]} for name in list(each["ms"])[2:]}
        show(f"ms a step, {width} x {height} px; errors differ by {apart:.1g} px, ratio {each['ratio']:.3g}", rows)
        found.append(each)
    first = found[0]
    goals = [Goal("step of a run at 640 x 480 px, times as fast as the baseline", first["ratio"], 24.0, True)]
    goals += [Goal("step with the default controller, times thesis_pid", first["default to thesis_pid"], 2.5)]
    return {"set": given.set, "results": found, "goals": goals}


if __name__ == "__main__":
    repeats = {"type": int, "default": 10, "help": "steps of the loop to take the median of (10)"}
    keys = {"nargs": "*", "default": [], "metavar": "KEY=VALUE", "help": "change the scenario: camera.oversampling=1"}
    run(measure, __doc__, packages=("torch", "numpy", "scipy"), repeats=repeats, set=keys)
