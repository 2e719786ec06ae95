"""Run a lighting scenario: recorded, filmed and reported."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pyarrow as pa
from torch import Tensor

from loop.lighting.picture import frame_picture, white_of
from loop.lighting.record import LightingRecorder
from loop.lighting.report import write_report
from loop.lighting.result import LightingResult
from loop.lighting.simulation import LightingSimulation
from loop.recording.checks import Checks
from loop.recording.recorder import REPORT, VIDEO, Outputs, no_report
from loop.recording.video import VideoWriter
from perception.tracking import TrackerParams

VIDEO_FPS = 10
MOMENTS = 4  # that the report shows


def run_lighting(
    simulation: LightingSimulation,
    directory: Path,
    checks: Checks[LightingResult],
    outputs: Outputs,
    on_step: Callable[[LightingResult], None],
    on_end: Callable[[], None],
) -> dict[str, Any]:
    """Run a scenario into a directory that is this process's own and return its summary, as `loop.run.run` does."""
    scenario = simulation.scenario
    moments: dict[int, LightingResult] = {}  # first, between, and the last so far
    white: Tensor | None = None
    tracker = scenario.tracker
    # the last step that tracks do not light
    frames = scenario.camera.latency_steps + tracker.confirm_frames if scenario.detector and isinstance(tracker, TrackerParams) else 1
    first = min(frames, scenario.steps) - 1
    kept = {first + k * (scenario.steps - 1 - first) // (MOMENTS - 1) for k in range(MOMENTS)}

    def page(table: pa.Table, summary: dict[str, Any]) -> None:
        write_report(directory / REPORT, simulation, list(moments.values())[-MOMENTS:], table)

    size = (scenario.camera.width_px, scenario.camera.height_px)
    drawn = page if outputs.report else no_report
    with LightingRecorder(directory, simulation, drawn, checks.outcomes, outputs.frames) as recorder, ExitStack() as stack:
        film = stack.enter_context(VideoWriter(directory / VIDEO, VIDEO_FPS, size)) if outputs.video else None
        stack.callback(on_end)
        for result in simulation.run():
            recorder.add(result)
            checks.step()
            moments = {step: each for step, each in moments.items() if step in kept} | {result.step: result}
            if film is not None:
                white = white_of(result.luminance, scenario.camera) if white is None else white
                film.add(frame_picture(result, simulation, white))
            on_step(result)
    return recorder.summary()
