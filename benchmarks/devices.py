"""The loop on a CUDA device beside one core: `python benchmarks/devices.py [--json FILE] [--quick]`.

Whole steps of shipped scenarios, and batches of rollouts, on either device from the same start. In clock time, synchronised around each
step, with one thread: what does not run on the device waits for that thread. Both devices must hold the symbol at the same place.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import torch
from bench import machine, on_one_thread
from rich.table import Table

from luxloop.loop.report import terminal as tables
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch.rollouts import rollouts

PID = "functions.symbol.controller.name=thesis_pid"
RUNS: dict[str, tuple[str, tuple[str, ...]]] = {
    "snowflake, thesis_pid": ("snowflake", (PID,)),
    "snowflake, luxloop": ("snowflake", ()),
    "driving": ("driving", ()),
    "gfhb": ("gfhb", ()),
    "obl_in_traffic": ("obl_in_traffic", ()),
}
SIZE = ("camera.width_px=640", "camera.height_px=480", "judge_every=0")
QUICK_SIZE = ("camera.width_px=320", "camera.height_px=180", "judge_every=0")
STEPS, QUICK_STEPS = 12, 3
BATCHES, QUICK_BATCHES = (1, 64, 512), (1, 4)
BATCH_STEPS = 12
GAINS = {"kp": (0.4, 1.0), "ki": (0.1, 0.5)}  # of position, from the first row of a batch to the last
APART_M = 0.01  # sums of another order; noise of another generator: the loop holds what it sees


def clocked(work: Callable[[], Any], device: str) -> tuple[float, Any]:
    """Seconds of the clock until all of the work is done, and its result."""
    wait = torch.cuda.synchronize if device == "cuda" else (lambda: None)
    wait()
    before = time.perf_counter()
    found = work()
    wait()
    return time.perf_counter() - before, found


def step_ms(name: str, overrides: tuple[str, ...], device: str, steps: int) -> dict[str, Any]:
    """Median ms of a run's steps after the first three, and where its symbol was shown last, if it has one."""
    simulation = Simulation.prepare(load(name, overrides), device)
    state, taken, poses = simulation.start(), [], {}
    for _ in range(steps + 3):
        seconds, (state, result) = clocked(lambda state=state: simulation.step(state), device)
        taken.append(1e3 * seconds)
        poses = {key: held.projection.pose.tolist() for key, held in result.held.items()}
    return {"ms": median(taken[3:]), "poses": poses}


def rollout_rate(batch: int, overrides: tuple[str, ...], device: str) -> float:
    """Steps of the closed loop a second with thesis_pid, each set of gains in its row."""
    scenario = load("snowflake", (PID, f"steps={BATCH_STEPS}", *overrides))
    simulation = Simulation.prepare(scenario, device)
    values = {f"functions.symbol.controller.position.{gain}": torch.linspace(*span, batch, device=device) for gain, span in GAINS.items()}
    rollouts(simulation, values)
    seconds, _ = clocked(lambda: rollouts(simulation, values), device)
    return batch * BATCH_STEPS / seconds


def apart_m(one: dict[str, list[float]], other: dict[str, list[float]]) -> float:
    """Largest distance in x and y between the poses of the same symbols."""
    return max((abs(a - b) for name in one for a, b in zip(one[name][:2], other[name][:2], strict=True)), default=0.0)


def steps_table(rows: dict[str, dict[str, dict[str, Any]]]) -> Table:
    """ms a step on each device."""
    devices = list(next(iter(rows.values())))
    lines = ((name, *(f"{found[device]['ms']:.1f}" for device in devices)) for name, found in rows.items())
    return tables.plain(("ms a step", *devices), lines, "lr")


def main() -> None:
    """Measure, show, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the results here")
    parser.add_argument("--quick", action="store_true", help="a small camera and few steps, to see that it works")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    console, where = tables.console(), machine("torch")
    devices = ("cpu", "cuda") if torch.cuda.is_available() else ("cpu",)
    size, steps = (QUICK_SIZE, QUICK_STEPS) if arguments.quick else (SIZE, STEPS)
    console.print(", ".join(f"{key} {value}" for key, value in where.items()), markup=False)
    runs = {}
    for title, (name, overrides) in list(RUNS.items())[:1] if arguments.quick else RUNS.items():
        runs[title] = {device: step_ms(name, (*overrides, *size), device, steps) for device in devices}
        if apart := apart_m(*(runs[title][device]["poses"] for device in (devices[0], devices[-1]))):
            console.print(f"{title}: poses {apart:.4f} m apart", markup=False)
            if not apart < APART_M:
                sys.exit(f"not the same loop: {title} holds its symbol {apart:.3f} m elsewhere on the other device")
    console.print(steps_table(runs))
    rates = {
        str(batch): {device: rollout_rate(batch, size, device) for device in devices}
        for batch in (QUICK_BATCHES if arguments.quick else BATCHES)
    }
    for batch, rate in rates.items():
        each = ", ".join(f"{device} {steps_a_s:.0f}" for device, steps_a_s in rate.items())
        console.print(f"{batch} rollouts at once, steps a second: {each}", markup=False)
    if arguments.json:
        arguments.json.write_text(json.dumps({"machine": where, "runs": runs, "rollouts": rates}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    on_one_thread("OMP_NUM_THREADS")
    main()
