"""`luxloop tune`: tune scenario keys with Optuna; resumable, with the same result for any number of processes."""

import hashlib
import json
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState, create_trial

from luxloop.controllers.symbol.feedback import ThesisPidParams
from luxloop.loop.recording.manifest import digests
from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.report.terminal import progress
from luxloop.loop.scenario.model import Scenario, only
from luxloop.loop.studies.campaign import kind_of, runs_of_many
from luxloop.loop.studies.jobs import Executor, bundles, reason
from luxloop.loop.studies.objective import Objective
from luxloop.loop.studies.ranges import Range, Values, value_of, with_values
from luxloop.world.errors import LuxloopError
from luxloop.world.files import lock_file, shared_folder, writing

STUDY = "study.log"
FINISHED = (TrialState.COMPLETE, TrialState.PRUNED)
PRUNING_AFTER = 8  # trials
_START = b'{"op_code":'  # begins every line


@contextmanager
def study_in(out: Path, digest: str) -> Iterator[optuna.Study]:
    """Study in a folder; several processes may use it at the same time. digest: of its settings.

    Raises LuxloopError if the folder holds another study, is locked by another process, or cannot be written.
    """
    file = out / STUDY
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)
    remedy = "check the folder, its permissions and the room left, or give another with --out"
    with writing(file, remedy), shared_folder(out, file, partial(_mend, file, digest)):
        with lock_file(file):
            study = _open(file, digest)
        yield study


@contextmanager
def keeping(out: Path, what: Callable[[], str]) -> Iterator[None]:
    """Raise an interrupt with a message of what the study's folder holds."""
    try:
        yield
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(f"{what()} are kept in {out / STUDY}, the same command goes on from there") from error


def trial_count(study: optuna.Study) -> int:
    """Number of complete and pruned trials."""
    return len(study.get_trials(deepcopy=False, states=FINISHED))


def _mend(file: Path, digest: str) -> None:
    """Clean up after a killed process: the journal's lock, an incomplete last line, running trials."""
    file.with_name(f"{file.name}.lock").unlink(missing_ok=True)
    content = file.read_bytes()
    last = (content.splitlines(keepends=True) or [b""])[-1]
    if content.startswith(_START) or _START.startswith(content):  # otherwise it is no journal
        try:
            json.loads(last if last.endswith(b"\n") else b"")
        except (ValueError, RecursionError):
            os.truncate(file, len(content) - len(last))
    study = _open(file, digest)
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(trial.number, state=TrialState.FAIL)


def _open(file: Path, digest: str) -> optuna.Study:
    try:
        storage = JournalStorage(JournalFileBackend(str(file)))
        pruner = optuna.pruners.MedianPruner(n_startup_trials=PRUNING_AFTER)
        study = optuna.create_study(storage=storage, study_name="tune", pruner=pruner, load_if_exists=True)
    except OSError:
        raise
    except Exception as error:  # Optuna raises anything for a damaged journal
        raise LuxloopError(
            f"{file}: is not a study's journal ({str(error) or type(error).__name__}); give another folder with --out"
        ) from error
    if study.user_attrs.setdefault("task", digest) != digest:
        raise LuxloopError(
            f"{file.parent}: holds a study of other settings or of another luxloop; give another folder with --out, or remove it"
        )
    study.set_user_attr("task", digest)
    return study


FAILURES = "failures"
SETTLED = "settled"  # attribute: number of a trial's runs that settled
TRACES = "traces"  # attribute: traces of a trial's runs
PLANTS = ((1.0, 0), (0.8, 0), (1.25, 0), (1.0, 1))  # factor on the plant's gain, additional latency in steps
APART = 1_000_003  # distance between the trial seeds of two searches
STARTUP = 8  # random trials before the sampler uses results
Runs = list[dict[str, Any]]  # scenario, digests of its files (inputs) and device of each
Trace = list[list[Any]] | str  # poses, errors and whether seen, or the reason of failure
PartResult = tuple[list[float], list[Trace], int]  # costs, traces, number of runs that settled


