"""Run a scenario: recorded, filmed and reported. The command line and Python programs use it alike."""

import gc
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pyarrow as pa
import torch

from luxloop.controllers.symbol.sensing.field import SIDES, cut
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.loop.recording.checks import Checks
from luxloop.loop.recording.labels import Layout, choose_labels
from luxloop.loop.recording.manifest import REPORT, TRAJECTORY, VIDEO
from luxloop.loop.recording.record import refuse_unknown_columns, row
from luxloop.loop.recording.remedies import target_remedies
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.scenario.plant import shadow_of
from luxloop.loop.simulation.commanded import unmoved
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.loop.simulation.digitised import DigitisedPlant, needs_rig
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.protocol import Plant
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.arrays import read_parquet
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import output_folder

VIDEO_FPS = 10  # slower than most loops, so that the eye can follow their steps


@dataclass(frozen=True, eq=False, repr=False)
class RunResult:
    """What a run has left; a notebook shows its report.

    summary: the run in a few numbers, those of `summary.json`. trajectory: a row a step; each column names its unit
    (`trajectory.schema.field("time_s").metadata`), `trajectory["time_s"].to_numpy()` and `trajectory.to_pandas()` convert it.
    folder: where the files lie (docs/recordings.md); one that `run` chose is removed with this result.
    """

    summary: dict[str, Any]
    trajectory: pa.Table
    folder: Path
    _temporary: TemporaryDirectory[str] | None

    def __repr__(self) -> str:
        lines = {**self.summary, "folder": self.folder}
        return "\n".join(f"{name}: {value}" for name, value in lines.items())

    def _repr_png_(self) -> bytes | None:
        report = self.folder / REPORT
        return report.read_bytes() if report.is_file() else None


def run(  # noqa: PLR0913 (each value stands by itself)
    scenario: Scenario | str | Path,
    folder: Path | str | None = None,
    *,
    device: str = "auto",
    video: bool = True,
    report: bool = True,
    frames: bool = False,
    labels: Layout | None = None,
    masks: bool = False,
    depth: bool = False,
    lux: bool = False,
    checks: bool = False,
    plant: Callable[[Simulation], Plant] | None = None,
    on_step: Callable[[Evaluation], None] = lambda result: None,
    on_end: Callable[[], None] = lambda: None,
    **values: Any,
) -> RunResult:
    """Run a scenario and record it into a folder, which `luxloop replay` reads.

    scenario: a shipped name or a path, or a loaded one. values: what `load` reads it with (`overrides=["road.kind=bumps"], steps=20`).
    folder: where files go, in place of an older recording; None for a temporary one that lives as long as the result. device: "auto",
    "cpu" or "cuda". video, report: whether these files are written, which takes seconds. frames: whether frames, light and ego
    motion are kept, which takes megabytes a step. labels: "coco" or "kitti": frames are kept with labels in that layout (docs/data.md).
    masks, depth, lux: whether labels have masks of instances and parts, depth, and illuminance of each pixel. checks: whether those of the
    scenario that compare with another light are evaluated, too, for which that light runs beside; what has come of them is in
    `summary["checks"]`. plant: makes what shows the light in place of the scenario's plant, a rig that is open, say.
    on_step: called after every step. on_end: called before video and report are finished.
    Ctrl-C ends the recording, reports on the steps so far and goes on as KeyboardInterrupt. Raises LuxloopError where the scenario cannot
    be read or run, another process writes into the folder, or the plant does not know what labels tell; nothing is written before the
    first step is done.
    """
    # What records, for which a preparation alone does not wait.
    from luxloop.loop.recording.recorder import Recorder, refuse_other_files
    from luxloop.loop.recording.video import VideoWriter
    from luxloop.loop.report.highlights import Highlights
    from luxloop.loop.report.picture import frame_picture, white_of

    if folder is not None and not isinstance(folder, str | Path):
        raise LuxloopError(f"run: folder is a {type(folder).__name__}, not a path; give other values of keys as overrides=[...]")
    if isinstance(scenario, str | Path):
        scenario = load(str(scenario), **values)
    elif values:
        raise LuxloopError(f"{scenario.source}: is loaded already and takes no overrides; give them to load()")
    temporary = None
    if folder is None:
        temporary = TemporaryDirectory(prefix="luxloop-")
        folder = temporary.name
    wanted = choose_labels(labels, masks=masks, depth=depth, lux=lux)
    played = shadow_of(scenario.plant)
    if played is not None and Path(played).resolve() == Path(folder).resolve():
        raise LuxloopError(f"{folder}: is the recording that is played, which this run would replace; give another folder with --out")
    folder = Path(folder)
    with output_folder(folder), ExitStack() as stack:
        refuse_other_files(folder)
        simulation, white = prepare(scenario, device), None
        if plant is not None:
            simulation = replace(simulation, plant=plant(simulation))
        camera, highlights = scenario.camera, Highlights(simulation)
        run_checks = Checks(scenario.checks, (lambda light: map(row, simulation.lit_by(light).evaluations())) if checks else None)

        def page(table: pa.Table, summary: dict[str, Any]) -> None:
            from luxloop.loop.report.page import write_report  # Matplotlib, for which the first step does not wait

            write_report(folder / REPORT, simulation, highlights, table, summary)

        recorder = stack.enter_context(Recorder(folder, simulation, page if report else None, run_checks.outcomes, frames, wanted))
        film = VideoWriter(folder / VIDEO, VIDEO_FPS, (camera.width_px, camera.height_px)) if video else None
        if film is not None:
            stack.enter_context(film)
        stack.callback(on_end)
        for result in stack.enter_context(closing(simulation.evaluations())):
            recorder.add(result)
            run_checks.step()
            highlights.add(result)
            if film is not None:
                white = white_of(result, simulation) if white is None else white
                film.add(frame_picture(result, simulation, white))
            on_step(result)
    gc.collect()  # matplotlib leaves exceptions of its parser in cycles, and their frames hold the simulation: half a gigabyte
    return RunResult(recorder.summary, read_parquet(folder / TRAJECTORY), folder, temporary)


