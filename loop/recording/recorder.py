"""Recordings: a directory with a manifest, a row a step, and a summary, readable at whatever moment the process dies."""

import math
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
import torch
from torch import Tensor

from controllers.symbol.sensing.field import SIDES
from controllers.symbol.sensing.observer import Seen
from loop.plant.frames import remove
from loop.plant.protocol import Showing
from loop.recording.frames import FrameRecorder
from loop.recording.manifest import FILE as MANIFEST
from loop.recording.manifest import Manifest, write_json
from loop.recording.summary import summarise
from loop.scenario.plant import shadow_of
from loop.symbol.simulation import Simulation, StepResult
from perception.extraction import Loss
from perception.judge import Verdict
from world.errors import LuxloopError
from world.files import whole

Report = Callable[[pa.Table, dict[str, Any]], None]  # draws what the table and the summary of a run say
Checked = Callable[[pa.Table], dict[str, Any]]  # what has come of the checks of a run, by name

TRAJECTORY, SUMMARY, REPORT, VIDEO = "trajectory.parquet", "summary.json", "report.png", "video.mp4"
FILES = (TRAJECTORY, SUMMARY, REPORT, VIDEO, MANIFEST)
REST = 10  # times what a write takes pass between two: recording costs a tenth at most, and a kill the last 50 ms or so

CUT = tuple(f"cut_{side}" for side in SIDES)
AIM = ("aim_x_m", "aim_y_m")
LATER = ("z_m", *CUT, *AIM)  # columns that recordings of older versions lack
POSE = ("x_m", "y_m", "roll_deg", "pitch_deg")
ERRORS = ("e_x", "e_y", "e_roll", "e_pitch")
CENTROIDS = tuple(f"{point}_{axis}" for point in ("c", "tl", "tr", "bl", "br") for axis in "uv")
PARTS = ("light", "plant", "perceive", "control", "judge", "step")

# name: (unit, description); the shown light is seen camera.latency_steps later
COLUMNS: dict[str, tuple[str, str]] = {
    "step": ("1", "control step, from 0"),
    "time_s": ("s", "time of the on frame since the scenario's start"),
    "x_m": ("m", "shown pose of the primitive: centre ahead of the lamps"),
    "y_m": ("m", "shown pose: centre to the left"),
    "z_m": ("m", "shown height of the primitive's centre above the assumed road"),
    "roll_deg": ("deg", "shown pose: rotation about the forward axis"),
    "pitch_deg": ("deg", "shown pose: rotation about the left axis, nose down positive"),
    "cut_left": ("1", "share of the shown symbol that is cut: it lies beyond the left border of the lamps' field"),
    "cut_right": ("1", "share cut at the right border"),
    "cut_top": ("1", "share cut at the upper border"),
    "cut_bottom": ("1", "share cut at the lower border"),
    "aim_x_m": ("m", "place on the road where the symbol is aimed, since its target cannot be lit as asked; null for the target"),
    "aim_y_m": ("m", "the same to the left"),
    "e_x": ("axes", "error of the centre along u, seen minus target"),
    "e_y": ("axes", "error of the centre along v"),
    "e_roll": ("feature", "error of the roll feature"),
    "e_pitch": ("feature", "error of the pitch feature"),
    "pose_error_x_m": ("m", "e_y divided by its plant gain"),
    "pose_error_y_m": ("m", "e_x divided by its plant gain"),
    "pose_error_roll_deg": ("deg", "e_roll divided by its plant gain"),
    "pose_error_pitch_deg": ("deg", "e_pitch divided by its plant gain"),
    "c_u": ("axes", "centroid of the extracted symbol, u to the right"),
    "c_v": ("axes", "centroid of the extracted symbol, v down or towards the car"),
    "tl_u": ("axes", "centroid of the top left quadrant, u"),
    "tl_v": ("axes", "centroid of the top left quadrant, v"),
    "tr_u": ("axes", "centroid of the top right quadrant, u"),
    "tr_v": ("axes", "centroid of the top right quadrant, v"),
    "bl_u": ("axes", "centroid of the bottom left quadrant, u"),
    "bl_v": ("axes", "centroid of the bottom left quadrant, v"),
    "br_u": ("axes", "centroid of the bottom right quadrant, u"),
    "br_v": ("axes", "centroid of the bottom right quadrant, v"),
    "area_ratio": ("1", "area of the extracted symbol, as a multiple of what the flat road, or one of the acquired shape, would show"),
    "loss": ("", "why the symbol was lost: no_frame, nothing, too_small or too_large; empty where it was seen"),
    "centroid_error_x_percent": ("%", "judge: error of the centroid along x, of the symbol's length"),
    "centroid_error_y_percent": ("%", "judge: error of the centroid along y, of the symbol's width"),
    "iou": ("1", "judge: intersection over union with the target"),
    "ssim": ("1", "judge: structural similarity to the target"),
    "length": ("1", "judge: second-moment length as a multiple of the target's"),
    "shear": ("1", "judge: shear mu11 / mu20 on the road plane"),
    "light_ms": ("ms", "from the pose to utilisations"),
    "plant_ms": ("ms", "the plant, which exposes on and off frame; the simulated one renders what has moved"),
    "perceive_ms": ("ms", "extraction, moments and errors"),
    "control_ms": ("ms", "the controller"),
    "judge_ms": ("ms", "the judge, who is no part of the loop"),
    "step_ms": ("ms", "light, plant, perceive and control together"),
}