@dataclass(frozen=True)
class Task:
    """A tuning task.

    seeds: number of runs of each scenario per trial, from the scenario's own seed on. seed: of the search. robust: whether each of these
    runs is repeated on the perturbed `PLANTS`.
    """

    scenarios: tuple[Scenario, ...]
    ranges: tuple[Range, ...]
    objective: Objective
    seeds: int = 1
    seed: int = 0
    device: str = "cpu"
    robust: bool = False

    @property
    def digest(self) -> str:
        """Digest of everything that decides a trial."""
        what = [
            [each.digest for each in self.scenarios],
            self.inputs,
            [vars(each) for each in self.ranges],
            self.objective.weights,
            self.seeds,
            self.seed,
            self.plants,
        ]
        return hashlib.sha256(json.dumps([*what, self.device, digest_of_code()]).encode()).hexdigest()

    @cached_property
    def inputs(self) -> list[dict[str, str]]:
        """Digests of each scenario's files, from the first access on."""
        return [digests(each) for each in self.scenarios]

    @property
    def start_values(self) -> dict[str, float | int | None]:
        """Values common to all scenarios by key; None if they differ, or there is none."""
        found = {each.key: {value_of(scenario, each.key) for scenario in self.scenarios} for each in self.ranges}
        return {key: values.pop() if len(values) == 1 else None for key, values in found.items()}

    @property
    def plants(self) -> tuple[tuple[float, int], ...]:
        """Factor on the plant's gain and additional latency in steps of each plant on which a run takes place, the nominal one first."""
        return PLANTS if self.robust else PLANTS[:1]

    def runs(self, values: Values) -> Runs:
        """All runs of a trial, seed by seed, those on the `plants` together."""
        varied = [[perturb(with_values(scenario, values), *plant) for plant in self.plants] for scenario in self.scenarios]
        return [
            {"scenario": {**each.model_dump(mode="json"), "seed": each.seed + k}, "inputs": files, "device": self.device}
            for k in range(self.seeds)
            for plants, files in zip(varied, self.inputs, strict=True)
            for each in plants
        ]

    def halves(self, runs: Runs) -> tuple[Runs, Runs]:
        """The runs before a trial may be pruned, and those after."""
        half = -(-len(runs) // len(self.plants) // 2) * len(self.plants)
        return runs[:half], runs[half:]

    def cost(self, costs: Sequence[float]) -> float:
        """Cost of a trial: the mean over scenarios and seeds of a run's cost; of several plants the mean of their mean and their worst."""
        of_plants = np.reshape(costs, (-1, len(self.plants)))
        return float((of_plants.mean(1) + of_plants.max(1)).mean() / 2)


def perturb(scenario: Scenario, gain: float, latency: int) -> Scenario:
    """Perturb the plant of a scenario: multiply its gain, and delay its frames by more steps.

    gain: factor. It multiplies the gains of thesis_pid, which has the same effect on the loop. latency: additional steps. Raises
    LuxloopError for another controller.
    """
    if (gain, latency) == PLANTS[0]:
        return scenario
    symbol, key = scenario.symbol, f"functions.{only(scenario.symbols)}.controller"
    if not isinstance(symbol.controller, ThesisPidParams) or symbol.controller.gain_schedule:
        raise LuxloopError(
            f"{scenario.name}: {key}: --robust scales fixed gains of thesis_pid; set {key}.name = 'thesis_pid', or leave it out"
        )
    given = {kind: getattr(symbol.controller, kind) for kind in ("position", "rotation")}
    loops = {f"{key}.{kind}.{name}": gain * getattr(given[kind], name) for kind in given for name in ("kp", "ki", "kd")}
    return with_values(scenario, {**loops, "camera.latency_steps": scenario.camera.latency_steps + latency})


@dataclass(frozen=True)
class Tuning:
    """A study: cost with the given values, and all trials."""

    task: Task
    given_cost: float
    study: optuna.Study

    @property
    def trials(self) -> list[optuna.trial.FrozenTrial]:
        """Trials that are complete or pruned."""
        return self.study.get_trials(deepcopy=False, states=FINISHED)

    @property
    def failures(self) -> list[str]:
        """Reasons of failed runs; a failed run costs `luxloop.loop.studies.objective.FAILED` in each term."""
        return [why for trial in self.trials for why in trial.user_attrs.get(FAILURES, [])]

    @property
    def never_settles(self) -> bool:
        """Whether the objective weights settling, and no run has settled."""
        attributes = [self.study.user_attrs, *(trial.user_attrs for trial in self.trials)]
        return "settling" in self.task.objective.weights and not any(each.get(SETTLED) for each in attributes)

    @property
    def best(self) -> tuple[dict[str, float | int], float]:
        """Values and cost of the best trial; no values if the given ones are best."""
        values, cost = self.study.best_params, self.study.best_value
        return (values, cost) if cost < self.given_cost else ({}, self.given_cost)


def tune(task: Task, out: Path, trials: int, execute: Executor) -> Tuning:
    """Continue a study in a folder up to a number of trials. Finished trials are stored in any case.

    Several processes in one folder share the trials. Raises LuxloopError if the folder holds another study or cannot be written, and
    KeyboardInterrupt with what is stored.
    """
    with study_in(out, task.digest) as study, keeping(out, lambda: f"{trial_count(study)} of {trials} trials"):
        shown = trial_count(study)
        with progress("trials", trials, min(shown, trials)) as advance:
            with lock_file(out / STUDY):
                space = begin(study, task, out, execute)
            while trial_batch := _next_trials(study, space, task, out, trials):
                try:
                    _try(study, trial_batch, task, execute)
                except BaseException:
                    for trial in trial_batch:
                        with suppress(OSError):
                            study.tell(trial, state=TrialState.FAIL, skip_if_finished=True)  # for another process to run
                    raise
                done = trial_count(study)  # other processes add trials, too
                advance(done - shown)
                shown = done
    return Tuning(task, study.user_attrs["given_cost"], study)


def _next_trials(study: optuna.Study, space: dict[str, BaseDistribution], task: Task, out: Path, trials: int) -> list[optuna.Trial]:
    """Next trials: first all random ones, which depend on no result, then one by one; none if all are finished or running."""
    with lock_file(out / STUDY):
        number = len(study.get_trials(deepcopy=False, states=(*FINISHED, TrialState.RUNNING)))
        asked = []
        for each in range(number, min(max(number + 1, STARTUP), trials)):
            # Seeded by the trial, so that an interrupted study continues as if it had not been interrupted.
            seed = (task.seed * APART + each) % 2**32
            study.sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=STARTUP, multivariate=True)
            asked.append(study.ask(space))
        return asked


