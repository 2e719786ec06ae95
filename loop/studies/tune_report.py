"""Tuning with its report: history of the cost, importance of keys, best and given values."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote

import numpy as np
import optuna
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
from optuna.trial import TrialState

from luxloop.loop.report import terminal as tables
from luxloop.loop.report.style import DEFAULTS, drawing
from luxloop.loop.report.terminal import number, plural
from luxloop.loop.run import torch_device
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.studies import objective, ranges
from luxloop.loop.studies.gradient import tune_by_gradient
from luxloop.loop.studies.jobs import local
from luxloop.loop.studies.margins import LOOPS, LinearLoops, identify, worst
from luxloop.loop.studies.ranges import with_values
from luxloop.loop.studies.tune import STUDY, Task, Tuning, note_batches
from luxloop.loop.studies.tune import tune as search
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write, lock_file

BEST, REPORT, PICTURE, RESPONSES = "best.toml", "report.md", "report.png", "responses.png"
STEPS = 40  # of a step response
MARGINS = ("loop", "gain margin", "phase margin, °", "Ms", "bandwidth, Hz")
LEAST_FOR_IMPORTANCES = 10  # trials


def tune(  # noqa: PLR0913 (independent options)
    scenarios: Scenario | str | Path | Sequence[Scenario | str | Path],
    keys: Sequence[str],
    folder: Path | str | None = None,
    *,
    terms: str = "settling+residual",
    trials: int = 50,
    seeds: int = 1,
    seed: int = 0,
    jobs: int | None = None,
    device: str = "auto",
    gradient: bool = False,
    robust: bool = False,
) -> Tuning:
    """Tune keys of scenarios as `luxloop tune` (docs/tuning.md), and write study, best values and report.

    scenarios: loaded, shipped names or paths; each trial runs all of them. keys: ranges, KEY=LOW:HIGH or KEY=LOW:HIGH:log. folder: by
    default runs/tune-NAME; an interrupted study continues from there. terms: the objective. trials: their total number. seeds: runs of each
    scenario a trial, with different noise. seed: of the search. jobs: processes; by default one per core. device: "auto", "cpu" or "cuda".
    gradient: whether to descend on learnt predictions. robust: whether to run trials with other plant gains and one more late step too.
    `best` of the result has the values by key and their cost, `given_cost` the cost before. Raises LuxloopError for invalid settings before
    anything runs.
    """
    given = [scenarios] if isinstance(scenarios, Scenario | str | Path) else scenarios
    loaded = tuple(each if isinstance(each, Scenario) else load(str(each)) for each in given)
    task = task_of(loaded, keys, terms, seeds, seed, device, robust)
    return _tune(task, Path(folder or Path("runs") / f"tune-{loaded[0].name}"), trials, jobs, gradient)[0]


def task_of(scenarios: tuple[Scenario, ...], keys: Sequence[str], terms: str, seeds: int, seed: int, device: str, robust: bool) -> Task:
    """Task of a study. Raises LuxloopError for invalid settings."""
    if not keys:
        raise LuxloopError("--key: is missing; give keys with ranges, such as --key functions.symbol.controller.position.kp=0.1:2")
    tuned, cost = tuple(ranges.parse(each, scenarios) for each in keys), objective.parse(terms)
    for scenario in scenarios:
        cost.refuse(scenario)
    return Task(scenarios, tuned, cost, seeds, seed, str(torch_device(device)), robust)


def _tune(task: Task, folder: Path, trials: int, jobs: int | None, gradient: bool) -> tuple[Tuning, list[list[str]]]:
    """Tune and write best values and report; returns the table of margins, too."""
    execute = local(jobs)
    if note := note_batches(task, execute.workers, gradient):
        tables.say(note, stderr=True)
    tuned = (tune_by_gradient if gradient else search)(task, folder, trials, execute)
    return tuned, write(tuned, folder)


def do_tune(task: Task, folder: Path, trials: int, jobs: int | None, gradient: bool, played_by: str) -> Tuning:
    """Tune; write and print best values and report. played_by: arguments of `luxloop run` before `--set`."""
    tuned, margins = _tune(task, folder, trials, jobs, gradient)
    tables.show(tables.plain(("key", "given", "best"), ((f"[bold]{key}[/]", *told) for key, *told in _rows(tuned))))
    if margins:
        tables.show(tables.plain(MARGINS, margins))
    if notes := _notes(tuned):
        print(notes.strip())
    if tuned.best[0]:
        print(f"{folder / BEST} and {folder / REPORT} written; run it with: luxloop run {played_by} --set {quote(str(folder / BEST))}")
    else:
        print(f"no trial is better than the given values; {folder / REPORT} written")
    return tuned


def write(tuned: Tuning, out: Path) -> list[list[str]]:
    """Write best values, page and pictures into a folder; returns the table of margins. Raises LuxloopError on a write error."""
    loops = linear_loops(tuned)
    margins = _margins(loops)
    with lock_file(out / STUDY):  # the last process to write then has all trials
        values, cost = tuned.best
        head = (
            f"# {tuned.task.objective} of {', '.join(each.name for each in tuned.task.scenarios)}: {tuned.given_cost:.4g} -> {cost:.4g}\n"
        )
        if values:
            atomic_write(out / BEST, head + ranges.overlay(values))
        else:
            (out / BEST).unlink(missing_ok=True)
        _draw(tuned, out / PICTURE)
        if loops:
            _draw_responses(loops, out / RESPONSES)
        atomic_write(out / REPORT, page(tuned, margins))
    return margins


def linear_loops(tuned: Tuning) -> dict[str, list[LinearLoops]]:
    """Linear loops of the given and the best values in each scenario with an identified plant."""
    sets = {"given": {}, **({"best": tuned.best[0]} if tuned.best[0] else {})}
    found: dict[str, list[LinearLoops]] = {}
    for scenario in tuned.task.scenarios:
        for name, values in sets.items():
            varied = with_values(scenario, values)
            if (plant := identify(varied, tuned.task.device)) is not None:
                found.setdefault(name, []).append(LinearLoops.of(varied, plant))
    return found


def _margins(loops: Mapping[str, Sequence[LinearLoops]]) -> list[list[str]]:
    """The worst margins over the scenarios, a row for each set of values and loop."""
    return [
        [f"{loop}, {name}", *(number(None if math.isnan(value) else value, ".3g") for value in vars(each).values())]
        if each.gain
        else [f"{loop}, {name}", "unstable", "", "", ""]
        for name, of in loops.items()
        for loop, each in worst([one.margins() for one in of]).items()
    ]


def page(tuned: Tuning, margins: Sequence[Sequence[str]]) -> str:
    """The study as Markdown."""
    task = tuned.task
    pruned = sum(trial.state == TrialState.PRUNED for trial in tuned.trials)
    importances = _importances(tuned)
    *of_keys, (_, *costs) = _rows(tuned)
    rows = [
        [f"`{key}`", f"{each.low:g} to {each.high:g}", *told, number(importances.get(key), ".2f")]
        for each, (key, *told) in zip(task.ranges, of_keys, strict=True)
    ]
    terms = "".join(f"- `{name}`: {objective.TERMS[name][2]}\n" for name in task.objective.weights)
    names = ", ".join(each.name for each in task.scenarios)
    what = (
        f"{plural(len(tuned.trials), 'trial')} ({pruned} pruned halfway) of {names} with {plural(task.seeds, 'seed')} each.{_notes(tuned)}"
    )
    table = tables.markdown_table(("key", "range", "given", "best", "importance"), [*rows, ["cost", "", *costs, ""]], "llr")
    robust = ", of 0.8, 1 and 1.25 times the plant's gain and one more step of latency the mean of their mean and worst" * task.robust
    text = (
        f"# Tuning\n\n{what} The cost is `{task.objective}`{robust}:\n\n{terms}\n{table}\n\n![History, and cost over each key]({PICTURE})\n"
    )
    if not margins:
        return text
    about = "Of the loops on the linear plant identified at the target; the worst over the scenarios."
    caption = f"Error after a unit step of the road; bands over all scenarios and perturbed plants]({RESPONSES})"
    return f"{text}\n## Margins\n\n{about}\n\n{tables.markdown_table(MARGINS, margins, 'l')}\n\n![{caption}\n"


def _rows(tuned: Tuning) -> list[tuple[str, str, str]]:
    """Each key with its given and best values, and last their costs."""
    start, (values, cost) = tuned.task.start_values, tuned.best
    told = [(each.key, start[each.key], values.get(each.key, start[each.key])) for each in tuned.task.ranges]
    return [(key, number(given, ".4g"), number(best, ".4g")) for key, given, best in (*told, ("cost", tuned.given_cost, cost))]


def _notes(tuned: Tuning) -> str:
    failures = tuned.failures
    failed = f" {len(failures)} {'runs' if len(failures) > 1 else 'run'} failed, the first: {failures[0]}." if failures else ""
    one_road = len({each.road for each in tuned.task.scenarios}) == 1
    roads = " All runs are on one road, and other roads have other plant gains; name scenarios with several roads." * one_road
    return failed + (" No trial settled; raise steps." if tuned.never_settles else "") + roads


def _importances(tuned: Tuning) -> dict[str, float]:
    """Importance of each key, as shares; empty if there are too few trials."""
    complete = tuned.study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    if len(complete) < LEAST_FOR_IMPORTANCES or len({trial.value for trial in complete}) < 2:
        return {}
    return dict(get_param_importances(tuned.study, evaluator=PedAnovaImportanceEvaluator()))


def _draw(tuned: Tuning, file: Path) -> None:
    """Costs over trials, then over each key."""
    trials: list[optuna.trial.FrozenTrial] = tuned.study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    values, cost = tuned.best
    costs = np.array([trial.value for trial in trials], dtype=float)
    count = 1 + len(tuned.task.ranges)
    columns = min(count, 3)
    rows = -(-count // columns)
    with drawing(file, (3.6 * columns, 2.8 * rows), DEFAULTS) as figure:
        history, *panels = figure.subplots(rows, columns, squeeze=False).flat
        history.plot([trial.number for trial in trials], costs, "o", ms=3, alpha=0.6)
        history.plot([trial.number for trial in trials], np.minimum.accumulate(costs), label="best so far")
        history.axhline(tuned.given_cost, color="tab:red", lw=1, label="given")
        history.set_xlabel("trial")
        history.set_ylabel(f"cost: {tuned.task.objective}", fontsize=8)
        history.legend(fontsize=7)
        for axes in panels[len(tuned.task.ranges) :]:
            axes.remove()
        for axes, each in zip(panels, tuned.task.ranges, strict=False):
            axes.scatter([trial.params[each.key] for trial in trials], costs, c=[trial.number for trial in trials], s=10, cmap="viridis")
            if (given := tuned.task.start_values[each.key]) is not None:
                axes.plot(given, tuned.given_cost, "s", color="tab:red")
            if values:
                axes.plot(values[each.key], cost, "*", ms=11, color="tab:orange")
            axes.set_xscale("log" if each.log else "linear")
            axes.set_xlabel(each.key, fontsize=8)


def _draw_responses(loops: Mapping[str, Sequence[LinearLoops]], file: Path) -> None:
    """Error of each loop after a unit step of the road: nominal of the first scenario, and the band over all scenarios and plants."""
    with drawing(file, (9.0, 2.6), DEFAULTS) as figure:
        panels = figure.subplots(1, len(LOOPS), sharey=True)
        for name, colour in zip(loops, ("tab:red", "tab:orange"), strict=False):
            responses = np.concatenate([each.step_responses(STEPS) for each in loops[name]])  # [scenarios * plants, 4, steps]
            for k, axes in enumerate(panels):
                axes.fill_between(range(STEPS), responses[:, k].min(0), responses[:, k].max(0), color=colour, alpha=0.25, lw=0)
                axes.plot(responses[0, k], color=colour, label=name)
        for axes, loop in zip(panels, LOOPS, strict=True):
            axes.set_title(loop)
            axes.set_xlabel("step")
            axes.set_ylim(-1.1, 1.1)
        panels[0].set_ylabel("error")
        panels[0].legend(fontsize=7)
