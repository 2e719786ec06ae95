"""The loop on a CUDA device beside one core: `python benchmarks/devices.py [--json FILE] [--quick]`.

Whole steps of shipped scenarios, and batches of rollouts, on either device from the same start. In clock time, synchronised around each
step, with one thread. Both devices must hold the symbol at the same place.
"""

import sys
import time
from argparse import Namespace
from collections.abc import Callable
from statistics import median
from typing import Any

import torch
from bench import run, show

from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch.rollouts import rollouts

PID = "functions.symbol.controller.name=thesis_pid"
RUNS: dict[str, tuple[str, tuple[str, ...]]] = {
    "snowflake, thesis_pid": ("snowflake", (PID,)),
    "snowflake, luxloop": ("snowflake", ()),
    **{name: (name, ()) for name in ("driving", "gfhb", "obl_in_traffic")},
}
SIZE = ("camera.width_px=640", "camera.height_px=480", "judge_every=0")
QUICK_SIZE = ("camera.width_px=320", "camera.height_px=180", "judge_every=0")
BATCHES, BATCH_STEPS, WARM_UPS = (1, 64, 512), 12, 3
GAINS = {"kp": (0.4, 1.0), "ki": (0.1, 0.5)}  # of position, from the first row of a batch to the last
TOLERANCE_M = 0.01  # sums of another order, noise of another generator


def clock(work: Callable[[], Any], device: str) -> tuple[float, Any]:
    """Seconds until all of the work is done, and its result."""
    wait = torch.cuda.synchronize if device == "cuda" else (lambda: None)
    wait()
    before = time.perf_counter()
    found = work()
    wait()
    return time.perf_counter() - before, found


def steps_of(name: str, overrides: tuple[str, ...], device: str, steps: int) -> dict[str, Any]:
    """Median ms of a run's steps, and the last poses of its symbols."""
    simulation = Simulation.prepare(load(name, overrides), device)
    state, taken, poses = simulation.start(), [], {}
    for _ in range(steps + WARM_UPS):
        seconds, (state, result) = clock(lambda state=state: simulation.step(state), device)
        taken.append(1e3 * seconds)
        poses = {key: each.pose.tolist() for key, each in result.planning.projections.items()}
    return {"ms": median(taken[WARM_UPS:]), "poses": poses}


def rollout_rate(batch: int, overrides: tuple[str, ...], device: str) -> float:
    """Steps of the closed loop a second with thesis_pid, a set of gains a row."""
    simulation = Simulation.prepare(load("snowflake", (PID, f"steps={BATCH_STEPS}", *overrides)), device)
    values = {f"functions.symbol.controller.position.{gain}": torch.linspace(*span, batch, device=device) for gain, span in GAINS.items()}
    rollouts(simulation, values)
    return batch * BATCH_STEPS / clock(lambda: rollouts(simulation, values), device)[0]


def distance_m(one: dict[str, list[float]], other: dict[str, list[float]]) -> float:
    """Largest difference in x and y between the poses of the same symbols."""
    return max((abs(a - b) for name in one for a, b in zip(one[name][:2], other[name][:2], strict=True)), default=0.0)


def measure(given: Namespace) -> dict[str, Any]:
    devices = ("cpu", "cuda") if torch.cuda.is_available() else ("cpu",)
    size, steps, batches, names = (QUICK_SIZE, 3, (1, 4), list(RUNS)[:1]) if given.quick else (SIZE, 12, BATCHES, list(RUNS))
    runs = {}
    for title in names:
        name, overrides = RUNS[title]
        runs[title] = {device: steps_of(name, (*overrides, *size), device, steps) for device in devices}
        if not (apart := distance_m(*(runs[title][device]["poses"] for device in (devices[0], devices[-1])))) < TOLERANCE_M:
            sys.exit(f"not the same loop: {title} holds its symbol {apart:.3f} m elsewhere on the other device")
    ms = {title: {device: each["ms"] for device, each in found.items()} for title, found in runs.items()}
    show("ms a step", ms)
    rates = {str(batch): {device: rollout_rate(batch, size, device) for device in devices} for batch in batches}
    show("Steps a second of rollouts at once", rates)
    return {"ms": ms, "rollouts": rates}


if __name__ == "__main__":
    run(measure, __doc__)
