"""How long a control step takes on one core, beside the same step in NumPy, SciPy and pyrender: `python benchmarks/step.py`.

Both close the loop of the shipped scenario `snowflake`, step by step in turn, in one process with one thread, in process time; so does
luxloop with its default controller, whose steps are divided by those of the same loop with `thesis_pid`. Each takes every step four times
and the fastest counts, so that neither pays for what the other left in the caches. Luxloop exposes frames only where the symbol is looked
for, the baseline whole. Before that, without noise, both must see the same errors.
"""

import argparse
import json
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import torch
from baseline_numpy import Baseline, Lap, Picture
from bench import machine, on_one_thread
from rich.table import Table

from luxloop.controllers.symbol.sensing.protocol import Observation, Projection
from luxloop.loop.report import terminal as tables
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.simulation.result import SimulationState
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.camera import expose
from luxloop.perception.noise import FrameNoise
from luxloop.world.light.illumination import added_light
from luxloop.world.partial import PartialImage

SIZES = ((640, 480), (1280, 720))  # px
QUICK_SIZES = ((320, 180),)
TAKES = 4
PARTS = ("render", "light", "luminance", "camera", "perceive", "control")
WHOLE = "step of a run"
DEFAULT = "step of a run, default controller"
PACKAGES = ("torch", "numpy", "scipy", "pyrender")
CHECKED_STEPS = 4
TOLERANCE_PX = 0.01  # sums of float32 in another order turn a few of the rounded digital numbers by one
GOALS = (
    "goals: a step of a run at 640 x 480 at least 24 times as fast as the baseline without rendering, better 40 times; "
    "with the default controller at most 2.5 times as long, better 2 times"
)


class Stopwatch:
    """Process time in ms by part, all threads counted."""

    def __init__(self) -> None:
        self.parts: dict[str, float] = {}
        self.last = time.process_time()

    def lap(self, part: str) -> None:
        now = time.process_time()
        self.parts[part] = 1e3 * (now - self.last)
        self.last = now


def luxloop_step(simulation: Simulation, state: SimulationState, lap: Lap) -> tuple[SimulationState, torch.Tensor]:
    """What `Simulation.step` does for the symbol, part by part, without the judge. Returns the next state and the four errors in px."""
    scenario, symbol = simulation.scenario, simulation.symbol
    ((name, held),) = state.held.items()
    lit = simulation.world.lit(state.arrivals.time_s)
    lap("render")
    projection = symbol.controller.projection(held.controller, simulation.ego(state.samples, state.arrivals.time_s))
    lights = symbol.projector.draw(projection)
    lap("light")
    lit_on = added_light(lit.transports, lights, lit.base)
    lap("luminance")
    frames = tuple(exposed(scenario, luminance, state.step, frame) for frame, luminance in enumerate((lit_on, lit.base)))
    crop = symbol.footprint(projection)
    for each in frames:
        each[crop.slices]  # which is where the symbol is looked for
    lap("camera")
    seen = symbol.sensor.measure(frames, projection, lights)
    lap("perceive")
    held = replace(held, controller=symbol.controller.step(held.controller, Observation(seen, frames, Projection(projection, lights))))
    lap("control")
    return replace(state, step=state.step + 1, held={name: held}), seen.errors


def exposed(scenario: Scenario, luminance: torch.Tensor, step: int, frame: int) -> torch.Tensor:
    """Digital numbers of a step's on frame (0) or off frame (1), computed where they are read."""
    noise, camera = FrameNoise.of(scenario.seed, step, frame), scenario.camera
    return PartialImage.of(*luminance.shape, luminance[:0], lambda part: expose(luminance[part], camera, noise.part(part, luminance)))


def whole_step(simulation: Simulation, state: SimulationState, lap: Lap) -> SimulationState:
    """`Simulation.step`, which draws the symbol as one of many functions, and says what happened. Returns the next state."""
    state, _ = simulation.step(state)
    lap(WHOLE)
    return state


def fastest(step: Callable[[Lap], Any]) -> dict[str, float]:
    """Time the same step TAKES times; the parts of the fastest take."""
    watches = []
    for _ in range(TAKES):
        watches.append(Stopwatch())
        step(watches[-1].lap)
    return min((watch.parts for watch in watches), key=lambda parts: sum(parts.values()))


def prepared(width: int, height: int, overrides: list[str]) -> Simulation:
    """The main job at a size of the camera's image."""
    size = [f"camera.width_px={width}", f"camera.height_px={height}"]
    return Simulation.prepare(
        load("snowflake", [*size, "functions.symbol.features.view='raw'", "functions.symbol.features.shape='quadrants'", *overrides])
    )


def difference(width: int, height: int, overrides: list[str]) -> float:
    """Largest difference in px of the errors that both see without noise, over the first steps; NaN where one sees nothing."""
    simulation = prepared(width, height, [*overrides, "camera.noise=false"])
    baseline = Baseline(simulation, None)
    state, pids, apart = simulation.start(), baseline.start, []
    for _ in range(CHECKED_STEPS):
        pids, theirs = baseline.step(pids, lambda part: None)
        state, ours = luxloop_step(simulation, state, lambda part: None)
        apart.append((ours - torch.from_numpy(theirs)).abs().max())
    return float(torch.stack(apart).max())


