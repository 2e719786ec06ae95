"""Compares two trajectories of one scenario column by column within stated tolerances."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from luxloop.controllers.symbol.sensing.symbol_sensor import FeatureParams
from luxloop.loop.recording.summary import AXES, steady_step
from luxloop.loop.simulation.columns import AIM, CAUSES, CENTROIDS, CUT, ERRORS, of_one

SHEAR = (0.005, "a quarter of what counts as settled")
# Largest difference between two machines that is no difference in behaviour, and the reason; other columns are exact, timings ignored.
TOLERANCES: dict[str, tuple[float, str]] = {
    "time_s": (1e-9, "rounding of step times period"),
    **dict.fromkeys(("x_m", "y_m"), (1e-3, "a millimetre")),
    "z_m": (1e-4, "moves the symbol's light by 2 mm"),
    **dict.fromkeys(("roll_deg", "pitch_deg"), (0.05, "a hundredth of the range")),
    "pose_error_x_m": (0.02, "a tenth of a raw pixel, which is 11 cm along the road at 17 m; doubled for the target's own error"),
    "pose_error_y_m": (0.002, "a tenth of a raw pixel, which is 8 mm across the road at 17 m; doubled for the target's own error"),
    **dict.fromkeys(("pose_error_roll_deg", "pose_error_pitch_deg"), (0.1, "twice that of the pose")),
    **dict.fromkeys(CUT, (0.005, "a quarter of the share that is reported")),
    **dict.fromkeys(AIM, (0.25, "step between the places that are tried")),
    "area_ratio": (0.01, "the gate's limits are tens of percents apart"),
    **dict.fromkeys(AXES, (0.1, "a twentieth of what counts as settled")),
    **dict.fromkeys(("iou", *CAUSES), (0.01, "thin strokes: a shift of 2 mm across the road costs as much")),
    "ssim": (0.005, "half the IoU's, which it follows"),
    "length": (0.002, "a tenth of what counts as settled"),
    "shear": SHEAR,
    **dict.fromkeys(("road_true_m", "road_believed_m"), (1e-4, "moves the symbol's light by 2 mm")),
}
CENTROID_PX = (0.1, "a tenth of a pixel of the raw image")
CENTROID_M = (0.001, "a millimetre, as the pose's")
SHARE = 2e-3  # of a column's largest value: one pixel at the border of a shadow changes a mean over hundreds of pixels as much
STEADY_STEPS = 1  # a symbol at the border of 2 % may become steady a step sooner or later


@dataclass(frozen=True)
class Comparison:
    """Differences of a replay from its recording. notes: changes of inputs, versions and devices since the recording, a sentence each."""

    steps: int
    differences: tuple["Difference", ...]
    notes: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        """Whether all columns are within tolerance."""
        return not self.differences


@dataclass(frozen=True)
class Difference:
    """A column out of tolerance: first step out of tolerance, both values there, and the largest difference with its step."""

    column: str
    tolerance: float
    first_step: int
    recorded: float | str | None
    replayed: float | str | None
    largest: float
    largest_step: int


def tolerances(what: FeatureParams) -> dict[str, tuple[float, str]]:
    """Tolerance and reason by column of a symbol. what: features that its controller measures."""
    centroid = CENTROID_PX if what.view == "raw" else CENTROID_M
    shape = (centroid, centroid) if what.shape == "quadrants" else (SHEAR, centroid)
    features = dict(zip(ERRORS, (centroid, centroid, *shape), strict=True))
    return {**TOLERANCES, **features, **dict.fromkeys(CENTROIDS, centroid)}


def differences(
    recorded: pa.Table, replayed: pa.Table, held: Mapping[str, FeatureParams], *, exact: bool = False
) -> tuple[Difference, ...]:
    """Columns out of tolerance, in the order of the file; texts, and columns of zeros, must be equal.

    held: features of each symbol under control, by name. Both tables have the columns of `replayed`; different numbers of steps are a
    difference of the column "step", a value in one table only is an infinite difference. exact: whether all tolerances are 0.
    """
    steps = min(recorded.num_rows, replayed.num_rows)
    found = []
    if recorded.num_rows != replayed.num_rows:
        last = float(abs(recorded.num_rows - replayed.num_rows))
        found.append(Difference("step", 0.0, steps, float(recorded.num_rows), float(replayed.num_rows), last, steps))
    within = {f"functions.{name}.{key}": each for name, what in held.items() for key, (each, _) in tolerances(what).items()}
    symbols = tuple(f"functions.{name}." for name in held)
    for name in (name for name in replayed.column_names if not name.endswith("_ms")):
        tolerance = 0.0
        if not exact:
            shared = 0.0 if name.startswith(symbols) else _tolerance(recorded[name])
            tolerance = within.get(name, TOLERANCES["time_s"][0] if name == "time_s" else shared)
        apart = _distance(recorded[name][:steps], replayed[name][:steps])
        outside = np.flatnonzero(apart > tolerance)
        if len(outside):
            first, worst = int(outside[0]), int(apart.argmax())
            values = recorded[name][first].as_py(), replayed[name][first].as_py()
            found.append(Difference(name, tolerance, first, *values, float(apart[worst]), worst))
    return (*found, *(each for name in held for each in _coming_to_rest(name, recorded, replayed, 0 if exact else STEADY_STEPS)))


def _tolerance(column: pa.ChunkedArray) -> float:
    """Tolerance of a column with contributions of many pixels."""
    if not pa.types.is_floating(column.type):
        return 0.0
    return SHARE * max((abs(value) for value in column.to_pylist() if value is not None), default=0.0)


def _distance(a: pa.ChunkedArray, b: pa.ChunkedArray) -> np.ndarray:
    """Absolute differences `[steps]`; infinite where texts or truth values differ, or one value is empty."""
    if pa.types.is_string(b.type) or pa.types.is_boolean(b.type):
        return np.where(np.array(a.to_pylist(), object) == np.array(b.to_pylist(), object), 0.0, np.inf)
    a_values, b_values = a.to_numpy().astype(float), b.to_numpy().astype(float)
    with np.errstate(invalid="ignore"):
        apart = np.where(a_values == b_values, 0.0, np.abs(a_values - b_values))
    return np.where(np.isnan(a_values) & np.isnan(b_values), 0.0, np.where(np.isnan(apart), np.inf, apart))


def _coming_to_rest(name: str, recorded: pa.Table, replayed: pa.Table, tolerance: int) -> Iterator[Difference]:
    a, b = (steady_step(of_one(table, name)) for table in (recorded, replayed))
    apart = 0.0 if a == b else float("inf") if a is None or b is None else float(abs(a - b))
    if apart > tolerance:
        first = min(step for step in (a, b) if step is not None)
        yield Difference(f"functions.{name}: steady step", tolerance, first, a, b, apart, first)
