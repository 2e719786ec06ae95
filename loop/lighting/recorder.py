"""Records a run into a directory, readable at whatever moment the process dies."""

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pyarrow as pa

from loop.lighting.record import row, schema, summary_of
from loop.lighting.result import StepResult
from loop.lighting.simulation import Simulation
from loop.plant.frames import remove
from loop.recording.files import FILES, SUMMARY, TRAJECTORY, table_of, write_table
from loop.recording.frames import FrameRecorder
from loop.recording.manifest import Manifest, write_json
from perception.extraction import Loss
from world.errors import LuxloopError

REST = 10  # times what a write takes pass between two: recording costs a tenth at most, and a kill the last 50 ms or so


class Recorder:
    """Records a run into a directory; use it in a `with` statement and `add` every step.

    The first step begins the recording: until then the directory stays as it is, also where it holds an older one. Leaving the block
    finishes it, as interrupted after Ctrl-C and as failed after an error, and writes summary and report; `summary` is
    empty until then. Where that fails after an error, the first error is raised.
    """

    def __init__(
        self,
        directory: Path,
        simulation: Simulation,
        report: Callable[[pa.Table, dict[str, Any]], None] | None = None,
        checked: Callable[[pa.Table], dict[str, Any]] | None = None,
        frames: bool = False,
    ) -> None:
        """report: draws what the table and the summary of the run say. checked: what has come of its checks, by name. frames: whether to
        keep them.

        Raises LuxloopError if the directory holds something else than a recording, or cannot be written, or an input file not be read.
        """
        self.directory, self.simulation, self._report, self._checked = directory, simulation, report, checked
        self.manifest = Manifest.of(simulation.scenario, simulation.renderer, simulation.device)
        self._frames = FrameRecorder(directory, simulation.scenario.camera.bits) if frames else None
        self._idle, self._last = set(simulation.scenario.functions), dict[str, StepResult]()
        self._covered, self._findable = dict[str, StepResult](), set[str]()
        self._asked, self._came = set[int](), list[int]()  # numbers of exposures, and of frames with an image
        self._written = schema(simulation).empty_table()
        self._fresh: list[dict[str, Any]] = []
        self._next_write_s = 0.0
        self._begun = False
        self.summary = dict[str, Any]()
        refuse_foreign(directory)

    def _summarised(self) -> dict[str, Any]:
        """The steps in a few numbers, and what has come of checks."""
        functions = sorted(self.simulation.scenario.functions.items())
        idle = [f"functions.{name} ({each.kind})" for name, each in functions if name in self._idle]
        checks = {} if self._checked is None else self._checked(self.table())
        fitting = sum(number in self._asked for number in self._came)
        frames = {"asked": len(self._asked), "came": fitting, "unknown": len(self._came) - fitting}
        sees = self.simulation.pipeline is not None or self.simulation.planner.adaptive or self.simulation.controlled
        looks = {"frames": frames} if sees else {}
        summary = summary_of(self.simulation, self.table(), self._last, self._covered)
        if self.simulation.pipeline is not None:
            for name, each in summary["objects"].items():
                each["findable"] = name in self._findable
        return summary | looks | {"idle_functions": idle, "checks": checks}

    def __enter__(self) -> Self:
        return self

    def add(self, result: StepResult) -> None:
        """Record a step. Raises LuxloopError if the directory can no longer be written."""
        added = row(result)
        if self._idle:
            self._idle &= self.simulation.idle(result)
        self._last |= dict.fromkeys(result.held, result)
        self._covered |= {name: result for name, each in result.held.items() if each.measurement.code == Loss.COVERED}
        if result.look is not None:
            self._findable |= {name for name, each in result.look.recognised.items() if each.findable}
        self._asked |= {each.exposure.number for each in result.showings}
        self._came += [frame.number for each in result.showings for frame in each.after.frames if frame.image is not None]
        if not self._begun:
            self._begin()
        if self._frames is not None:
            self._frames.add(result.showings)
        self._fresh.append(added)
        if time.perf_counter() >= self._next_write_s:
            self._write_trajectory()

    def table(self) -> pa.Table:
        """All steps so far."""
        if self._fresh:
            self._written = pa.concat_tables([self._written, table_of(self._fresh, self._written.schema)]).combine_chunks()
            self._fresh = []
        return self._written

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if not self._begun:
            return
        ended = "complete" if error is None else "failed" if isinstance(error, Exception) else "interrupted"
        try:
            self._write_trajectory()
            self.summary = self._summarised()
            write_json(self.directory / SUMMARY, self.summary)
            self.manifest = self.manifest.ended(ended, self.directory)
            if self._report is not None:
                self._report(self.table(), self.summary)
        except Exception:
            with suppress(OSError):
                self.manifest.fail(self.directory)
            if ended != "failed":  # else the first error is raised
                raise

    def _begin(self) -> None:
        """Make the directory, remove an old recording, its manifest last, and write the new one's."""
        with _writing(self.directory):
            self.directory.mkdir(parents=True, exist_ok=True)
            remove(self.directory)
            for name in FILES:
                (self.directory / name).unlink(missing_ok=True)
            self.manifest.write(self.directory)
            if self._frames is not None:
                self._frames.begin()
        self._begun = True

    def _write_trajectory(self) -> None:
        start = time.thread_time()  # a busy machine makes writes last, but not rarer
        if self._frames is not None:
            self._frames.write()
        write_table(self.directory / TRAJECTORY, self.table())
        self._next_write_s = time.perf_counter() + REST * (time.thread_time() - start)


@contextmanager
def _writing(directory: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise LuxloopError(f"{directory}: cannot be written ({reason}); give another directory with --out") from error


def refuse_foreign(directory: Path) -> None:
    """Raises LuxloopError where the directory holds something else than a recording, or cannot be written."""
    with _writing(directory):
        with tempfile.TemporaryFile(dir=next(each for each in (directory, *directory.parents) if each.exists())):
            pass
        if not directory.exists() or not any(directory.iterdir()):
            return
    try:
        Manifest.read(directory)
    except LuxloopError as error:
        raise LuxloopError(f"{directory}: holds files that are no recording of this luxloop; give an empty or a new directory") from error
