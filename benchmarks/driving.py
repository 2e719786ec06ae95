"""How long a control step takes while the world moves, as a multiple of real time: `python benchmarks/driving.py`.

Every step renders two views, for the on and the off frame, and lights that of the on frame. Beside the way in which worlds in motion are
rendered stands the exact one of worlds that stand still, which intersects every ray and folds the light into a matrix. Both see the same
steps in turn, with one thread, in process time: so it tells what one core does, however busy the machine is. Then whole steps of two
shipped scenarios, and what their parts take of that.
"""

import argparse
import json
import time
from pathlib import Path
from statistics import median
from typing import Any

import torch
from bench import Goal, judged, machine, on_one_thread, show_goals
from rich.table import Table

from luxloop.loop.report import terminal as tables
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.result import SimulationState, StepResult
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.simulation.world import World
from luxloop.world.light.illumination import added_light
from luxloop.world.rendering.surfaces import QuickSurfaces, surface_source

BOX = '{ kind = "box", name = "box", size_m = [1, 1, 1], track = [{ position_m = [20, 2, 0] }, { time_s = 2, position_m = [20, -2, 0] }] }'
CASES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("driving", ("camera.oversampling=1",)),
    ("driving", ("camera.oversampling=2",)),
    ("driving", ("camera.oversampling=4",)),
    ("flat", (f"objects=[{BOX}]",)),
)
QUICK_CASES = (("driving", ("camera.width_px=320", "camera.height_px=180")),)
SMALL = ("camera.width_px=640", "camera.height_px=360", "camera.oversampling=2", "judge_every=0")
# Each with its goal in ms.
RUNS: tuple[tuple[str, tuple[str, ...], float], ...] = (("driving", SMALL, 40.0), ("night_drive", ("judge_every=0",), 60.0))
QUICK_RUNS = tuple((name, ("camera.width_px=320", "camera.height_px=180", "judge_every=0"), goal) for name, _, goal in RUNS)
GOAL = "goal: at most 4 times real time on two cores at 640 x 480 with one lamp"


class Clock:
    """Process time in ms since it was made or last read."""

    def __init__(self) -> None:
        self.last = time.process_time()

    def lap(self) -> float:
        before, self.last = self.last, time.process_time()
        return 1e3 * (self.last - before)


def exactly(world: World) -> World:
    """The same, rendered as a world that stands."""
    exact = World(world.scene, world.modules, world.camera, world.source, world.motion)
    exact.moving, exact.surfaces = False, surface_source(world.source, moving=False)
    return exact


def rendered(world: World, exposures: tuple[float, float]) -> float:
    """ms to render a step's on and off view."""
    clock = Clock()
    on_s, off_s = exposures
    _ = world.lit(on_s).transports, world.lit(on_s).base, world.lit(off_s).base
    return clock.lap()


def lit(world: World, result: StepResult) -> float:
    """ms to light a step's on view once: where worlds move, this casts the rays of shadows."""
    clock = Clock()
    world.lit(result.time_s).luminance(result.showings[0].exposure.lights)
    return clock.lap()


def parts(simulation: Simulation, result: StepResult) -> dict[str, float]:
    """ms of what the two views consist of."""
    world, found = simulation.world, {}
    assert isinstance(world.surfaces, QuickSurfaces), "there is no OpenGL here, so that nothing is rendered the quick way"
    vehicle, view = world.motion.at(result.time_s), world.view_at(result.time_s).with_rows(world.camera.oversampling)
    clock = Clock()
    triangles = world.scene.at(result.time_s, vehicle.T_world_ground)
    found["tiles"] = clock.lap()
    world.surfaces.gbuffer(triangles, view)
    found["G-buffer, one view"] = clock.lap()
    again = World(world.scene, world.modules, world.camera, world.source, world.motion).lit(result.time_s)
    base = again.base
    clock.lap()
    added_light(again.transports, result.showings[0].exposure.lights, base)
    found["light and shadows"] = clock.lap()
    return found


