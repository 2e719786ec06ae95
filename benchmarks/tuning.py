"""What tuning brings, and what batches and gradients save: `python benchmarks/tuning.py [--quick]`, 2 minutes of one core, or 5.

Tunes by `luxloop tune`, with trials and by gradient, and tries what is found on noise that neither has seen. Goes on where an earlier run
in the same folder was. `--page` writes the figures into docs/tuning.md as well.
"""

import argparse
import json
import re
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bench
import numpy as np
import torch
from optuna.trial import TrialState

from luxloop.loop.report import terminal as tables
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.studies import objective, ranges
from luxloop.loop.studies.batch.rollouts import rollouts
from luxloop.loop.studies.jobs.executors import Executor, local
from luxloop.loop.studies.tune import Task, Tuned, ran
from luxloop.loop.studies.tune_report import do_tune

DOCS = Path(__file__).parents[1] / "docs" / "tuning.md"
HEADING = "## What it brings"
SETTINGS = ("functions.symbol.controller.name=thesis_pid", "steps=30", "camera.width_px=640", "camera.height_px=360")
KEYS = (
    *(
        "functions.symbol.controller.position.kp=0.2:1.6",
        "functions.symbol.controller.position.ki=0.01:1:log",
        "functions.symbol.controller.position.kd=0.001:0.8",
    ),
    *(
        "functions.symbol.controller.rotation.kp=0.1:1.2",
        "functions.symbol.controller.rotation.ki=0.005:0.5:log",
        "functions.symbol.controller.rotation.kd=0.001:0.6",
    ),
    *("functions.symbol.controller.x_rate_m=1:6", "functions.symbol.controller.y_rate_m=0.5:3"),
)
GOAL = "settling+residual"
HELD_OUT = 1000  # seed of the first run that no tuning has seen
BATCH, STEPS, REPEATS = 64, 12, 3


@dataclass(frozen=True)
class Size:
    """scenarios: by name. held_out: runs of each, to try what was found."""

    quick: bool
    scenarios: tuple[str, ...]
    trials: int
    iterations: int
    held_out: int


QUICK = Size(True, ("snowflake",), 40, 4, 3)
FULL = Size(False, ("snowflake", "chevrons"), 60, 4, 5)


