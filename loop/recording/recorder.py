"""Recordings: a directory with a manifest, a row a step, and a summary, readable at whatever moment the process dies."""

import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

import pyarrow as pa
import pyarrow.parquet as pq

from loop.plant.frames import remove
from loop.plant.protocol import Showing
from loop.recording.frames import FrameRecorder
from loop.recording.manifest import FILE as MANIFEST
from loop.recording.manifest import Manifest, write_json
from world.errors import LuxloopError
from world.files import whole

Report = Callable[[pa.Table, dict[str, Any]], None]  # draws what the table and the summary of a run say
Checked = Callable[[pa.Table], dict[str, Any]]  # what has come of the checks of a run, by name

TRAJECTORY, SUMMARY, REPORT, VIDEO = "trajectory.parquet", "summary.json", "report.png", "video.mp4"
FILES = (TRAJECTORY, SUMMARY, REPORT, VIDEO, MANIFEST)
REST = 10  # times what a write takes pass between two: recording costs a tenth at most, and a kill the last 50 ms or so


class Stepped(Protocol):
    """What happened in a step, whatever stepped."""

    @property
    def showings(self) -> tuple[Showing, ...]:
        """The exposures of the step."""


Result = TypeVar("Result", bound=Stepped)


@dataclass(frozen=True)
class Outputs:
    """What a run writes beside its table and summary."""

    video: bool = True
    report: bool = True
    frames: bool = False


def table_of(rows: list[dict[str, Any]], schema: pa.Schema) -> pa.Table:
    """Rows as a table; NaN becomes null, and so does what a row lacks."""
    columns = [pa.array([r.get(field.name) for r in rows], field.type, from_pandas=True) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema)


def write_table(file: Path, table: pa.Table) -> None:
    """Write Parquet, whole or not at all. Raises LuxloopError where it cannot be written."""
    with whole(file) as part:
        pq.write_table(table, part, use_dictionary=False)


def no_report(table: pa.Table, summary: dict[str, Any]) -> None:
    """For recordings without a report."""


def unchecked(table: pa.Table) -> dict[str, Any]:
    """For recordings without checks."""
    return {}


class TableRecorder(ABC, Generic[Result]):
    """Records a run into a directory; use it in a `with` statement and `add` every step.

    The first step begins the recording: until then the directory stays as it is, also where it holds an older one. Leaving the block
    finishes it, as interrupted after Ctrl-C and as failed after an error, and writes summary and report. Where that fails after an error,
    the first error is raised.
    """

    def __init__(
        self, directory: Path, manifest: Manifest, schema: pa.Schema, report: Report, checked: Checked, frames: FrameRecorder | None
    ) -> None:
        """Raises LuxloopError if the directory holds something else than a recording, or cannot be written."""
        self.directory, self.manifest, self._report, self._checked, self._frames = directory, manifest, report, checked, frames
        self._written = schema.empty_table()
        self._fresh: list[dict[str, Any]] = []
        self._next_write_s = 0.0
        self._begun = False
        with self._writing():
            _refuse(directory)

    @abstractmethod
    def row(self, result: Result) -> dict[str, Any]:
        """A step as plain Python values, by the names of the schema."""

    @abstractmethod
    def figures(self) -> dict[str, Any]:
        """The steps so far in a few numbers."""

    def summary(self) -> dict[str, Any]:
        """The summary of the steps so far: their figures, and what has come of checks."""
        return self.figures() | {"checks": self._checked(self.table())}

    def __enter__(self) -> Self:
        return self

    def add(self, result: Result) -> dict[str, Any]:
        """Record a step; returns its row. Raises LuxloopError if the directory can no longer be written."""
        added = self.row(result)
        if not self._begun:
            self._begin()
        if self._frames is not None:
            self._frames.add(result.showings)
        self._fresh.append(added)
        if time.perf_counter() >= self._next_write_s:
            self._write_trajectory()
        return added

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
            summary = self.summary()
            write_json(self.directory / SUMMARY, summary)
            self.manifest = self.manifest.ended(ended, self.directory)
            self._report(self.table(), summary)
        except Exception:
            with suppress(OSError):
                self.manifest.fail(self.directory)
            if ended != "failed":  # else the first error is raised
                raise

    def _begin(self) -> None:
        """Make the directory, remove an old recording, its manifest last, and write the new one's."""
        with self._writing():
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
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            reason = error.strerror or error
            raise LuxloopError(f"{self.directory}: cannot be written ({reason}); give another directory with --out") from error


def _refuse(directory: Path) -> None:
    """Raises LuxloopError where the directory holds something else than a recording, OSError where it cannot be written."""
    with tempfile.TemporaryFile(dir=next(each for each in (directory, *directory.parents) if each.exists())):
        pass
    if directory.exists() and any(directory.iterdir()):
        try:
            Manifest.read(directory)
        except LuxloopError as error:
            raise LuxloopError(
                f"{directory}: holds files that are no recording of this luxloop; give an empty or a new directory"
            ) from error