def _try(study: optuna.Study, trials: Sequence[optuna.Trial], task: Task, execute: Executor) -> None:
    """Run some trials, which may be pruned after half of their runs; the same runs for any number of processes."""
    halves = [task.halves(task.runs(trial.params)) for trial in trials]
    left = []
    for trial, (_, rest), first in zip(trials, halves, run_parts(task, [each for each, _ in halves], execute), strict=True):
        costs, traces, settled = first
        trial.set_user_attr(FAILURES, failure_reasons(traces))
        trial.set_user_attr(SETTLED, settled)
        if not rest:
            study.tell(trial, task.cost(costs))
            continue
        trial.report(task.cost(costs), 0)
        if trial.should_prune():
            study.tell(trial, state=TrialState.PRUNED)
        else:
            left.append((trial, rest, first))
    for (trial, _, first), more in zip(left, run_parts(task, [rest for _, rest, _ in left], execute), strict=True):
        trial.set_user_attr(FAILURES, failure_reasons(first[1] + more[1]))
        trial.set_user_attr(SETTLED, first[2] + more[2])
        study.tell(trial, task.cost(first[0] + more[0]))


def note_batches(task: Task, workers: int, gradient: bool) -> str | None:
    """Sizes of a study's batches, in words; None without batches."""
    runs = task.runs({})
    first, _ = task.halves(runs)
    random, later = (max(map(len, places_of(some, workers))) for some in (first * STARTUP, runs if gradient else first))
    found = [f"up to {random} in the first {STARTUP} trials"] if random > 1 and not gradient else []
    found += [f"up to {later} in {'the others' if found else 'all trials'}"] if later > 1 else []
    return f"runs in batches of {', of '.join(found)}" if found else None


