"""Records a run into a directory whose files can be read even if the process is killed."""

import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pandas as pd
import pyarrow as pa
import torch

from luxloop.loop.recording.frames import FrameRecorder, elsewhere
from luxloop.loop.recording.functions_summary import summary_of
from luxloop.loop.recording.labels import PATTERNS as LABEL_FILES
from luxloop.loop.recording.labels import LabelRecorder, Labels
from luxloop.loop.recording.manifest import EDITS, FILES, PIXELS, SUMMARY, TRAJECTORY, Manifest, table_of, write_json, write_table
from luxloop.loop.recording.record import row, schema
from luxloop.loop.recording.summary import finite
from luxloop.loop.scenario.edits import Edit, add
from luxloop.loop.scenario.plant import shadow_of
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.frames import PATTERNS as FRAME_FILES
from luxloop.loop.simulation.lamps import Lights
from luxloop.loop.simulation.pixel_gain_loop import GainState
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write, writing

FOLDED = 256  # rows as Python's values, which take ten times the memory of the table
REST = 10  # pause between two writes, as a multiple of a write's time: recording costs a tenth at most, and a kill the last 50 ms or so


class Tally:
    """Rows of a run's steps, and the rest that its summary needs. edits: of the scenario during the run, in order."""

    def __init__(self, simulation: Simulation) -> None:
        self.first = self.simulation = simulation
        self.edits = list[Edit]()
        self._idle, self._waiting = set(simulation.scenario.functions), set(simulation.scenario.functions)
        self._last = dict[str, Evaluation]()
        self._gains: GainState | None = None
        self._covered, self._findable = dict[str, Evaluation](), set[str]()
        self._in_shadow, self._own_lights, self._elsewhere = (
            shadow_of(simulation.scenario.plant) is not None,
            dict[int, Lights](),
            list[float](),
        )
        self._exposures, self._images = set[int](), list[int]()  # numbers of exposures, and of frames with an image
        self._written = pa.Table.from_batches([], schema(simulation))
        self._fresh: list[dict[str, Any]] = []

    def add(self, result: Evaluation) -> dict[str, Any]:
        """Add a step; returns its row."""
        added = row(result)
        if self._idle:
            self._idle &= self.simulation.idle(result)
        if self._waiting:
            self._waiting &= self.simulation.waiting(result)
        self._gains = result.control.gains
        self._last |= dict.fromkeys(result.held, result)
        self._covered |= {name: result for name, each in result.held.items() if each.measurement.code == ExtractionStatus.COVERED}
        if result.detections is not None:
            self._findable |= {name for name, each in result.detections.recognised.items() if each.findable}
        self._own_lights |= {each.number: each.lights for each in result.exposures} if self._in_shadow else {}
        for frame in result.reception.frames:
            own = self._own_lights.pop(frame.number, None)
            if own is not None and frame.shown is not None:
                self._elsewhere.append(elsewhere(own, frame.shown.lights))
        self._exposures |= {each.number for each in result.exposures}
        self._images += [frame.number for frame in result.reception.frames if frame.image is not None]
        self._fresh.append(added)
        if len(self._fresh) >= FOLDED:
            self._fold()
        return added

    def edit(self, simulation: Simulation, edit: Edit) -> None:
        """Continue with an edited simulation, whose columns are added to the table."""
        fresh = simulation.scenario.functions.keys() - self.simulation.scenario.functions.keys()
        self._idle, self._waiting = self._idle | fresh, self._waiting | fresh
        if not edit.driven:
            columns = pa.unify_schemas([self.table().schema, schema(simulation)])
            self._written = table_of(self._written.to_pylist(), columns) if columns != self._written.schema else self._written
        self.simulation = simulation
        add(self.edits, edit)

    def table(self) -> pa.Table:
        """Rows of all steps so far."""
        self._fold()
        self._written = self._written.combine_chunks()
        return self._written

    def _fold(self) -> None:
        if self._fresh:
            self._written = pa.concat_tables([self._written, table_of(self._fresh, self._written.schema)])
            self._fresh = []

    def gains(self) -> str:
        """CSV text of the lamps' pixels with a known gain, empty unless gains are estimated."""
        if self._gains is None:
            return ""
        tables = list[pd.DataFrame]()
        for module, each in zip(self.simulation.modules, self._gains.gains, strict=True):
            pixel = torch.nonzero(each.known)[:, 0].cpu()
            row, column = pixel // module.headlight.pixel_cols, pixel % module.headlight.pixel_cols
            values = {"row": row, "column": column, "gain": each.gain.cpu()[pixel], "std": each.std.cpu()[pixel]}
            tables.append(pd.DataFrame({"module": module.name, **{key: value.numpy() for key, value in values.items()}}))
        return pd.concat(tables).to_csv(index=False, float_format="%.3f")

    def summary(self, checked: Callable[[pa.Table], dict[str, Any]] | None = None) -> dict[str, Any]:
        """Summary of the steps so far. checked: gives the outcomes of checks, by name."""
        functions = sorted(self.simulation.scenario.functions.items())
        idle = [f"functions.{name} ({each.kind})" for name, each in functions if name in self._idle - self._waiting]
        summary = summary_of(self.simulation, self.table(), self._last, self._covered)
        if self._in_shadow:
            differ, count = sum(share > 0 for share in self._elsewhere), len(self._elsewhere)
            summary["shadow"] = {"exposures": count, "differ": differ, "elsewhere": sum(self._elsewhere) / count if count else None}
        if self.simulation.pipeline is not None:
            for name, each in summary["objects"].items():
                each["findable"] = name in self._findable
        now = self.simulation
        if now.pipeline is not None or now.planner.adaptive or now.controlled or now.gain_loop is not None:
            known = sum(number in self._exposures for number in self._images)
            summary["frames"] = {"asked": len(self._exposures), "came": known, "unknown": len(self._images) - known}
        summary |= {"idle_functions": idle, "checks": {} if checked is None else checked(self.table())}
        return finite(summary)


