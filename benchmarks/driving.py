"""How long a control step takes while the world moves, as a multiple of real time: `python benchmarks/driving.py`.

Every step renders two views, for the on and the off frame, and lights that of the on frame. Beside the way in which worlds in motion are
rendered stands the exact one of worlds that stand still, which intersects every ray and folds the light into a matrix. Both see the same
steps in turn. Then whole steps of two shipped scenarios, and the shares of their parts.
"""

from argparse import Namespace
from statistics import median
from typing import Any

from bench import Goal, Laps, run, show

from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.simulation.world import World
from luxloop.world.rendering.surfaces import QuickSurfaces, surface_source

BOX = '{ kind = "box", name = "box", size_m = [1, 1, 1], track = [{ position_m = [20, 2, 0] }, { time_s = 2, position_m = [20, -2, 0] }] }'
CASES = {f"driving, {n} samples": (f"camera.oversampling={n}",) for n in (1, 2, 4)} | {"flat, a box moves": (f"objects=[{BOX}]",)}
SMALL = ("camera.width_px=640", "camera.height_px=360", "camera.oversampling=2", "judge_every=0")
QUICK = ("camera.width_px=320", "camera.height_px=180", "judge_every=0")
RUNS: dict[str, tuple[tuple[str, ...], float]] = {"driving": (SMALL, 40.0), "night_drive": (("judge_every=0",), 60.0)}  # goals in ms


def exact(world: World) -> World:
    """The same, rendered as a world that stands."""
    standing = World(world.scene, world.modules, world.camera, world.source, world.motion)
    standing.moving, standing.surfaces = False, surface_source(world.source, moving=False)
    return standing


def views(name: str, overrides: tuple[str, ...], steps: int) -> dict[str, Any]:
    """Medians in ms over the steps after the first, of a whole step and of its two views by both ways."""
    simulation = Simulation.prepare(load(name, (*overrides, "judge_every=0")))
    assert isinstance(simulation.world.surfaces, QuickSurfaces), "there is no OpenGL here, so that nothing is rendered the quick way"
    state, worlds, taken = simulation.start(), {"exact": exact(simulation.world), "quick": simulation.world}, []
    for _ in range(steps + 1):
        laps, time_s, half_s = Laps(), state.arrivals.time_s, 0.5 / simulation.scenario.rate_hz
        ms = dict[str, float]()
        for way, world in reversed(worlds.items()):
            _ = world.lit(time_s).transports, world.lit(time_s).base, world.lit(time_s + half_s).base
            ms[way] = laps.lap(way)
        state, result = simulation.step(state)
        ms["step"] = ms["quick"] + laps.lap("step")
        for way, world in worlds.items():
            world.lit(result.time_s).luminance(result.exposures[0].lights)
            ms[way] += laps.lap(way)
        taken.append(ms)
    found: dict[str, Any] = {key: median(each[key] for each in taken[1:]) for key in taken[0]}
    ratios = {"exact to quick": found["exact"] / found["quick"], "step to real time": 1e-3 * found["step"] * simulation.scenario.rate_hz}
    return {"size": size(simulation), "ms": found, **ratios}


def whole(name: str, overrides: tuple[str, ...], steps: int) -> dict[str, Any]:
    """Medians in ms over a run's steps after the first, and of their parts by the clock's shares of these."""
    simulation = Simulation.prepare(load(name, overrides))
    state, taken = simulation.start(), []
    for _ in range(steps + 1):
        laps = Laps()
        state, result = simulation.step(state)
        ms, clock_ms = laps.lap("step"), sum(result.timings.values())
        taken.append({"step": ms, **{part: ms * each / clock_ms for part, each in result.timings.items()}})
    return {"size": size(simulation), "ms": {part: median(each[part] for each in taken[1:]) for part in taken[0]}}


def size(simulation: Simulation) -> str:
    camera = simulation.scenario.camera
    return f"{camera.width_px} x {camera.height_px} x {camera.oversampling}"


def measure(given: Namespace) -> dict[str, Any]:
    steps = 2 if given.quick else given.steps
    changes = {"driving": QUICK} if given.quick else CASES
    cases = {name: views(name.split(",")[0], change, steps) for name, change in changes.items()}
    show("A control step on one core, px x samples", cases)
    runs = {name: whole(name, QUICK if given.quick else overrides, steps) for name, (overrides, _) in RUNS.items()}
    show("Whole steps and their parts", runs)
    goals = [Goal(f"ms a step of {name}", each["ms"]["step"], RUNS[name][1]) for name, each in runs.items()]
    ratio = max(each["step to real time"] for name, each in cases.items() if "4 samples" not in name and "box" not in name)
    return {"views": cases, "runs": runs, "goals": [*goals, Goal("times real time on two cores at 640 x 480 with one lamp", ratio, 4.0)]}


if __name__ == "__main__":
    run(measure, __doc__, steps={"type": int, "default": 10, "help": "steps to take the median of (10)"})
