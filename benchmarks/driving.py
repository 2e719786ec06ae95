"""How long a control step takes while the world moves, and its parts: `python benchmarks/driving.py`.

Every step renders two views, for the on and the off frame, as far as they are read, and lights that of the on frame.
"""

from argparse import Namespace
from collections.abc import Sequence
from typing import Any

from bench import Goal, Laps, medians, run, show

from luxloop import Simulation, load


def compare(name: str, overrides: Sequence[str], steps: int) -> dict[str, float]:
    """Medians in ms over a run's steps after the first, and of their parts by the clock's shares of these."""
    simulation = Simulation.prepare(load(name, (*overrides, "judge_every=0")))
    state, taken = simulation.start(), []
    for _ in range(steps + 1):
        laps = Laps()
        state, result = simulation.step(state)
        ms, clock_ms = laps.lap("step"), sum(result.timings.values())
        parts = {part: ms * each / clock_ms for part, each in result.timings.items()}
        taken.append({"x real time": 1e-3 * ms * simulation.scenario.rate_hz, "step": ms, **parts})
    return medians(taken[1:])


def measure(given: Namespace) -> dict[str, Any]:
    found = {name: compare(name, overrides, given.steps) for name, overrides in given.runs.items()}
    show("A step on one core and its parts, ms", found)
    return {"ms": found, "goals": [Goal(f"ms a step of {name}", each["step"], given.goals_ms[name]) for name, each in found.items()]}


if __name__ == "__main__":
    run(measure, __doc__, "steps")