def measure(width: int, height: int, overrides: list[str], repeats: int) -> dict[str, Any]:
    """Median ms of each part over the first steps of both loops, run in turn."""
    simulation = prepared(width, height, [*overrides, "judge_every=0"])
    picture = _picture(simulation)
    baseline = Baseline(simulation, picture)
    default = prepared(width, height, [*overrides, "judge_every=0", "functions.symbol.controller={name='luxloop'}"])
    state, running, pids, learning = simulation.start(), simulation.start(), baseline.start, default.start()
    laps: dict[str, list[dict[str, float]]] = defaultdict(list)
    for _ in range(repeats):
        laps["numpy"].append(fastest(partial(baseline.step, pids)))
        laps["luxloop"].append(fastest(partial(luxloop_step, simulation, state)))
        laps[WHOLE].append(fastest(partial(whole_step, simulation, running)))
        laps[DEFAULT].append(fastest(partial(whole_step, default, learning)))
        pids, _ = baseline.step(pids, lambda part: None)
        state, _ = luxloop_step(simulation, state, lambda part: None)
        running = whole_step(simulation, running, lambda part: None)
        learning = whole_step(default, learning, lambda part: None)
    result: dict[str, Any] = {"width": width, "height": height, "repeats": repeats, "rendered": picture is not None}
    for whole in (WHOLE, DEFAULT):
        result[whole] = median(step[WHOLE] for step in laps.pop(whole))
    result[f"{DEFAULT}, times thesis_pid"] = result[DEFAULT] / result[WHOLE]
    for name, steps in laps.items():
        result[name] = {part: median(step[part] for step in steps) for part in PARTS}
        result[name]["step"] = median(sum(step.values()) for step in steps)
        result[name]["step without render"] = median(sum(step.values()) - step["render"] for step in steps)
    for row in ("step", "step without render"):
        result[f"{row}, ratio"] = result["numpy"][row] / result["luxloop"][row]
    result[f"{WHOLE}, ratio"] = result["numpy"]["step without render"] / result[WHOLE]
    return result


def _picture(simulation: Simulation) -> Picture | None:
    if "OpenGL" not in simulation.renderer:
        tables.console(stderr=True).print(f"no colour render in the baseline, without OpenGL: {simulation.renderer}", markup=False)
        return None
    picture = Picture(simulation)
    picture.render()  # which makes the context and moves the meshes into it
    return picture


def table(result: dict[str, Any]) -> Table:
    """One size's results."""
    rows = []
    for part in (*PARTS, "step", "step without render"):
        ours, theirs = result["luxloop"][part], result["numpy"][part]
        ratio = "" if part == "render" else f"{theirs / ours:.0f}"
        rows.append((part, f"{theirs:.1f}", f"{ours:.2f}", ratio))
    rows.append((WHOLE, "", f"{result[WHOLE]:.2f}", f"{result[f'{WHOLE}, ratio']:.0f}"))  # beside the baseline without render
    rows.append((DEFAULT, "", f"{result[DEFAULT]:.2f}", ""))
    columns = ("ms a step", "NumPy, SciPy, pyrender", "luxloop", "ratio")
    return tables.plain(columns, rows, "lr", title=f"{result['width']} x {result['height']} px")


def main() -> None:
    """Check, measure, show."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the results here")
    parser.add_argument("--repeats", type=int, default=10, help="steps of the loop to take the median of (10)")
    parser.add_argument(
        "--set", nargs="*", default=[], dest="overrides", metavar="KEY=VALUE", help="change the scenario: camera.oversampling=1"
    )
    parser.add_argument("--quick", action="store_true", help="two steps at 320 x 180, to see that it works")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    console, results = tables.console(), []
    where = machine(*PACKAGES)
    console.print(", ".join(f"{key} {value}" for key, value in where.items()), markup=False)
    for size in QUICK_SIZES if arguments.quick else SIZES:
        apart = difference(*size, arguments.overrides)
        if not apart <= TOLERANCE_PX:
            sys.exit(f"not the same work: at {size[0]} x {size[1]} px the errors differ by {apart:.3g} px, more than {TOLERANCE_PX} px")
        results.append({**measure(*size, arguments.overrides, 2 if arguments.quick else arguments.repeats), "errors differ by px": apart})
        console.print(table(results[-1]))
        console.print(f"with the default controller a step takes {results[-1][f'{DEFAULT}, times thesis_pid']:.2f} times as long")
        console.print(f"without noise the errors differ by {apart:.1g} px at most")
    console.print(GOALS)
    if arguments.json:
        arguments.json.write_text(json.dumps({"machine": where, "set": arguments.overrides, "results": results}, indent=1) + "\n")


if __name__ == "__main__":
    on_one_thread("OMP_NUM_THREADS", "LP_NUM_THREADS")  # the latter is Mesa's
    main()