def run_all(task: Task, runs: Runs, execute: Executor) -> PartResult:
    """Costs and traces in the order of the runs, so that sums round equally, and the number of runs that settled."""
    return run_parts(task, [runs], execute)[0]


def run_parts(task: Task, parts: Sequence[Runs], execute: Executor) -> list[PartResult]:
    """Results of several parts; runs of all parts may share batches."""
    runs = [run for part in parts for run in part]
    places = places_of(runs, execute.workers)
    done = sorted(
        (each for ended in execute(_run_jobs, [[(k, runs[k]) for k in of] for of in places]) for each in ended), key=itemgetter(0)
    )
    found, begin = [], 0
    for part in parts:
        mine = done[begin : begin + len(part)]
        begin += len(part)
        settled = sum(figures.get("settle_step") is not None for _, figures, _ in mine)
        found.append(([task.objective.cost(figures) for _, figures, _ in mine], [trace for _, _, trace in mine], settled))
    return found


def places_of(runs: Runs, workers: int) -> list[list[int]]:
    """Indices of the runs in each batch (`luxloop.loop.studies.jobs.bundles`)."""
    return bundles([kind_of(run) if len(runs) > 1 else None for run in runs], workers)


def failure_reasons(traces: list[Trace]) -> list[str]:
    """Reasons of the failed runs."""
    return [trace for trace in traces if isinstance(trace, str)]


def _run_jobs(tasks: Sequence[tuple[int, dict[str, Any]]]) -> list[tuple[int, dict[str, Any], Trace]]:
    """Number, figures and trace of each run of a batch; a failed run does not stop the study."""
    found: list[tuple[int, dict[str, Any], Trace]] = []
    for (number, _), done in zip(tasks, runs_of_many([run for _, run in tasks]), strict=True):
        if isinstance(done, Exception):
            found.append((number, {}, reason(done)))
        else:
            figures, run, _ = done
            found.append((number, figures, [] if run is None else [part[0].tolist() for part in vars(run).values()]))
    return found


def begin(study: optuna.Study, task: Task, out: Path, execute: Executor) -> dict[str, BaseDistribution]:
    """Search space of a study; runs the given values first if the study has none.

    The given values are the first trial if all scenarios share them and they lie in the ranges. Raises LuxloopError if all runs with them
    fail.
    """
    if "given_cost" not in study.user_attrs:
        costs, traces, settled = run_all(task, task.runs({}), execute)
        if len(reasons := failure_reasons(traces)) == len(costs):
            (out / STUDY).unlink()  # without results, other settings may use the folder
            raise LuxloopError(f"every run with the given values fails, so there is nothing to tune; the first: {reasons[0]}")
        study.set_user_attr(TRACES, traces)
        study.set_user_attr(SETTLED, settled)
        study.set_user_attr("given_cost", task.cost(costs))
    space: dict[str, BaseDistribution] = {
        each.key: IntDistribution(int(each.low), int(each.high), each.log)
        if each.whole
        else FloatDistribution(each.low, each.high, each.log)
        for each in task.ranges
    }
    start = task.start_values
    if not study.get_trials(deepcopy=False) and all(
        (value := start[each.key]) is not None and each.low <= value <= each.high for each in task.ranges
    ):
        study.add_trial(create_trial(params=start, distributions=space, value=study.user_attrs["given_cost"]))
    return space
