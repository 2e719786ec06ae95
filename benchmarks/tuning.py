"""What tuning brings, and what batches and gradients save: `python benchmarks/tuning.py [--quick]`.

Goes on where an earlier run in the same folder was, and prints a table: cost of the thesis' gains and of tuned ones over held-out seeds,
rollouts that Optuna and the gradient need, and CPU time a rollout, one by one and 64 at once.
"""

import argparse
import time
from pathlib import Path

import torch
from optuna.trial import TrialState

from loop import objective, ranges
from loop.batch import rollouts
from loop.executors import local
from loop.gradient import tune_by_gradient
from loop.run import prepare
from loop.scenario import Scenario, load
from loop.tune import STUDY, Task, Tuned, mean_cost, opened, tune

SCENARIOS = ("snowflake", "chevrons")
KEYS = (
    *("controller.position.kp=0.2:1.6", "controller.position.ki=0.01:1:log", "controller.position.kd=0.001:0.8"),
    *("controller.rotation.kp=0.1:1.2", "controller.rotation.ki=0.005:0.5:log", "controller.rotation.kd=0.001:0.6"),
    *("controller.x_rate_m=1:6", "controller.y_rate_m=0.5:3"),
)
GOAL = "settling+residual"
HELD_OUT = 1000  # seed of the first run that no tuning has seen
BATCH, STEPS, REPEATS = 64, 12, 3


def task_of(quick: bool) -> Task:
    scenarios = tuple(
        load(name, ["controller.name=thesis_pid", "steps=30" if quick else "steps=40"]) for name in SCENARIOS[: 1 if quick else 2]
    )
    return Task(scenarios, tuple(ranges.parse(key, scenarios) for key in KEYS), objective.parse(GOAL), 1 if quick else 3)


def held_out(task: Task, tuned: Tuned, seeds: int, execute: object) -> tuple[float, float]:
    """Cost of what was given and of what is best, over seeds that the tuning has not seen."""
    moved = tuple(scenario.model_copy(update={"seed": HELD_OUT}) for scenario in task.scenarios)
    fresh = Task(moved, task.ranges, task.objective, seeds)
    return mean_cost(fresh, {}, execute), mean_cost(fresh, tuned.best[0], execute)  # type: ignore[arg-type]


def rollouts_until(tuned: Tuned, cost: float) -> int | None:
    """Runs that Optuna's trials took until one was as good; None where none was."""
    runs = len(tuned.task.runs({}))
    taken = 0
    for trial in tuned.study.get_trials(deepcopy=False):
        taken += runs if trial.state == TrialState.COMPLETE else -(-runs // 2)
        if trial.state == TrialState.COMPLETE and trial.value is not None and trial.value <= cost:
            return taken
    return None


def seconds_a_rollout(scenario: Scenario) -> tuple[float, float]:
    """CPU time of a step loop without the judge, and of one of 64 rollouts at once, both without making the world ready; best of some."""
    torch.set_num_threads(1)
    simulation = prepare(scenario, "cpu")

    def timed(batch: int) -> float:
        values = {"controller.position.kp": torch.linspace(0.4, 1.0, batch), "controller.position.ki": torch.linspace(0.1, 0.5, batch)}
        start = time.thread_time()
        rollouts(simulation, values)
        return (time.thread_time() - start) / batch

    def alone() -> float:
        state, spent = simulation.start(), 0.0
        for _ in range(scenario.steps):
            start = time.thread_time()
            state, result = simulation.step(state)
            spent += time.thread_time() - start
            start = time.thread_time()
            simulation.judge(result.lights, result.time_s)
            spent -= time.thread_time() - start
        return spent

    timed(1)
    # The fastest single run is the quicker of the loop itself and a batch of one.
    single = min(min(alone(), timed(1)) for _ in range(REPEATS))
    return single, min(timed(BATCH) for _ in range(REPEATS))


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure what tuning brings and costs.")
    parser.add_argument("--quick", action="store_true", help="one scenario, one seed, few trials")
    parser.add_argument("--out", type=Path, default=Path("runs/tuning"), help="folder for the studies")
    parser.add_argument("--jobs", type=int, help="processes, by default one a core")
    given = parser.parse_args()
    execute, task = local(given.jobs), task_of(given.quick)
    trials, iterations, seeds = (30, 8, 2) if given.quick else (120, 10, 5)

    by_optuna = tune(task, given.out / "optuna", trials, execute)
    folder = given.out / "gradient"
    done = (folder / STUDY).exists() and opened(task, folder, execute)[0].get_trials(states=(TrialState.COMPLETE,))
    by_gradient = (
        Tuned(task, by_optuna.given_cost, opened(task, folder, execute)[0]) if done else tune_by_gradient(task, folder, iterations, execute)
    )

    print(f"{', '.join(each.name for each in task.scenarios)}, {GOAL}, mean over {seeds} held-out seeds")
    for name, tuned in (("Optuna", by_optuna), ("gradient", by_gradient)):
        before, after = held_out(task, tuned, seeds, execute)
        share = f"{after / before:.2f} of the thesis' gains'"
        print(f"  {name:9} {before:.3f} -> {after:.3f} ({share}), tuned {tuned.given_cost:.3f} -> {tuned.best[1]:.3f}")
    needed = rollouts_until(by_optuna, by_gradient.best[1])
    print(f"  rollouts to that cost: gradient {iterations * len(task.runs({}))}, Optuna {needed or f'not in {trials} trials'}")
    single, batched = seconds_a_rollout(load("snowflake", [f"steps={STEPS}"]))
    alone, together = f"{1e3 * single:.0f} ms alone", f"{1e3 * batched:.0f} ms of {BATCH} at once"
    print(f"  CPU time of {STEPS} steps: {alone}, {together}, {single / batched:.1f} x less")


if __name__ == "__main__":
    main()
