"""Two trajectories of one scenario held against each other, column by column, within stated tolerances."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from controllers.symbol.sensing.flat_model import FeatureParams
from loop.recording.recorder import AIM, CENTROIDS, COLUMNS, CUT, ERRORS, LATER
from loop.recording.summary import steady_step

SHEAR = (0.005, "a quarter of what counts as settled")
# Largest difference between two machines that is no difference in behaviour, and why. Timings are excepted, all else is exact.
TOLERANCES: dict[str, tuple[float, str]] = {
    "time_s": (1e-9, "rounding of step times period"),
    "x_m": (1e-3, "a millimetre"),
    "y_m": (1e-3, "a millimetre"),
    "z_m": (1e-4, "what moves the symbol's light by two millimetres"),
    "roll_deg": (0.05, "a hundredth of the range"),
    "pitch_deg": (0.05, "a hundredth of the range"),
    "pose_error_x_m": (0.02, "a tenth of a pixel: the raw image has 11 cm a pixel along the road at 17 m; twice, for the target's own"),
    "pose_error_y_m": (0.002, "a tenth of a pixel: the raw image has 8 mm a pixel across the road at 17 m; twice, for the target's own"),
    "pose_error_roll_deg": (0.1, "twice the pose's"),
    "pose_error_pitch_deg": (0.1, "twice the pose's"),
    **dict.fromkeys(CUT, (0.005, "a quarter of what is mentioned")),
    **dict.fromkeys(AIM, (0.25, "a step between places that are tried")),
    "area_ratio": (0.01, "the gate's limits are tens of percents apart"),
    "centroid_error_x_percent": (0.1, "a twentieth of what counts as settled"),
    "centroid_error_y_percent": (0.1, "a twentieth of what counts as settled"),
    "iou": (0.01, "thin strokes: a shift of 2 mm across the road costs as much"),
    "ssim": (0.005, "half the IoU's, which it follows"),
    "length": (0.002, "a tenth of what counts as settled"),
    "shear": SHEAR,
}
CENTROID_PX = (0.1, "a tenth of a pixel of the raw image")
CENTROID_M = (0.001, "a millimetre, as the pose's")
STEADY_STEPS = 1  # a symbol at the border of 2 % may come to rest a step sooner or later


@dataclass(frozen=True)
class Difference:
    """A column out of tolerance: the step where it first is, the two values there, and the largest difference with its step."""

    column: str
    tolerance: float
    first_step: int
    recorded: float | str | None
    replayed: float | str | None
    largest: float
    largest_step: int


def tolerances(what: FeatureParams) -> dict[str, tuple[float, str]]:
    """Tolerance and reason of every numeric column that is compared within one, for the features that a scenario looks at."""
    centroid = CENTROID_PX if what.view == "raw" else CENTROID_M
    shape = (centroid, centroid) if what.shape == "quadrants" else (SHEAR, centroid)
    features = dict(zip(ERRORS, (centroid, centroid, *shape), strict=True))
    return {**TOLERANCES, **features, **dict.fromkeys(CENTROIDS, centroid)}


def compare(recorded: pa.Table, replayed: pa.Table, within: dict[str, tuple[float, str]]) -> tuple[Difference, ...]:
    """Columns that differ by more than `within` has for them, in the order of the file; exactly those that it has not.

    Both tables have the columns of a recording, the recorded one perhaps those of an older version; steps that only one has are a
    difference of the column "step". What was not seen in both is equal, what was not seen in one is an infinite difference. An empty
    `within` asks for bit-identical trajectories.
    """
    steps = min(recorded.num_rows, replayed.num_rows)
    found = []
    if recorded.num_rows != replayed.num_rows:
        last = float(abs(recorded.num_rows - replayed.num_rows))
        found.append(Difference("step", 0.0, steps, float(recorded.num_rows), float(replayed.num_rows), last, steps))
    lacking = {name for name in LATER if name not in recorded.column_names}
    for name in (name for name in COLUMNS if not name.endswith("_ms") and name not in lacking):
        tolerance = within.get(name, (0.0, ""))[0]
        apart = _distance(recorded[name][:steps], replayed[name][:steps])
        outside = np.flatnonzero(apart > tolerance)
        if len(outside):
            first, worst = int(outside[0]), int(apart.argmax())
            values = recorded[name][first].as_py(), replayed[name][first].as_py()
            found.append(Difference(name, tolerance, first, *values, float(apart[worst]), worst))
    return (*found, *_coming_to_rest(recorded, replayed, STEADY_STEPS if within else 0))


def _distance(a: pa.ChunkedArray, b: pa.ChunkedArray) -> np.ndarray:
    """Absolute differences `[steps]`; infinite where words differ or only one value is there."""
    if pa.types.is_string(a.type):
        return np.where(np.array(a.to_pylist()) == np.array(b.to_pylist()), 0.0, np.inf)
    a_values, b_values = a.to_numpy().astype(float), b.to_numpy().astype(float)
    apart = np.abs(a_values - b_values)
    return np.where(np.isnan(a_values) & np.isnan(b_values), 0.0, np.where(np.isnan(apart), np.inf, apart))


def _coming_to_rest(recorded: pa.Table, replayed: pa.Table, tolerance: int) -> Iterator[Difference]:
    a, b = steady_step(recorded), steady_step(replayed)
    apart = 0.0 if a == b else float("inf") if a is None or b is None else float(abs(a - b))
    if apart > tolerance:
        first = min(step for step in (a, b) if step is not None)
        yield Difference("steady_step", tolerance, first, a, b, apart, first)
