"""What tuning brings, and what batches and gradients save: `python benchmarks/tuning.py [--quick]`, 2 minutes of one core, or 5.

Tunes by `luxloop tune`, with trials and by gradient, and tries what is found on noise that neither has seen. Goes on where an earlier run
in the same folder was. Prints the tables of docs/tuning.md.
"""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from bench import Goal, Laps, run, show
from optuna.trial import TrialState

from luxloop import Scenario, load, prepare
from luxloop.loop.studies import objective, ranges
from luxloop.loop.studies.batch.rollouts import rollouts
from luxloop.loop.studies.jobs import Executor, local
from luxloop.loop.studies.tune import Task, Tuning, run_all
from luxloop.loop.studies.tune_report import do_tune

HELD_OUT = 1000  # seed of the first run that no tuning has seen
BATCH, REPEATS = 64, 3


def rollouts_of(tuned: Tuning, until: float = float("-inf")) -> int:
    """Rollouts of a study until a trial cost no more than that, or in all; of one given up, half. An iteration by gradient is a trial."""
    runs, count = len(tuned.task.runs({})), 0
    for trial in tuned.study.get_trials(deepcopy=False):
        count += runs if trial.state == TrialState.COMPLETE else -(-runs // 2)
        if trial.state == TrialState.COMPLETE and trial.value is not None and trial.value <= until:
            break
    return count


def held_out(task: Task, values: ranges.Values, seeds: int, execute: Executor) -> float:
    """Mean cost over noise that no tuning has seen."""
    moved = tuple(scenario.model_copy(update={"seed": HELD_OUT}) for scenario in task.scenarios)
    there = replace(task, scenarios=moved, seeds=seeds)
    return float(np.mean(run_all(there, there.runs(values), execute)[0]))


def figures(tuned: Tuning, seeds: int, execute: Executor) -> dict[str, Any]:
    """A way of tuning: costs over seeds held out with the thesis' gains and the best, and rollouts."""
    values, cost = tuned.best
    given, best = (held_out(tuned.task, each, seeds, execute) for each in ({}, values))
    counts = {"rollouts": rollouts_of(tuned), "to the best": rollouts_of(tuned, cost)}
    return {"thesis' gains": given, "tuned": best, "ratio": best / given, **counts}


def rollout_ms(scenario: Scenario) -> tuple[float, float]:
    """CPU time of a rollout alone, and of one of 64 at once, both in a world that is prepared; best of some."""
    simulation = prepare(scenario.model_copy(update={"judge_every": 0}), "cpu")

    def together(batch: int) -> float:
        gains = {"kp": torch.linspace(0.4, 1.0, batch), "ki": torch.linspace(0.1, 0.5, batch)}
        laps = Laps()
        rollouts(simulation, {f"functions.symbol.controller.position.{name}": values for name, values in gains.items()})
        return laps.lap("")

    def alone() -> float:
        laps = Laps()
        list(simulation.run())
        return laps.lap("")

    together(1)
    single = min(min(alone(), together(1)) for _ in range(REPEATS))  # whichever is quicker
    return single, min(together(BATCH) for _ in range(REPEATS)) / BATCH


def measure(given: Namespace) -> dict[str, Any]:
    execute, out, seeds = local(given.jobs or None), Path(given.out) / given.folder, given.seeds
    scenarios = tuple(load(name, given.settings) for name in given.scenarios)
    keys = tuple(ranges.parse(f"functions.symbol.controller.{key}={span}", scenarios) for key, span in given.spans.items())
    task = Task(scenarios, keys, objective.parse("settling+residual"))
    ways = {
        way: figures(do_tune(task, out / way, count, given.jobs or None, way == "gradient", given.scenarios[0]), seeds, execute)
        for way, count in given.trials.items()
    }
    single_ms, batch_ms = rollout_ms(load("snowflake", [given.settings[0], "steps=12"]))
    by_trials, gradient = ways.values()
    show(f"Cost over {seeds} other kinds of noise", ways)
    goals = [
        Goal("cost of what trials find over held-out seeds, to that of the thesis' gains", by_trials["ratio"], 0.5),
        Goal("the same of what the gradient finds", gradient["ratio"], 0.5),
        Goal("cost of what the gradient finds, to that of what trials find", gradient["tuned"] / by_trials["tuned"], 1.0),
        Goal("rollouts by gradient, to those of all trials", gradient["rollouts"] / by_trials["rollouts"], 0.1),
        Goal(f"CPU time of a rollout alone, to that of one of {BATCH} at once", single_ms / batch_ms, 3.0, True),
    ]
    return {
        "scenarios": given.scenarios,
        "ways": ways,
        "ms a rollout": {"alone": single_ms, f"of {BATCH} at once": batch_ms},
        "goals": goals,
    }


if __name__ == "__main__":
    run(measure, __doc__, "out", "jobs")
