"""Key figures of a symbol under control: settling, overshoot, and its final overlap with the target."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from luxloop.controllers.symbol.sensing.field import SIDES

Summary = dict[str, Any]  # of a run or of a part of it, ready for JSON
FINAL = 10  # steps: their mean is the final value, and a steady symbol stays near it as long
END = 5  # steps: their mean is the final error of the centroid
STEADY = {  # largest deviation of a steady symbol from its final value: 2 % of its size and length, 0.02 of shear
    "centroid_error_x_percent": 2.0,
    "centroid_error_y_percent": 2.0,
    "length": 0.02,
    "shear": 0.02,
}
AXES = ("centroid_error_x_percent", "centroid_error_y_percent")
OFF_PERCENT = 5.0  # largest final error of a settled symbol
LEAST_START_PERCENT = 5.0  # least initial error of an axis whose overshoot counts


DRAWN = {  # columns of `judge_causes`
    "iou_open": "without control",
    "iou_true_pose": "for the true pose",
    "iou_true_road": "for the true road",
    "iou_true": "for both",
    "iou_end": "at the end of its light",
}


@dataclass(frozen=True)
class Circumstances:
    """Facts of a run that a symbol's columns do not have.

    judge_every: the scenario's key, None where the plant does not know the truth. drives: whether the car moves. road_m: largest height of
    the road above the ground plane at the target, signed, NaN if unknown. highest_m: largest height in the controller's search, None for a
    controller without one.
    """

    judge_every: int | None = 1
    drives: bool = False
    road_m: float = math.nan
    highest_m: float | None = None


def summarise(
    table: pa.Table, controller: str, iou_open: float, covered_by: Sequence[str] = (), run: Circumstances = Circumstances()
) -> Summary:
    """Summary of one symbol's columns (`luxloop.loop.simulation.columns.of_one`), ready for JSON: None where a value does not exist.

    iou_open: IoU of the open loop at the last step, NaN without one. centroid_error_percent: [x, y], signed, mean of the last five steps.
    unsettled: why there is no settle_step (`settling_failure`). cut, cut_side: share of the symbol beyond the lamps' field at the last
    step, and the border with the largest share. aim: place [x, y] in m of the symbol at the last step if that is not its target, else None.
    iou_mean: of all evaluated steps, as are iou_open_mean and the other means of `DRAWN`, None without `judge_causes`.
    iou_second_half_mean, iou_second_half_min: of those in the second half of the run. shown_steps: steps that show the symbol; seen_steps:
    steps with a measurement; lost_steps: steps whose frames lack the symbol; covered_steps: lost steps in which other functions
    (covered_by) cover the symbol.
    """
    evaluated, losses = steps_with_metrics(table), table["loss"].to_pylist()
    ious, late = column(evaluated, "iou"), column(table, "iou")[table.num_rows // 2 :]
    late = late[np.isfinite(late)]
    shares = {side: last(table, f"cut_{side}") for side in SIDES}
    aim = [last(table, axis) for axis in ("aim_x_m", "aim_y_m")]
    found: Summary = {
        "controller": controller,
        "shown_steps": table.num_rows,
        "seen_steps": losses.count(""),
        "lost_steps": sum(loss not in ("", "no_frame") for loss in losses),
        "covered_steps": losses.count("covered"),
        "covered_by": [*covered_by],
        "settle_step": settle_step(table),
        "unsettled": settling_failure(table),
        "steady_step": steady_step(table),
        "overshoot_percent": None if run.drives else overshoot_percent(table),  # the road moves the symbol of a car that drives
        "centroid_error_percent": [*final_error_percent(table)],
        "cut": sum(shares.values()),
        "cut_side": max(SIDES, key=shares.__getitem__) if sum(shares.values()) > 0 else None,
        "aim": None if math.isnan(aim[0]) else aim,
        "iou_open": iou_open,
        "iou_final": last(evaluated, "iou"),
        "iou_mean": ious.mean() if len(ious) else None,
        **{f"{key}_mean": column(evaluated, key).mean() if key in table.column_names and len(ious) else None for key in DRAWN},
        "iou_second_half_mean": late.mean() if len(late) else None,
        "iou_second_half_min": late.min(initial=math.inf),
        "z_m_final": last(table, "z_m"),
        "ssim_final": last(evaluated, "ssim"),
        **asdict(run),
    }
    return finite(found)


def steps_with_metrics(table: pa.Table) -> pa.Table:
    """Rows of the evaluated steps."""
    return table.filter(table["iou"].is_valid())


def settle_step(table: pa.Table) -> int | None:
    """The step from which on the symbol is steady (`steady_step`); None where it has not settled on the target (`settling_failure`)."""
    return steady_step(table) if settling_failure(table) is None else None


def settling_failure(table: pa.Table) -> str | None:
    """Why the symbol has not settled on the target; None where it has.

    not_shown: in no step. not_judged: no step was evaluated. too_short: fewer than ten steps were. lost, no_frame, covered: no measurement
    in most of the last ten steps, because the symbol was not found, most frames were missing, or other functions covered most of the
    symbol. moving: lit, but not steady. off_target: nothing lit at the target, or more than 5 % of the symbol's length or width off (mean
    of the last five steps).
    """
    evaluated = steps_with_metrics(table)
    if not evaluated.num_rows:
        return "not_judged" if table.num_rows else "not_shown"
    if evaluated.num_rows < FINAL:
        return "too_short"
    losses = evaluated["loss"][-FINAL:].to_pylist()
    if 2 * losses.count("") < FINAL:
        return next((why for why in ("no_frame", "covered") if 2 * losses.count(why) > FINAL), "lost")
    error = final_error_percent(table)
    if np.isfinite(error).all() and steady_step(table) is None:
        return "moving"
    return None if (np.abs(error) <= OFF_PERCENT).all() else "off_target"


def final_error_percent(table: pa.Table) -> np.ndarray:
    """Error of the centroid `[2]` along x and y, signed, in % of the symbol's length and width; NaN if the last steps are dark."""
    table = steps_with_metrics(table)
    return np.array([column(table, axis)[-END:].mean() if table.num_rows else math.nan for axis in AXES])


