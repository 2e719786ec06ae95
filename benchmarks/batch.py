"""What copies at once save: `python benchmarks/batch.py [--quick] [--json FILE]`, a minute of one core.

A step of `snowflake` on the whole simulation beside B copies that are drawn, measured and evaluated together. The copies' poses scatter
by some 0.3 m around the run's pose in that step.
"""

from argparse import Namespace
from typing import Any

import torch
from bench import Goal, Laps, medians, run, show

from luxloop import Simulation, load
from luxloop.loop.studies.batch.copies import Conditions, Copies


def compare(given: Namespace, width: int, height: int) -> dict[str, dict[str, float]]:
    """Median ms of a step of a single run and of each of B copies, and their ratios."""
    simulation = Simulation.prepare(load("snowflake", [f"camera={{width_px={width}, height_px={height}}}", "judge_every=1"]))
    copies, generator = Copies(simulation), torch.Generator().manual_seed(0)
    state = simulation.start()
    taken = {name: [] for name in ("single run", *map(str, given.batches))}
    for step in range(given.steps):
        laps = Laps()
        state, result = simulation.step(state)
        (pose,) = (each.pose for each in result.planning.projections.values())
        taken["single run"].append({"step": laps.lap("step")})
        for batch in given.batches:
            poses = pose + torch.randn(batch, 4, generator=generator) * torch.tensor(given.spread)
            laps = Laps()
            light = copies.show(poses)
            laps.lap("show")
            copies.measure(light, [Conditions(seed, step) for seed in range(batch)])
            laps.lap("measure")
            copies.evaluate(light)
            laps.lap("evaluate")
            taken[str(batch)].append({part: ms / batch for part, ms in (laps.parts | {"step": sum(laps.parts.values())}).items()})
    ms = {name: medians(each) for name, each in taken.items()}
    return {name: each | {"speed-up": ms["single run"]["step"] / each["step"]} for name, each in ms.items()}


def measure(given: Namespace) -> dict[str, Any]:
    found = {f"{width} x {height} px": compare(given, width, height) for width, height in given.sizes_px}
    for size, each in found.items():
        show(f"ms a step and copy, {size}", each)
    most = str(given.batches[-1])
    goals = [Goal(f"speed-up by {most} copies, {size}", each[most]["speed-up"], 4.0, True) for size, each in found.items()]
    return {"ms": found, "goals": goals}


if __name__ == "__main__":
    run(measure, __doc__)