def measure(name: str, overrides: tuple[str, ...], steps: int) -> dict[str, Any]:
    """Medians in ms over the steps after the first; a step is all that happens in one, without the judge."""
    simulation = Simulation.prepare(load(name, (*overrides, "judge_every=0")))
    state: SimulationState = simulation.start()
    exact = exactly(simulation.world)
    laps: dict[str, list[float]] = {"step": [], "quick": [], "exact": []}
    shares: list[dict[str, float]] = []
    for _ in range(steps + 1):
        clock = Clock()
        time_s = state.arrivals.time_s
        exposures = (time_s, time_s + 0.5 / simulation.scenario.rate_hz)
        views = rendered(simulation.world, exposures)
        following, result = simulation.step(state)
        laps["step"].append(clock.lap())
        laps["quick"].append(views + lit(simulation.world, result))
        laps["exact"].append(rendered(exact, exposures) + lit(exact, result))
        shares.append(parts(simulation, result))
        state = following
    camera = simulation.scenario.camera
    ms = {key: median(lap[1:]) for key, lap in laps.items()}
    return {
        "scenario": name,
        "size": [camera.width_px, camera.height_px, camera.oversampling],
        "steps": steps,
        "ms": ms,
        "parts ms": {key: median(each[key] for each in shares[1:]) for key in shares[0]},
        "step to real time, ratio": ms["step"] * simulation.scenario.rate_hz / 1e3,
        "exact to quick, ratio": ms["exact"] / ms["quick"],
    }


def run(name: str, overrides: tuple[str, ...], goal_ms: float, steps: int) -> dict[str, Any]:
    """Medians in ms over a run's steps after the first: of all that they take, and of their parts by the share that these have in them."""
    simulation = Simulation.prepare(load(name, overrides))
    state = simulation.start()
    taken: list[float] = []
    shares: list[dict[str, float]] = []
    for _ in range(steps + 1):
        clock = Clock()
        state, result = simulation.step(state)
        taken.append(clock.lap())
        passed = sum(result.timings.values())  # ms of the clock on the wall, which other programs stretch
        shares.append({part: taken[-1] * each / passed for part, each in result.timings.items()})
    camera = simulation.scenario.camera
    return {
        "scenario": name,
        "size": [camera.width_px, camera.height_px, camera.oversampling],
        "steps": steps,
        "ms": median(taken[1:]),
        "parts ms": {part: median(each[part] for each in shares[1:]) for part in shares[0]},
        "goal ms": goal_ms,
    }


def goals(runs: list[dict[str, Any]]) -> list[Goal]:
    """That of each run."""
    return [(f"ms a step of {each['scenario']}, {_size(each)}", each["ms"], each["goal ms"], False) for each in runs]


def _size(result: dict[str, Any]) -> str:
    return " x ".join(map(str, result["size"]))


def runs_table(runs: list[dict[str, Any]]) -> Table:
    """A row a run."""
    parts = list(runs[0]["parts ms"])
    rows = [(each["scenario"], _size(each), *(f"{ms:.1f}" for ms in (each["ms"], *each["parts ms"].values()))) for each in runs]
    return tables.plain(("scenario", "px x samples", "step", *parts), rows, "llr", title="ms a whole step on one core, and of its parts")


def table(results: list[dict[str, Any]]) -> Table:
    """A row a case."""
    rows = []
    for each in results:
        ms = each["ms"]
        cells = (ms["exact"], ms["quick"], each["exact to quick, ratio"], ms["step"], each["step to real time, ratio"])
        rows.append((each["scenario"], _size(each), *(f"{cell:.1f}" for cell in cells)))
    columns = ("scenario", "px x samples", "views, exact", "views", "ratio", "step", "x real time")
    return tables.plain(columns, rows, "llr", title="ms a control step on one core")


def main() -> None:
    """Measure, show."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the results here")
    parser.add_argument("--steps", type=int, default=10, help="steps to take the median of (10)")
    parser.add_argument("--quick", action="store_true", help="two steps at 320 x 180, to see that it works")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    console, where = tables.console(), machine()
    console.print(", ".join(f"{key} {value}" for key, value in where.items()), markup=False)
    cases = QUICK_CASES if arguments.quick else CASES
    results = [measure(name, overrides, 2 if arguments.quick else arguments.steps) for name, overrides in cases]
    console.print(table(results))
    for each in results:
        shares = ", ".join(f"{key} {value:.1f}" for key, value in each["parts ms"].items())
        console.print(f"{each['scenario']} x {each['size'][2]}: {shares} ms", markup=False)
    console.print(GOAL)
    runs = [run(*each, 2 if arguments.quick else arguments.steps) for each in (QUICK_RUNS if arguments.quick else RUNS)]
    console.print(runs_table(runs))
    verdicts = judged(goals(runs))
    show_goals(console, verdicts)
    if arguments.json:
        content = {"machine": where, "results": results, "runs": runs, "goals": verdicts}
        arguments.json.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    on_one_thread("OMP_NUM_THREADS", "LP_NUM_THREADS")
    main()