SYMBOL = {name: of for name, of in COLUMNS.items() if name not in ("step", "time_s") and not name.endswith("_ms")}  # of each symbol
_TYPES = {"step": pa.int64(), "loss": pa.string()}
SCHEMA = pa.schema(
    pa.field(name, _TYPES.get(name, pa.float64()), metadata={"unit": unit, "description": text}) for name, (unit, text) in COLUMNS.items()
)


class SymbolStep(Protocol):
    """A symbol in a step, see `StepResult`."""

    @property
    def pose(self) -> Tensor: ...
    @property
    def z(self) -> Tensor: ...
    @property
    def cut(self) -> Tensor: ...
    @property
    def aim(self) -> Tensor: ...
    @property
    def verdict(self) -> Verdict | None: ...


NAN = torch.tensor(torch.nan)
NOT_JUDGED = Verdict(NAN.expand(2), NAN, NAN, NAN, NAN)


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


def row(result: StepResult) -> dict[str, Any]:
    """A step as plain Python values, by the names of COLUMNS; NaN where nothing was seen. Waits for the device once."""
    values = of_symbol(result, result.seen) | {"step": result.step, "time_s": result.time_s}
    values |= {f"{part}_ms": result.timings[part] for part in PARTS}
    return {name: values[name] for name in COLUMNS}


def of_symbol(result: SymbolStep, seen: Seen) -> dict[str, Any]:
    """What is recorded of one symbol in a step, by the names of SYMBOL."""
    verdict = result.verdict or NOT_JUDGED
    degrees = torch.tensor([1.0, 1.0, 180 / torch.pi, 180 / torch.pi], dtype=torch.float64)
    tensors = {
        POSE: result.pose,
        ("z_m",): result.z,
        ERRORS: seen.errors,
        tuple(f"pose_error_{name}" for name in POSE): seen.pose_error,
        CENTROIDS: seen.appearance.centroids,
        ("area_ratio",): seen.area_ratio,
        ("centroid_error_x_percent", "centroid_error_y_percent"): verdict.centroid_percent,
        ("iou", "ssim", "length", "shear"): torch.stack([verdict.iou, verdict.ssim, verdict.length, verdict.shear]),
        CUT: result.cut,
        AIM: result.aim,
        ("code",): seen.code,
    }
    host = torch.cat([tensor.flatten().double() for tensor in tensors.values()]).cpu()
    host[:4] *= degrees
    host[9:13] *= degrees
    values = dict(zip([name for names in tensors for name in names], host.tolist(), strict=True))
    return values | {"loss": loss_name(int(values.pop("code")))}


def loss_name(code: int) -> str:
    """A loss code as recordings write it: "" where the symbol was seen, else the reason in lower case."""
    return "" if code == Loss.SEEN else Loss(code).name.lower()


def table_of(rows: list[dict[str, Any]], schema: pa.Schema = SCHEMA) -> pa.Table:
    """Rows as a table; NaN becomes null, and so does what a row lacks."""
    columns = [pa.array([r.get(field.name) for r in rows], field.type, from_pandas=True) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema)


def summary_of(simulation: Simulation, table: pa.Table) -> dict[str, Any]:
    """The summary of a run's steps, the open loop judged beside the last."""
    time_s = table["time_s"][-1].as_py() if table.num_rows else 0.0
    light, judge = simulation.projector.light(simulation.projector.target), simulation.judge
    iou_open = math.nan if judge is None else judge.verdict(light, time_s).iou.item()
    shadowed = shadow_of(simulation.scenario.plant)
    return summarise(table, simulation.scenario.name, simulation.scenario.controller.name, iou_open, shadowed)


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


class Recorder(TableRecorder[StepResult]):
    """Records the run of a closed loop."""

    def __init__(
        self, directory: Path, simulation: Simulation, report: Report = no_report, checked: Checked = unchecked, frames: bool = False
    ) -> None:
        """frames: whether to keep them. Raises LuxloopError as any recorder does, and if an input file cannot be read."""
        self.simulation = simulation
        kept = FrameRecorder(directory, simulation.scenario.camera.bits) if frames else None
        manifest = Manifest.of(simulation.scenario, simulation.renderer, simulation.device)
        super().__init__(directory, manifest, SCHEMA, report, checked, kept)

    def row(self, result: StepResult) -> dict[str, Any]:
        return row(result)

    def figures(self) -> dict[str, Any]:
        """The summary of the steps so far, the open loop simulated beside them."""
        return summary_of(self.simulation, self.table())


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
