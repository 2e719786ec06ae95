"""What `luxloop tune` does: look for better values of a scenario's keys with Optuna, resumable, alike with any number of processes."""

import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import Any, cast

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.trial import TrialState, create_trial

from loop.jobs.executors import Executor
from loop.jobs.runner import reason
from loop.metrics import traced
from loop.objective import Objective
from loop.recording.digest import digest_of_code
from loop.recording.manifest import digests
from loop.scenario.model import Scenario
from loop.studies.campaign import checked
from loop.studies.ranges import Range, Values, changed, value_of
from loop.studies.study import FINISHED, STUDY, finished, keeping, study_in
from loop.terminal.progress import progress
from world.errors import LuxloopError
from world.folders import turn

FAILURES = "failures"
TRACES = "traces"  # of what has been run and may be learned from
APART = 1_000_003  # between the seeds of two searches' first trials, so that they share none
STARTUP = 8  # trials at random before the sampler learns
Runs = list[tuple[dict[str, Any], dict[str, str], str]]
Trace = list[list[Any]] | str  # of a run: poses, errors and whether seen (`loop.metrics.traced`), or why it failed


@dataclass(frozen=True)
class Task:
    """What is tuned. seeds: so many runs of each scenario a trial, with its own seed and those after it. seed: of the search."""

    scenarios: tuple[Scenario, ...]
    ranges: tuple[Range, ...]
    objective: Objective
    seeds: int = 1
    seed: int = 0
    device: str = "cpu"

    @property
    def digest(self) -> str:
        """Changes with everything that decides a trial."""
        what = [
            [each.digest for each in self.scenarios],
            self.inputs,
            [vars(each) for each in self.ranges],
            self.objective.weights,
            self.seeds,
            self.seed,
        ]
        return hashlib.sha256(json.dumps([*what, self.device, digest_of_code()]).encode()).hexdigest()

    @cached_property
    def inputs(self) -> list[dict[str, str]]:
        """Digests of the files of each scenario, as they were when this was first asked for."""
        return [digests(each) for each in self.scenarios]

    @property
    def given(self) -> dict[str, float | int | None]:
        """The values that all scenarios have; None where they differ, or have none."""
        found = {each.key: {value_of(scenario, each.key) for scenario in self.scenarios} for each in self.ranges}
        return {key: values.pop() if len(values) == 1 else None for key, values in found.items()}

    def runs(self, values: Values) -> Runs:
        """All runs of a trial, one seed after the other."""
        varied = [changed(scenario, values) for scenario in self.scenarios]
        seeds = range(self.seeds)
        seeded = [
            (each.model_copy(update={"seed": each.seed + k}), files) for k in seeds for each, files in zip(varied, self.inputs, strict=True)
        ]
        return [(each.model_dump(mode="json"), files, self.device) for each, files in seeded]


@dataclass(frozen=True)
class Tuned:
    """A study: cost of the scenarios as given, best values and their cost, and all trials."""

    task: Task
    given_cost: float
    study: optuna.Study

    @property
    def failures(self) -> list[str]:
        """Why runs of trials have failed, each of which counts as `loop.objective.FAILED` in all terms."""
        return [why for trial in self.study.get_trials(deepcopy=False, states=FINISHED) for why in trial.user_attrs.get(FAILURES, [])]

    @property
    def best(self) -> tuple[dict[str, float | int], float]:
        """Values and cost of the best trial; no values where the given ones are best."""
        values, cost = self.study.best_params, self.study.best_value
        return (values, cost) if cost < self.given_cost else ({}, self.given_cost)


def tune(task: Task, out: Path, trials: int, execute: Executor) -> Tuned:
    """Go on with the study in a folder until it has so many trials. What is there is kept whatever happens.

    Processes that do so in one folder share the trials. Raises LuxloopError where the folder holds another study or cannot be written;
    KeyboardInterrupt that says what is kept.
    """
    with study_in(out, task.digest) as study, keeping(out, lambda: f"{finished(study)} of {trials} trials"):
        shown = finished(study)
        with progress("trials", trials, min(shown, trials)) as advance:
            with turn(out / STUDY):
                space = begun(study, task, out, execute)
            while (trial := _asked(study, space, task, out, trials)) is not None:
                try:
                    _try(study, trial, task, execute)
                except BaseException:
                    with suppress(OSError):
                        study.tell(trial, state=TrialState.FAIL, skip_if_finished=True)  # so that another process does it
                    raise
                done = finished(study)  # others do some, too
                advance(done - shown)
                shown = done
    return Tuned(task, study.user_attrs["given_cost"], study)