def prepare(scenario: Scenario, device: str = "auto", before: Simulation | None = None) -> Simulation:
    """A simulation, to be stepped: `state = simulation.start()`, `state, result = simulation.step(state)`.

    scenario: a loaded one. device: "auto", "cpu" or "cuda". before: another one, whose parts that stay the same serve again.
    Raises LuxloopError where a file is missing, and of a symbol that the lamps
    cannot draw at its target, or that the camera cannot see there, or where a check names a column or light that is not there, or that the
    plant does not know.
    """
    if before is not None:
        before = replace(before, cache=before.cache.copy("motion"))  # which may have gone on from another one
    simulation = Simulation.prepare(scenario, torch_device(device), before)
    refuse_unknown_columns(simulation)
    return simulation


def check(scenario: Scenario, device: str = "auto") -> dict[str, Any]:
    """Build everything that a scenario names, and return what it is; `in_words` says it. Raises LuxloopError where it cannot run.

    `steps`, `road`, `base` (what shines below all functions), `functions` (their kinds by name), `controllers` (of symbols that are held,
    by name), `objects` (their number), `detector` (None where there is none) and `notes` (sentences on what does nothing, or lies out of
    the lamps' field). With a detector also the number of `boxes` that it finds in the first frame, None where none came, `lx_max`, the
    most light on objects there (None where none is in sight), and `known`, whether the plant knows the truth.
    """
    simulation = prepare(scenario, device)
    notes = [*unmoved(scenario), *chain.from_iterable(_cut(name, each) for name, each in simulation.controlled.items())]
    if isinstance(waiting := simulation.plant, DigitisedPlant):
        simulation, notes = replace(simulation, plant=waiting.night), [needs_rig(waiting.key), *notes]
    return {
        "steps": scenario.steps,
        "road": scenario.road.kind,
        **_first_look(simulation),
        "base": simulation.base(scenario.lighting.base.beam),
        "functions": {name: function.kind for name, function in scenario.functions.items()},
        "controllers": {name: each.params.name for name, each in simulation.controlled.items()},
        "objects": len(scenario.all_objects),
        "detector": None if scenario.detector is None else scenario.detector.kind,
        "notes": notes,
    }


def _cut(name: str, symbol: ControlledSymbol) -> list[str]:
    """How much of a symbol's target lies beyond the lamps' field, and the remedy; empty where that is next to nothing."""
    shares = cut(symbol.projector, ProjectionCommand(symbol.projector.target)).tolist()
    return target_remedies(name, dict(zip(SIDES, shares, strict=True)))


def _first_look(simulation: Simulation) -> dict[str, Any]:
    if simulation.pipeline is None:
        return {}
    with locate(simulation.scenario.source):
        first = next((each for each in simulation.evaluations() if each.frame is not None), None)
    if first is None or first.detections is None:
        return {"boxes": None, "lx_max": None, "known": simulation.truth is not None}
    lit = [each.lx_max for each in first.objects.values() if each.lx_max is not None]
    return {"boxes": len(first.detections.found), "lx_max": max(lit, default=None), "known": simulation.truth is not None}


def in_words(facts: dict[str, Any]) -> str:
    """What `check` found, in a line."""
    start = f"{facts['steps']} steps, road {facts['road']}"
    held = {name: f", held by {controller}" for name, controller in facts["controllers"].items()}
    kinds = ", ".join(f"{name} ({kind}{held.get(name, '')})" for name, kind in facts["functions"].items()) or "none"
    finder = "no detector" if facts["detector"] is None else f"detector {facts['detector']} ({_detector_in_words(facts)})"
    return f"{start}, {facts['base']}, functions {kinds}, {facts['objects']} objects, {finder}"


def _detector_in_words(facts: dict[str, Any]) -> str:
    if facts["boxes"] is None:
        return f"no frame came in {facts['steps']} steps"
    if not facts["known"]:
        return f"{facts['boxes']} boxes in the first frame"
    light = "no object is in sight" if facts["lx_max"] is None else f"objects in sight have up to {facts['lx_max']:.3g} lx"
    return f"{facts['boxes']} boxes in the first frame, where {light}"


def torch_device(name: str) -> torch.device:
    """The device of a name; "auto" is a CUDA device where there is one. Raises LuxloopError where there is none of that name."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    device = torch.device(name)
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise LuxloopError(
            f"device {name}: torch {torch.__version__} finds no such CUDA device here; give the device cpu, or see `luxloop doctor`"
        )
    return device