class Recorder:
    """Records a run into a directory; use it in a `with` statement and `add` every step.

    The first step begins the recording and replaces an older recording in the directory. Leaving the block writes summary and report, and
    marks the recording as complete, as interrupted after Ctrl-C, or as failed after an error, which is then raised; `summary` is empty
    until then.
    """

    def __init__(
        self,
        directory: Path,
        run: Simulation | Tally,
        report: Callable[[pa.Table, dict[str, Any], Manifest], None] | None = None,
        checked: Callable[[pa.Table], dict[str, Any]] | None = None,
        frames: bool = False,
        labels: Labels | None = None,
    ) -> None:
        """run: a simulation, or the tally of a run so far, whose steps are recorded as well. report: draws the report of table, summary and
        manifest.
        checked: gives the outcomes of checks, by name. frames: whether frames are recorded. labels: recorded with the frames.

        Raises LuxloopError if the directory holds anything but a recording, or cannot be written, if an input file cannot be read, and for
        labels where the plant does not know the truth.
        """
        self.directory, self.tally, self._report, self._checked = directory, run if isinstance(run, Tally) else Tally(run), report, checked
        first = self.tally.first
        self.manifest = Manifest.of(first.scenario, first.renderer, first.device)
        kept = FrameRecorder(directory, first.scenario.camera.bits)
        self._kept: list[FrameRecorder | LabelRecorder] = [kept] if frames or labels is not None else []
        if labels is not None:
            if first.truth is None:
                why = f"the plant {first.scenario.plant.kind!r} does not know what is true"
                raise LuxloopError(f'--labels {labels.layout}: {why}; set plant.kind = "simulated", or leave it out')
            self._kept.append(LabelRecorder(directory, first.truth, labels, kept))
        self._next_write_s = 0.0
        self._begun, self._edits_written = False, list[Edit]()
        self.summary = dict[str, Any]()
        refuse_other_files(directory)

    def __enter__(self) -> Self:
        return self

    def add(self, result: Evaluation) -> dict[str, Any]:
        """Record a step; returns its row. Raises LuxloopError if the directory can no longer be written."""
        added = self.tally.add(result)
        self.begin()
        for each in self._kept:
            each.add(result.reception)
        if time.perf_counter() >= self._next_write_s:
            self._write_trajectory()
        return added

    def edit(self, simulation: Simulation, edit: Edit) -> None:
        """Continue with an edited simulation. Raises LuxloopError if the directory can no longer be written."""
        self.tally.edit(simulation, edit)
        if self._begun and not edit.driven:  # edits by the driver are written with the rows
            self._write_edits()

    def table(self) -> pa.Table:
        """Rows of all steps so far."""
        return self.tally.table()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if not self._begun:
            return
        ended = "complete" if error is None else "failed" if isinstance(error, Exception) else "interrupted"
        try:
            self._write_trajectory()
            self.summary = self.tally.summary(self._checked)
            write_json(self.directory / SUMMARY, self.summary)
            if gains := self.tally.gains():
                atomic_write(self.directory / PIXELS, gains)
            self.manifest = self.manifest.finish(ended, self.directory)
            if self._report is not None:
                self._report(self.table(), self.summary, self.manifest)
        except Exception:
            with suppress(OSError):
                self.manifest.fail(self.directory)
            if ended != "failed":  # else the first error is raised
                raise

    def begin(self) -> None:
        """Make the directory, replace an old recording, and write the manifest, unless the recording has begun."""
        if self._begun:
            return
        with writing(self.directory):
            self.directory.mkdir(parents=True, exist_ok=True)
            _remove(self.directory)
            self.manifest.write(self.directory)
            for each in self._kept:
                each.begin()
        self._begun = True
        self._write_edits()

    def _write_edits(self) -> None:
        if self.tally.edits != self._edits_written:
            self._edits_written = list(self.tally.edits)
            write_json(self.directory / EDITS, [each.model_dump(mode="json") for each in self.tally.edits])

    def _write_trajectory(self) -> None:
        table = self.table()  # the first one imports pandas, which is not the time of a write
        start = time.thread_time()  # not the wall clock, by which a busy machine would make writes rarer
        self._write_edits()
        for each in self._kept:
            each.write()
        write_table(self.directory / TRAJECTORY, table)
        self._next_write_s = time.perf_counter() + REST * (time.thread_time() - start)


def _remove(directory: Path) -> None:
    """Remove the files of a recording, its manifest last, and nothing else. Raises OSError where a file cannot be removed."""
    for name, patterns in (FRAME_FILES | dict(reversed(LABEL_FILES.items()))).items():
        folder = directory / name
        if folder.is_symlink():
            folder.unlink()
        for pattern in patterns:
            for file in folder.glob(pattern):
                file.unlink()
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
    for name in FILES:
        (directory / name).unlink(missing_ok=True)


def refuse_other_files(directory: Path) -> None:
    """Raises LuxloopError where the directory holds anything but a recording, or cannot be written."""
    with writing(directory):
        with tempfile.TemporaryFile(dir=next(each for each in (directory, *directory.parents) if each.exists())):
            pass
        if not directory.exists() or not any(directory.iterdir()):
            return
    try:
        Manifest.read(directory)
    except LuxloopError as error:
        raise LuxloopError(f"{directory}: holds files that are no recording of this luxloop; give an empty or a new directory") from error