def steady_step(table: pa.Table) -> int | None:
    """The first step from which centroid, length and shear stay near their means of the last ten steps, for ten steps or more.

    None where there is no such step. In a step without light the symbol is not near. Its position does not count.
    """
    table = steps_with_metrics(table)
    if table.num_rows < FINAL:
        return None
    near = np.ones(table.num_rows, dtype=bool)
    for name, tolerance in STEADY.items():
        values = column(table, name)
        near &= np.abs(values - values[-FINAL:].mean()) <= tolerance
    strays = np.flatnonzero(~near)
    first = int(strays[-1]) + 1 if len(strays) else 0
    return table["step"][first].as_py() if first <= table.num_rows - FINAL else None


def overshoot_percent(table: pa.Table) -> float | None:
    """Largest excursion past the final value in % of the initial error, over the axes with an initial error above 5 % of the symbol's size.

    None without such an axis.
    """
    excursions = []
    for axis in AXES:
        values = column(table, axis)
        values = values[np.isfinite(values)]
        if len(values) and abs(values[0]) > LEAST_START_PERCENT:
            final = values[-FINAL:].mean()
            past = (final - values) * np.sign(values[0] - final)
            excursions.append(100 * past.max() / abs(values[0]))
    return float(max(0.0, *excursions)) if excursions else None


def column(table: pa.Table, name: str) -> np.ndarray:
    """A column of numbers `[steps]` float64, NaN for empty fields."""
    return table[name].to_numpy().astype(np.float64)


def last(table: pa.Table, name: str) -> float:
    """A column's number in the last row; NaN where the field is empty or the table has no row."""
    return float(column(table, name)[-1]) if table.num_rows else math.nan


def finite(value: Any) -> Any:
    """A summary with None in place of numbers that are not finite."""
    if isinstance(value, dict):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list):
        return [finite(each) for each in value]
    return value if not isinstance(value, float) else float(value) if math.isfinite(value) else None
