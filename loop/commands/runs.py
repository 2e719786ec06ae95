"""Run and replay the loop for the command line, with a progress bar."""

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch
from rich.markup import escape

from luxloop.loop.recording.checks import Checks, success
from luxloop.loop.recording.manifest import PAGES, SUMMARY, TRAJECTORY, Manifest
from luxloop.loop.recording.record import row
from luxloop.loop.recording.replay import load_to_rerun, replay, rerun
from luxloop.loop.report import terminal as tables
from luxloop.loop.report.highlights import Highlights
from luxloop.loop.report.run_table import summary_table
from luxloop.loop.run import run
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.result import StepResult
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.arrays import read_parquet
from luxloop.world.errors import LuxloopError
from luxloop.world.files import content
from luxloop.world.validation import parsed_json


def _one_thread() -> None:
    """Use one thread unless OMP_NUM_THREADS is set: a step's operations are small, and on a busy machine a second thread turns 20 ms into
    400.
    """
    if "OMP_NUM_THREADS" not in os.environ:
        torch.set_num_threads(1)


def run_scenario(scenario: Scenario, out: Path, device: str, checks: bool, kept: Mapping[str, Any]) -> bool:
    """Run a scenario and print summary and folder; returns whether all evaluated checks passed. kept: files to write, keyword arguments of
    `luxloop.loop.run.run`. Raises KeyboardInterrupt that says how many steps are kept.
    """
    _one_thread()
    done = 0
    wanted = [name for name in ("report", "video") if kept[name]]
    writing = f"{scenario.name}: writing {' and '.join(wanted) or 'recording'}"

    with tables.progress(scenario.name, scenario.steps) as advance:

        def on_step(result: StepResult) -> None:
            nonlocal done
            done = result.step + 1
            advance()

        try:
            on_end = partial(advance, 0, writing)
            result = run(scenario, out, device=device, checks=checks, on_step=on_step, on_end=on_end, **kept)
        except KeyboardInterrupt as error:
            raise KeyboardInterrupt(f"{done} of {scenario.steps} steps are kept in {out}" if done else "nothing was recorded") from error
    tables.show(summary_table(result.summary, str(out)))
    left_out = sum(check.compare is not None for check in scenario.checks.values())
    if left_out and not checks:
        word = "compares" if left_out == 1 else "compare"
        tables.say(f"{tables.plural(left_out, 'more check')} {word} with another light: --checks")
    if checks and not scenario.checks:
        tables.say(f"{scenario.name} has no [checks.NAME]")
    return success(result.summary)


def compare_recording(directory: Path, allow_code: bool) -> bool:
    """Run a recording again and print the differences; returns whether the replay agrees."""
    manifest = Manifest.read(directory)
    _one_thread()
    with tables.progress(str(manifest.scenario.get("name")), read_parquet(directory / TRAJECTORY).num_rows) as advance:
        comparison = replay(directory, on_step=lambda result: advance(), allow_code=allow_code)
    for note in comparison.notes:
        tables.say(f"note: {note}")
    if comparison.agrees:
        tables.say(f"{directory}: {comparison.steps} steps agree with the recording")
    else:
        tables.say(f"{directory}: {len(comparison.differences)} columns differ from the recording")
        rows = (
            [f"[bold]{d.column}[/]", *map(_cell, (d.first_step, d.recorded, d.replayed, d.largest, d.largest_step, d.tolerance))]
            for d in comparison.differences
        )
        columns = ("column", "first at step", "recorded", "replayed", "largest difference", "at step", "tolerance")
        tables.show(tables.plain(columns, rows))
    return comparison.agrees


def draw_report(directory: Path, out: Path, allow_code: bool) -> Path:
    """Run a recording again and draw its page. Raises LuxloopError as `replay`, and for another format."""
    from luxloop.loop.report.page import write_report  # imports Matplotlib

    if out.suffix.lower() not in {Path(each).suffix for each in PAGES}:
        raise LuxloopError(f"{out}: a report is a .png, .pdf or .svg file; give another name with --out")
    recording, summary = load_to_rerun(directory, allow_code), parsed_json(content(directory / SUMMARY))
    _one_thread()
    first = Simulation.prepare(recording.scenario)
    highlights, now = Highlights(first), first
    compared = any(each["compare"] for each in summary["checks"].values())
    checks = Checks(recording.scenario.checks, (lambda light: map(row, first.lit_by(light).evaluations())) if compared else None)
    with tables.progress(recording.scenario.name, recording.table.num_rows) as advance:
        for simulation, result in rerun(recording, first):
            if simulation is not now:
                highlights.edit(now := simulation)
            highlights.add(result)
            checks.step(result)
            advance()
    summary["checks"] = checks.outcomes(recording.table)
    write_report(out, now, highlights, checks.with_full_light(recording.table), summary, recording.manifest)
    return out


def _cell(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else escape(str(value))
