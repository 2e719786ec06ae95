"""Run a lighting scenario: recorded, filmed and reported."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pyarrow as pa
import torch
from torch import Tensor

from loop.lighting.picture import frame_picture, white_of
from loop.lighting.record import LightingRecorder
from loop.lighting.report import write_report
from loop.lighting.result import LightingResult
from loop.lighting.simulation import LightingSimulation
from loop.recording.recorder import REPORT, VIDEO, no_report
from loop.recording.video import VideoWriter
from loop.scenario.model import LightingScenario

VIDEO_FPS = 10
MOMENTS = 4  # that the report shows


def run_lighting(
    scenario: LightingScenario,
    directory: Path,
    device: torch.device,
    video: bool = True,
    report: bool = True,
    on_step: Callable[[LightingResult], None] = lambda result: None,
    on_end: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Run a scenario into a directory that is this process's own and return its summary, as `loop.run.run` does."""
    simulation = LightingSimulation.prepare(scenario, device)
    moments: dict[int, LightingResult] = {}  # first, between, and the last so far
    white: Tensor | None = None
    # the last step that tracks do not light
    first = 0 if scenario.detector is None else min(scenario.tracker.confirm_frames, scenario.steps) - 1
    kept = {first + k * (scenario.steps - 1 - first) // (MOMENTS - 1) for k in range(MOMENTS)}

    def page(table: pa.Table, summary: dict[str, Any]) -> None:
        write_report(directory / REPORT, simulation, list(moments.values())[-MOMENTS:], table)

    size = (scenario.camera.width_px, scenario.camera.height_px)
    with LightingRecorder(directory, simulation, page if report else no_report) as recorder, ExitStack() as stack:
        film = stack.enter_context(VideoWriter(directory / VIDEO, VIDEO_FPS, size)) if video else None
        stack.callback(on_end)
        for result in simulation.run():
            recorder.add(result)
            moments = {step: each for step, each in moments.items() if step in kept} | {result.step: result}
            if film is not None:
                white = white_of(result.luminance, scenario.camera) if white is None else white
                film.add(frame_picture(result, simulation, white))
            on_step(result)
    return recorder.summary()
