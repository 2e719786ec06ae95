"""How a symbol that is held has come to lie, in a few numbers: when it settled, how far it overshot, how well it lies in the end."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from luxloop.controllers.symbol.sensing.field import SIDES

Summary = dict[str, Any]  # of a run or of a part of it, ready for JSON
FINAL = 10  # steps whose mean is the final value, and for which a symbol at rest has to stay
END = 5  # steps whose mean error of the centroid is that at the end
STEADY = {  # how far from the final value a symbol at rest may be: 2 % of its size and length, 0.02 of shear
    "centroid_error_x_percent": 2.0,
    "centroid_error_y_percent": 2.0,
    "length": 0.02,
    "shear": 0.02,
}
AXES = ("centroid_error_x_percent", "centroid_error_y_percent")
OFF_PERCENT = 5.0  # a symbol that ends further from the target has not settled there
LEAST_START_PERCENT = 5.0  # an axis that starts nearer to the target says nothing about overshoot


@dataclass(frozen=True)
class Circumstances:
    """What a run says of a symbol beside its columns.

    judge_every: the scenario's, None where the plant does not know the truth. drives: whether the car moves. road_m: height of the road
    over the plane of the ground where it is farthest from it at the target, NaN where nobody knows. highest_m: largest height that the
    controller looks for, None where it looks for none.
    """

    judge_every: int | None = 1
    drives: bool = False
    road_m: float = math.nan
    highest_m: float | None = None


def summarise(
    table: pa.Table, controller: str, iou_open: float, covered_by: Sequence[str] = (), run: Circumstances = Circumstances()
) -> Summary:
    """Summary of one symbol's columns (`luxloop.loop.simulation.columns.of_one`), ready for JSON: None where a value does not exist.

    iou_open: IoU of the open loop at the last step, NaN without one. centroid_error_percent: [x, y], signed, mean
    of the last five steps.
    unsettled: why there is no settle_step (`settling_failure`). cut: share of the symbol beyond the borders of the lamps' field at the
    last step, and the side where most of it is. aim: [x, y] in m of where the symbol lies at the last step in place of its target, None
    for that. iou_mean, iou_min: of the second half of the run. shown_steps: how many show it; in seen_steps frames came that do, in
    lost_steps frames in which it was not found, of which functions, covered_by, covered it in covered_steps.
    """
    shown, lain, losses = table.num_rows > 0, steps_with_metrics(table), table["loss"].to_pylist()
    late = column(table, "iou")[table.num_rows // 2 :]
    late = late[np.isfinite(late)]
    return {
        "controller": controller,
        "shown_steps": table.num_rows,
        "seen_steps": losses.count(""),
        "lost_steps": sum(loss not in ("", "no_frame") for loss in losses),
        "covered_steps": losses.count("covered"),
        "covered_by": [*covered_by],
        "settle_step": settle_step(table),
        "unsettled": settling_failure(table),
        "steady_step": steady_step(table),
        "overshoot_percent": None if run.drives else overshoot_percent(table),  # the road itself moves what a car that drives shows
        "centroid_error_percent": [_number(error) for error in final_error_percent(table)],
        **_cut(table),
        "aim": _aim(table),
        "iou_open": _number(iou_open),
        "iou_final": _number(column(lain, "iou")[-1]) if lain.num_rows else None,
        "iou_mean": float(late.mean()) if len(late) else None,
        "iou_min": float(late.min()) if len(late) else None,
        "z_m_final": _number(column(table, "z_m")[-1]) if shown else None,
        "ssim_final": _number(column(lain, "ssim")[-1]) if lain.num_rows else None,
        **asdict(run),
        "road_m": _number(run.road_m),
    }


def steps_with_metrics(table: pa.Table) -> pa.Table:
    """The steps of a table that were evaluated."""
    return table.filter(table["iou"].is_valid())


def settle_step(table: pa.Table) -> int | None:
    """The step from which on the symbol is steady (`steady_step`); None where it has not settled on the target (`settling_failure`)."""
    return steady_step(table) if settling_failure(table) is None else None


def settling_failure(table: pa.Table) -> str | None:
    """Why the symbol has not settled on the target; None where it has.

    not_shown: in no step. not_judged: no step was evaluated. too_short: fewer than ten steps. lost: not seen in most of the last ten;
    no_frame: as most of their frames were missing; covered: as other functions took most of it. moving: lit, but not steady. off_target:
    nothing lit at the target, or more than 5 % of the symbol's length or width off (mean of the last five steps).
    """
    if not steps_with_metrics(table).num_rows:
        return "not_judged" if table.num_rows else "not_shown"
    if steps_with_metrics(table).num_rows < FINAL:
        return "too_short"
    losses = steps_with_metrics(table)["loss"][-FINAL:].to_pylist()
    if 2 * losses.count("") < FINAL:
        return next((why for why in ("no_frame", "covered") if 2 * losses.count(why) > FINAL), "lost")
    error = final_error_percent(table)
    if np.isfinite(error).all() and steady_step(table) is None:
        return "moving"
    return None if (np.abs(error) <= OFF_PERCENT).all() else "off_target"


def final_error_percent(table: pa.Table) -> np.ndarray:
    """Error of the centroid `[2]` along x and y, signed, in % of the symbol's length and width; NaN where the last steps are not lit."""
    table = steps_with_metrics(table)
    return np.array([column(table, axis)[-END:].mean() if table.num_rows else math.nan for axis in AXES])


def _cut(table: pa.Table) -> Summary:
    shares = {side: column(table, f"cut_{side}")[-1] for side in SIDES} if table.num_rows else dict.fromkeys(SIDES, math.nan)
    total = sum(shares.values())
    return {"cut": _number(total), "cut_side": max(SIDES, key=shares.__getitem__) if total > 0 else None}


def _aim(table: pa.Table) -> list[float] | None:
    last = [float(column(table, axis)[-1]) for axis in ("aim_x_m", "aim_y_m")] if table.num_rows else [math.nan]
    return None if math.isnan(last[0]) else last


def steady_step(table: pa.Table) -> int | None:
    """The first step from which, for at least ten steps and to the end, centroid, length and shear stay near their mean of the last ten.

    None if there is none. A step at which nothing was lit is not near. Where the symbol lies does not matter.
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
    """The largest excursion past the final value, in % of the initial error, of the axes that start more than 5 % of the size off.

    None if neither does.
    """
    excursions = []
    for axis in AXES:
        values = column(table, axis)
        values = values[np.isfinite(values)]
        if len(values) and abs(values[0]) > LEAST_START_PERCENT:
            final = values[-FINAL:].mean()
            past = (final - values) * np.sign(values[0] - final)
            excursions.append(100 * past.max() / abs(values[0]))
    return _number(max(0.0, *excursions)) if excursions else None


def column(table: pa.Table, name: str) -> np.ndarray:
    """A column of numbers, `[steps]` float64; NaN where there is none."""
    return table[name].to_numpy().astype(np.float64)


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
