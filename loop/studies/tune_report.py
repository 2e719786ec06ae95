"""Tuning with its report: history of the cost, importance of keys, best and given values."""

from pathlib import Path
from shlex import quote

import numpy as np
import optuna
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
from optuna.trial import TrialState

from luxloop.loop.report import terminal as tables
from luxloop.loop.report.style import DEFAULTS, drawing
from luxloop.loop.report.terminal import number, plural
from luxloop.loop.studies import objective, ranges
from luxloop.loop.studies.gradient import tune_by_gradient
from luxloop.loop.studies.jobs import local
from luxloop.loop.studies.tune import STUDY, Task, Tuning, note_batches, tune
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write, lock_file

BEST, REPORT, PICTURE = "best.toml", "report.md", "report.png"
LEAST_FOR_IMPORTANCES = 10  # trials


def do_tune(task: Task, folder: Path, trials: int, processes: int | None, gradient: bool, played_by: str) -> Tuning:
    """Tune; write and print best values and report. played_by: arguments of `luxloop run` before `--set`.

    Raises LuxloopError for invalid settings before anything runs.
    """
    if not task.ranges:
        raise LuxloopError("--key: is missing; give keys with ranges, such as --key functions.symbol.controller.position.kp=0.1:2")
    execute = local(processes)
    if note := note_batches(task, execute.workers, gradient):
        tables.say(note, stderr=True)
    tuned = (tune_by_gradient if gradient else tune)(task, folder, trials, execute)
    write(tuned, folder)
    tables.show(tables.plain(("key", "given", "best"), ((f"[bold]{key}[/]", *told) for key, *told in _rows(tuned))))
    if notes := _notes(tuned):
        print(notes.strip())
    if tuned.best[0]:
        print(f"{folder / BEST} and {folder / REPORT} written; run it with: luxloop run {played_by} --set {quote(str(folder / BEST))}")
    else:
        print(f"no trial is better than the given values; {folder / REPORT} written")
    return tuned


def write(tuned: Tuning, out: Path) -> None:
    """Write best values, page and picture into a folder. Raises LuxloopError on a write error."""
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
        atomic_write(out / REPORT, page(tuned))


def page(tuned: Tuning) -> str:
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
    return f"# Tuning\n\n{what} The cost is `{task.objective}`:\n\n{terms}\n{table}\n\n![History, and cost over each key]({PICTURE})\n"


def _rows(tuned: Tuning) -> list[tuple[str, str, str]]:
    """Each key with its given and best values, and last their costs."""
    start, (values, cost) = tuned.task.start_values, tuned.best
    told = [(each.key, start[each.key], values.get(each.key, start[each.key])) for each in tuned.task.ranges]
    return [(key, number(given, ".4g"), number(best, ".4g")) for key, given, best in (*told, ("cost", tuned.given_cost, cost))]


def _notes(tuned: Tuning) -> str:
    failures = tuned.failures
    failed = f" {len(failures)} {'runs' if len(failures) > 1 else 'run'} failed, the first: {failures[0]}." if failures else ""
    return failed + (" No trial settled; raise steps." if tuned.never_settles else "")


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
