"""The commands that run the loop, and tell how far it is."""

import os
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import torch
from rich.markup import escape
from rich.table import Table

from loop.lighting.replay import replay as replay_lighting
from loop.lighting.result import LightingResult
from loop.lighting.summary import shown
from loop.recording.checks import lines, passed
from loop.recording.manifest import Manifest
from loop.recording.recorder import TRAJECTORY, Outputs
from loop.recording.remedies import remedies
from loop.recording.replay import Comparison, replay
from loop.run import run
from loop.scenario.model import AnyScenario, LightingScenario
from loop.symbol.simulation import StepResult
from loop.terminal import tables
from loop.terminal.progress import progress
from loop.terminal.tables import number
from world.parquet import read_parquet


def _one_thread() -> None:
    """A step's operations are too small to be shared: on a busy machine a second thread makes 20 ms into 400. OMP_NUM_THREADS overrides."""
    if "OMP_NUM_THREADS" not in os.environ:
        torch.set_num_threads(1)


def run_scenario(scenario: AnyScenario, out: Path, device: str, outputs: Outputs, checks: bool) -> bool:
    """Run, and say how it went and where the files lie; returns whether all checks have passed that were evaluated.

    Raises KeyboardInterrupt that says what was kept.
    """
    _one_thread()
    done = 0
    wanted = [name for name, is_wanted in (("report", outputs.report), ("video", outputs.video)) if is_wanted]
    writing = f"{scenario.name}: writing {' and '.join(wanted) or 'recording'}"

    with progress(scenario.name, scenario.steps) as advance:

        def on_step(result: StepResult | LightingResult) -> None:
            nonlocal done
            done = result.step + 1
            advance()

        try:
            on_end = partial(advance, 0, writing)
            result = run(scenario, out, device=device, **asdict(outputs), checks=checks, on_step=on_step, on_end=on_end)
        except KeyboardInterrupt as error:
            raise KeyboardInterrupt(f"{done} of {scenario.steps} steps are kept in {out}" if done else "nothing was recorded") from error
    table = shown if isinstance(scenario, LightingScenario) else of_symbol
    tables.show(table(result.summary, str(out)))
    if checks and not scenario.checks:
        tables.console().print(f"{scenario.name} has no [checks.NAME]", markup=False)
    return passed(result.summary)


def of_symbol(values: dict[str, Any], files: str) -> Table:
    """The closing table of a run, from the summary of a symbol."""
    x, y = values["centroid_error_percent"]
    settled = values["settle_step"]
    rows = {
        "settle step": f"{settled} of {values['steps']}" if settled is not None else "not settled",
        "centroid error": f"{number(x, '.2f')} % along, {number(y, '.2f')} % across",
        "IoU, open loop → final": f"{number(values['iou_open'], '.3f')} → {number(values['iou_final'], '.3f')}",
        "overshoot": number(values["overshoot_percent"], ".1f", " %"),
        "lost steps": str(values["lost_steps"]),
        "time a step": f"{number(values['step_ms_median'], '.1f')} ms (median)",
        **lines(values),
        "files": files,
    }
    if notes := remedies(values):
        rows["note"] = "\n".join(notes)
    return tables.facts(rows)


def compare_recording(directory: Path, allow_code: bool) -> bool:
    """Run a recording again, show how the two differ, return whether they agree."""
    manifest = Manifest.read(directory)
    again: Callable[..., Comparison] = replay_lighting if "lighting" in manifest.scenario else replay
    _one_thread()
    with progress(str(manifest.scenario.get("name")), read_parquet(directory / TRAJECTORY).num_rows) as advance:
        comparison = again(directory, on_step=lambda result: advance(), allow_code=allow_code)
    console = tables.console()
    for note in comparison.notes:
        console.print(f"note: {note}", markup=False)
    if comparison.agrees:
        console.print(f"{directory}: {comparison.steps} steps agree with the recording", markup=False)
    else:
        console.print(f"{directory}: {len(comparison.differences)} columns differ from the recording", markup=False)
        rows = (
            [f"[bold]{d.column}[/]", *map(_cell, (d.first_step, d.recorded, d.replayed, d.largest, d.largest_step, d.tolerance))]
            for d in comparison.differences
        )
        columns = ("column", "first at step", "recorded", "replayed", "largest difference", "at step", "tolerance")
        console.print(tables.plain(columns, rows))
    return comparison.agrees


def _cell(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else escape(str(value))
