"""What copies at once save: `python benchmarks/batch.py [--quick] [--json FILE]`, a minute of one core.

One copy of `snowflake` on the whole simulation beside B copies that are drawn, seen and judged together, both with the judge's verdict,
step by step in turn, in one process with one thread, in process time. The copies stand where the run is in that step, or some 0.3 m.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import torch
from bench import machine, on_one_thread
from rich.table import Table

from luxloop.loop.report import terminal as tables
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch.copies import Copies
from luxloop.loop.studies.batch.looking import Taken

SIZES = ((640, 480), (1280, 720))  # px
BATCHES, STEPS = (1, 16, 64), 12
APART = (0.3, 0.1, 0.005, 0.003)  # m, m, rad, rad: standard deviation of the copies' poses
GOAL = "goal: at 64 copies at least 4 times the steps a second of single runs"


def measure(width: int, height: int, batches: tuple[int, ...], steps: int) -> dict[str, Any]:
    """Median ms of a step of a single run and of each of B copies, and their ratios."""
    simulation = Simulation.prepare(load("snowflake", [f"camera.width_px={width}", f"camera.height_px={height}", "judge_every=1"]))
    copies, generator = Copies(simulation), torch.Generator().manual_seed(0)
    state, single = simulation.start(), []
    many: dict[int, dict[str, list[float]]] = {batch: {part: [] for part in ("show", "measure", "judge")} for batch in batches}
    for step in range(steps):
        began = time.process_time()
        state, result = simulation.step(state)
        single.append(1e3 * (time.process_time() - began))
        for batch, parts in many.items():
            poses = result.symbol.pose + torch.randn(batch, 4, generator=generator) * torch.tensor(APART)
            began = time.process_time()
            light = copies.show(poses)
            shown = time.process_time()
            copies.measured(light, [Taken(seed, step) for seed in range(batch)])
            measured = time.process_time()
            copies.judged(light)
            judged = time.process_time()
            for part, taken in zip(parts, (shown - began, measured - shown, judged - measured), strict=True):
                parts[part].append(1e3 * taken / batch)
    found: dict[str, Any] = {"width": width, "height": height, "steps": steps, "single": _median(single)}
    for batch, parts in many.items():
        each = {part: _median(taken) for part, taken in parts.items()}
        whole = _median([sum(step) for step in zip(*parts.values(), strict=True)])
        found[str(batch)] = {**each, "step": whole, "ratio": found["single"] / whole}
    return found


def _median(values: list[float]) -> float:
    return float(torch.tensor(values).median())


def table(found: dict[str, Any]) -> Table:
    """A row for each number of copies."""
    shown = Table(title=f"{found['width']} x {found['height']}, ms of a step of each copy; a single run takes {found['single']:.1f} ms")
    for column in ("copies", "show", "measure", "judge", "step", "steps a second of single runs"):
        shown.add_column(column, justify="right")
    for batch in (key for key in found if key.isdecimal()):
        each = found[batch]
        shown.add_row(batch, *(f"{each[part]:.2f}" for part in ("show", "measure", "judge", "step")), f"{each['ratio']:.1f} x")
    return shown


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one small size and few steps")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args(arguments)
    sizes, batches, steps = (((320, 180),), (1, 4), 2) if given.quick else (SIZES, BATCHES, STEPS)
    found = [measure(*size, batches, steps) for size in sizes]
    for each in found:
        tables.console().print(table(each))
    print(GOAL)
    if given.json:
        given.json.write_text(json.dumps({"machine": machine("torch"), "sizes": found}, indent=1) + "\n")


if __name__ == "__main__":
    on_one_thread("OMP_NUM_THREADS", "LP_NUM_THREADS")  # the latter is Mesa's
    main()