def rolled_out(tuned: Tuned, until: float = float("-inf")) -> int:
    """Rollouts of a study until a trial cost no more than that, or in all; of one given up, half. An iteration by gradient is a trial."""
    runs, taken = len(tuned.task.runs({})), 0
    for trial in tuned.study.get_trials(deepcopy=False):
        taken += runs if trial.state == TrialState.COMPLETE else -(-runs // 2)
        if trial.state == TrialState.COMPLETE and trial.value is not None and trial.value <= until:
            break
    return taken


def held_out(task: Task, values: ranges.Values, seeds: int, execute: Executor) -> float:
    """Mean cost over noise that no tuning has seen."""
    moved = tuple(scenario.model_copy(update={"seed": HELD_OUT}) for scenario in task.scenarios)
    there = replace(task, scenarios=moved, seeds=seeds)
    return float(np.mean(ran(there, there.runs(values), execute)[0]))


def found(name: str, tuned: Tuned, size: Size, execute: Executor) -> dict[str, Any]:
    """A way of tuning in figures."""
    values, cost = tuned.best
    given, best = (held_out(tuned.task, each, size.held_out, execute) for each in ({}, values))
    return {
        "way": name,
        "values": values,
        "tuned on": {"given": tuned.given_cost, "best": cost},
        "held out": {"given": given, "best": best, "ratio": best / given},
        "rollouts": rolled_out(tuned),
        "rollouts to the best": rolled_out(tuned, cost),
    }


def seconds_a_rollout(scenario: Scenario) -> tuple[float, float]:
    """CPU time of a step loop without the judge, and of one of 64 rollouts at once, both without making the world ready; best of some."""
    torch.set_num_threads(1)
    simulation = prepare(scenario.model_copy(update={"judge_every": 0}), "cpu")

    def timed(batch: int) -> float:
        values = {
            "functions.symbol.controller.position.kp": torch.linspace(0.4, 1.0, batch),
            "functions.symbol.controller.position.ki": torch.linspace(0.1, 0.5, batch),
        }
        start = time.thread_time()
        rollouts(simulation, values)
        return (time.thread_time() - start) / batch

    def alone() -> float:
        state = simulation.start()
        start = time.thread_time()
        for _ in range(scenario.steps):
            state, _ = simulation.step(state)
        return time.thread_time() - start

    timed(1)
    # The fastest single run is the quicker of the loop itself and a batch of one.
    single = min(min(alone(), timed(1)) for _ in range(REPEATS))
    return single, min(timed(BATCH) for _ in range(REPEATS))


def measured(size: Size, out: Path, execute: Executor, jobs: int | None) -> dict[str, Any]:
    """All figures."""
    scenarios = tuple(load(name, SETTINGS) for name in size.scenarios)
    task = Task(scenarios, tuple(ranges.parse(key, scenarios) for key in KEYS), objective.parse(GOAL))

    def by(way: str, count: int, gradient: bool) -> dict[str, Any]:
        tuned = do_tune(task, out / way, count, jobs, gradient, size.scenarios[0])
        return found(way, tuned, size, execute)

    ways = [by("trials", size.trials, False), by("gradient", size.iterations, True)]
    single, batched = seconds_a_rollout(load("snowflake", [*SETTINGS[:1], f"steps={STEPS}"]))
    trials, gradient = ways
    goals: list[bench.Goal] = [
        ("cost of what trials find over held-out seeds, to that of the thesis' gains", trials["held out"]["ratio"], 0.5, False),
        ("the same of what the gradient finds", gradient["held out"]["ratio"], 0.5, False),
        (
            "cost of what the gradient finds, to that of what trials find",
            gradient["held out"]["best"] / trials["held out"]["best"],
            1.0,
            False,
        ),
        ("rollouts by gradient, to those of all trials", gradient["rollouts"] / trials["rollouts"], 0.1, False),
        ("CPU time of a rollout alone, to that of one of 64 at once", single / batched, 3.0, True),
    ]
    return {
        "machine": bench.machine("torch", "optuna"),
        "scenarios": [each.name for each in task.scenarios],
        "steps": scenarios[0].steps,
        "size": vars(size),
        "ways": ways,
        "ms a rollout": {"alone": 1e3 * single, f"of {BATCH} at once": 1e3 * batched},
        "goals": bench.judged(goals),
    }


def section(content: dict[str, Any]) -> str:
    """The figures as a section of the page."""
    machine, size = content["machine"], content["size"]
    rows = []
    for each in content["ways"]:
        costs = each["held out"]
        ways = (f"{costs['given']:.3f}", f"{costs['best']:.3f}", f"{costs['ratio']:.2f}")
        rows.append((each["way"], *ways, each["rollouts"], each["rollouts to the best"]))
    table = tables.markdown(("", "thesis' gains", "tuned", "ratio", "rollouts", "to the best"), rows)
    command = f"python benchmarks/tuning.py{' --quick' if size['quick'] else ''} --page"
    where = f"Measured on {machine['date']} by `{command}` ({machine['processor']}, torch {machine['torch']})"
    what = (
        f"Eight gains and rate limits of `thesis_pid` on {' and '.join(content['scenarios'])}, {content['steps']} steps, `{GOAL}`:\n"
        f"{size['trials']} trials, and {size['iterations']} iterations by gradient, a run of each scenario a trial. "
        f"Costs are means over {size['held_out']} other kinds of noise."
    )
    return "\n".join([HEADING, "", f"{where}. {what}", "", table, "", bench.goals_page(content["goals"]), ""])


def written(page: str, made: str) -> str:
    """A page whose section of that heading is another."""
    return re.sub(rf"^{HEADING}\n.*?(?=^## |\Z)", lambda _: made + "\n", page, flags=re.DOTALL | re.MULTILINE)


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure what tuning brings and costs.")
    parser.add_argument("--quick", action="store_true", help="one scenario, half of the trials")
    parser.add_argument("--out", type=Path, default=Path("runs/tuning"), help="folder for the studies and tuning.json")
    parser.add_argument("--jobs", type=int, help="processes, by default one a core")
    parser.add_argument("--page", nargs="?", type=Path, const=DOCS, help="page whose figures become these (docs/tuning.md)")
    given = parser.parse_args()
    out = given.out / ("quick" if given.quick else "full")
    content = measured(QUICK if given.quick else FULL, out, local(given.jobs), given.jobs)
    (out / "tuning.json").write_text(json.dumps(content, indent=2), "utf-8")
    made = section(content)
    print(made)
    if given.page:
        given.page.write_text(written(given.page.read_text("utf-8"), made), "utf-8")
    bench.show_goals(tables.console(), content["goals"])


if __name__ == "__main__":
    main()