def _asked(study: optuna.Study, space: dict[str, BaseDistribution], task: Task, out: Path, trials: int) -> optuna.Trial | None:
    """The next trial of a study of so many; none where all are finished or under way."""
    with turn(out / STUDY):
        number = len(study.get_trials(deepcopy=False, states=(*FINISHED, TrialState.RUNNING)))
        if number >= trials:
            return None
        # Seeded by the trial: a study that was interrupted goes on as it would have.
        seed = (task.seed * APART + number) % 2**32
        study.sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=STARTUP, multivariate=True)
        return study.ask(space)


def _try(study: optuna.Study, trial: optuna.Trial, task: Task, execute: Executor) -> None:
    """All runs of a trial; after half of them it may be given up. The same runs are done however many go on at once."""
    runs = task.runs(trial.params)
    half = -(-len(runs) // 2)
    costs, traces = ran(task, runs[:half], execute)
    trial.set_user_attr(FAILURES, failed(traces))
    if len(runs) > half:
        trial.report(float(np.mean(costs)), 0)
        if trial.should_prune():
            study.tell(trial, state=TrialState.PRUNED)
            return
        more, others = ran(task, runs[half:], execute)
        costs += more
        trial.set_user_attr(FAILURES, failed(traces + others))
    study.tell(trial, float(np.mean(costs)))


def ran(task: Task, runs: Runs, execute: Executor) -> tuple[list[float], list[Trace]]:
    """Costs and traces in the order of the runs, though they end in any, so that sums are rounded alike."""
    done = sorted(execute(_traced, list(enumerate(runs))), key=itemgetter(0))
    return [task.objective.cost(figures) for _, figures, _ in done], [trace for _, _, trace in done]


def failed(traces: list[Trace]) -> list[str]:
    """Why some of the runs have."""
    return [trace for trace in traces if isinstance(trace, str)]


def _traced(task: tuple[int, tuple[dict[str, Any], dict[str, str], str]]) -> tuple[int, dict[str, Any], Trace]:
    """Number, figures and trace of a run: a controller that loses itself is no reason to stop."""
    number, (scenario, inputs, device) = task
    try:
        figures, run = traced(cast(Scenario, checked(scenario, inputs)), device)
        return number, figures, [] if run is None else [part[0].tolist() for part in vars(run).values()]
    except Exception as error:
        return number, {}, reason(error)


def _distribution(each: Range) -> BaseDistribution:
    if each.whole:
        return IntDistribution(int(each.low), int(each.high), each.log)
    return FloatDistribution(each.low, each.high, each.log)


def begun(study: optuna.Study, task: Task, out: Path, execute: Executor) -> dict[str, BaseDistribution]:
    """The study's space; before, what the given values cost and their traces are found where the study does not know them.

    Its first trial is of the given values where all scenarios have them and they lie in the ranges: the search learns from them.
    Raises LuxloopError where all runs with them fail.
    """
    if "given_cost" not in study.user_attrs:
        costs, traces = ran(task, task.runs({}), execute)
        if len(reasons := failed(traces)) == len(costs):
            (out / STUDY).unlink()  # nothing is in it, and other settings shall not need another folder
            raise LuxloopError(f"every run with the given values fails, so there is nothing to tune; the first: {reasons[0]}")
        study.set_user_attr(TRACES, traces)
        study.set_user_attr("given_cost", float(np.mean(costs)))
    space = {each.key: _distribution(each) for each in task.ranges}
    if not study.get_trials(deepcopy=False) and all(_within(each, task.given[each.key]) for each in task.ranges):
        study.add_trial(create_trial(params=task.given, distributions=space, value=study.user_attrs["given_cost"]))
    return space


def _within(each: Range, value: float | int | None) -> bool:
    return value is not None and each.low <= value <= each.high


def mean_cost(task: Task, values: Values, execute: Executor) -> float:
    """Mean cost of all runs with some values."""
    return float(np.mean(ran(task, task.runs(values), execute)[0]))
