"""The commands that run the loop, and tell how far it is."""

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch

from loop.lighting.replay import replay as replay_lighting
from loop.lighting.result import LightingResult
from loop.lighting.summary import shown
from loop.recording.manifest import Manifest
from loop.recording.recorder import TRAJECTORY
from loop.recording.replay import Comparison, read_parquet, replay
from loop.run import run
from loop.scenario.model import LightingScenario, load_any
from loop.symbol.simulation import StepResult
from loop.terminal import tables
from loop.terminal.progress import progress


def _one_thread() -> None:
    """A step's operations are too small to be shared: on a busy machine a second thread makes 20 ms into 400. OMP_NUM_THREADS overrides."""
    if "OMP_NUM_THREADS" not in os.environ:
        torch.set_num_threads(1)


def run_scenario(
    name: str, out: Path, overrides: Sequence[str], values: dict[str, Any], device: str, video: bool, report: bool, allow_code: bool
) -> None:
    """Run, and say how it went and where the files lie. Raises KeyboardInterrupt that says what was kept."""
    scenario = load_any(name, overrides, allow_code=allow_code, **values)
    _one_thread()
    done = 0
    wanted = [name for name, is_wanted in (("report", report), ("video", video)) if is_wanted]
    writing = f"{scenario.name}: writing {' and '.join(wanted) or 'recording'}"

    with progress(scenario.name, scenario.steps) as advance:

        def on_step(result: StepResult | LightingResult) -> None:
            nonlocal done
            done = result.step + 1
            advance()

        try:
            result = run(scenario, out, device=device, video=video, report=report, on_step=on_step, on_end=partial(advance, 0, writing))
        except KeyboardInterrupt as error:
            raise KeyboardInterrupt(f"{done} of {scenario.steps} steps are kept in {out}" if done else "nothing was recorded") from error
    table = shown if isinstance(scenario, LightingScenario) else tables.summary
    tables.show(table(result.summary, str(out)))


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
        console.print(tables.differences(comparison.differences))
    return comparison.agrees
