"""Run a scenario with recording, film and report, for the command line and Python programs."""

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

from luxloop.controllers.functions.commands import BendingParams, LevellingParams
from luxloop.controllers.symbol.sensing.field import SIDES, cut
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.loop.recording.checks import Checks
from luxloop.loop.recording.labels import Labels, Layout, choose_labels
from luxloop.loop.recording.manifest import REPORT, TRAJECTORY, VIDEO, Manifest
from luxloop.loop.recording.record import refuse_unknown_columns, row
from luxloop.loop.recording.remedies import target_remedies
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.scenario.plant import SimulatedPlantParams, shadow_of
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.protocol import Plant
from luxloop.loop.simulation.simulated import DigitisedPlant, needs_rig
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.arrays import read_parquet
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import output_folder


@dataclass(frozen=True, eq=False, repr=False)
class RunResult:
    """Result of a run; a notebook displays its report.

    summary: the numbers of `summary.json`. trajectory: one row for each step; each column names its unit
    (`trajectory.schema.field("time_s").metadata`), `trajectory["time_s"].to_numpy()` and `trajectory.to_pandas()` convert the table.
    folder: of the recording (docs/recordings.md); a temporary folder is removed with this result.
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


def run(  # noqa: PLR0913 (independent options)
    scenario: Scenario | str | Path,
    folder: Path | str | None = None,
    *,
    device: str = "auto",
    video: bool = True,
    report: bool = True,
    frames: bool = False,
    labels: Layout | Labels | None = None,
    masks: bool = False,
    depth: bool = False,
    lux: bool = False,
    checks: bool = False,
    plant: Callable[[Simulation], Plant] | None = None,
    on_step: Callable[[Evaluation], None] = lambda result: None,
    on_end: Callable[[], None] = lambda: None,
    **values: Any,
) -> RunResult:
    """Run a scenario and record it in a folder for `luxloop replay`.

    scenario: shipped name, path, or loaded scenario. values: arguments of `load` (`overrides=["road.kind=bumps"], steps=20`). folder: for
    the recording, replaces an older one; None for a temporary folder that lasts as long as the result. device: "auto", "cpu" or "cuda".
    video, report: whether to write these files, which takes seconds. frames: whether to record frames, light and ego motion, megabytes
    for each step. labels: "coco", "kitti" or "yolo", records frames with labels in that layout (docs/data.md). masks, depth, lux: whether
    labels include masks of instances and parts, depth, and illuminance of each pixel. checks: whether to evaluate also the scenario's
    checks against another light, which is then simulated alongside; outcomes are in `summary["checks"]`. plant: returns a plant that
    replaces the scenario's plant, such as an open rig. on_step: called after every step. on_end: called before video and report are
    finished. Ctrl-C ends the recording, reports on the completed steps and raises KeyboardInterrupt. Raises LuxloopError if the scenario
    cannot be read or run, another process writes into the folder, or the plant does not know the truth for labels. Nothing is written
    before the end of the first step.
    """
    # Recording modules, imported here so that `prepare` need not load them.
    from luxloop.loop.recording.recorder import Recorder, refuse_other_files
    from luxloop.loop.report.highlights import Highlights
    from luxloop.loop.report.onlooker import Film

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
    wanted = labels if isinstance(labels, Labels) else choose_labels(labels, masks=masks, depth=depth, lux=lux)
    played = shadow_of(scenario.plant)
    if played is not None and Path(played).resolve() == Path(folder).resolve():
        raise LuxloopError(f"{folder}: is the recording that is played, which this run would replace; give another folder with --out")
    folder = Path(folder)
    with output_folder(folder), ExitStack() as stack:
        refuse_other_files(folder)
        simulation = prepare(scenario, device)
        if plant is not None:
            simulation = replace(simulation, plant=plant(simulation))
        highlights = Highlights(simulation)
        run_checks = Checks(scenario.checks, (lambda light: map(row, simulation.lit_by(light).evaluations())) if checks else None)

        def page(table: pa.Table, summary: dict[str, Any], manifest: Manifest) -> None:
            from luxloop.loop.report.page import write_report  # deferred, so that the first step need not load Matplotlib

            write_report(folder / REPORT, simulation, highlights, run_checks.with_full_light(table), summary, manifest)

        recorder = stack.enter_context(Recorder(folder, simulation, page if report else None, run_checks.outcomes, frames, wanted))
        film = stack.enter_context(Film(folder / VIDEO, simulation)) if video else None
        stack.callback(on_end)
        for result in stack.enter_context(closing(simulation.evaluations())):
            recorder.add(result)
            run_checks.step(result)
            highlights.add(result)
            if film is not None:
                film.step(result)
            on_step(result)
    gc.collect()  # matplotlib leaves exceptions of its parser in cycles, and their frames hold the simulation: half a gigabyte
    return RunResult(recorder.summary, read_parquet(folder / TRAJECTORY), folder, temporary)


def prepare(scenario: Scenario, device: str = "auto", before: Simulation | None = None) -> Simulation:
    """Build a simulation to step: `state = simulation.start()`, `state, result = simulation.step(state)`.

    scenario: loaded scenario. device: "auto", "cpu" or "cuda". before: an earlier simulation, whose unchanged parts are reused. Raises
    LuxloopError for a missing file, a symbol that the lamps cannot draw or the camera cannot see at its target, or a check of a column or
    light that does not exist or needs the truth.
    """
    if before is not None:
        before = replace(before, cache=before.cache.copy("motion"))  # its motion may continue that of another simulation
    simulation = Simulation.prepare(scenario, torch_device(device), before)
    refuse_unknown_columns(simulation)
    return simulation


def check(scenario: Scenario, device: str = "auto") -> dict[str, Any]:
    """Build a scenario and return facts about it; `in_words` formats them. Raises LuxloopError if it cannot run.

    `steps`, `road`, `base` (light below all functions), `functions` (kinds by name), `controllers` (of closed-loop symbols by name),
    `objects` (their number), `detector` (None without one) and `notes` (sentences on functions without effect, symbols beyond the lamps'
    field, and a missing rig). With a detector also `boxes` (number of detections in the first frame, None without a frame), `lx_max`
    (largest illuminance on objects, None if none is visible), and `known` (whether the plant knows the truth).
    """
    simulation = prepare(scenario, device)
    notes = [*_unmoved(scenario), *chain.from_iterable(_cut(name, each) for name, each in simulation.controlled.items())]
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


def _unmoved(scenario: Scenario) -> list[str]:
    """Notes on functions that only follow the car's motion, if the simulated car stands; else empty."""
    if scenario.vehicle is not None or not isinstance(scenario.plant, SimulatedPlantParams):
        return []
    return [
        f"functions.{name} ({function.kind}) does nothing, for a car that stands neither turns nor pitches; give a [vehicle] that drives"
        for name, function in scenario.functions.items()
        if isinstance(function, BendingParams) or (isinstance(function, LevellingParams) and not function.entries)
    ]


def _cut(name: str, symbol: ControlledSymbol) -> list[str]:
    """Shares of a symbol's target beyond the lamps' field, with a remedy; empty if negligible."""
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
    """The facts of `check` in one line."""
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
    """The device of a name; "auto" prefers CUDA. Raises LuxloopError for a missing CUDA device, or another name."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise LuxloopError(f"device {name}: there is no such device; give auto, cpu, or cuda") from None
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise LuxloopError(
            f"device {name}: torch {torch.__version__} finds no such CUDA device here; give the device cpu, or see `luxloop doctor`"
        )
    return device
