"""Figures of the response of a held symbol to its start: integrals of the error, rise time and peak."""

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from luxloop.loop.recording.summary import AXES, LEAST_START_PERCENT, Summary, column, steps_with_metrics

RISEN = 0.1  # share of the initial error at which a response has risen
LEAST_WAY_M = 0.05  # of a pose whose effort counts
DARK_PERCENT = 100.0  # error on the road in a step without light


def response(table: pa.Table) -> Summary:
    """Figures of one symbol's columns (`luxloop.loop.simulation.columns.of_one`): None where a value does not exist.

    road: of the centroid's distance from its target in % of the symbol's size, in evaluated steps; 100 in those without light. camera: of
    the measured distance in m (`pose_error_x_m`, `pose_error_y_m`), in steps with a measurement. Each has iae, itae and ise, the integrals
    of |e|, t |e| and e^2 over time in s; rise_s, the time until |e| is at most a tenth of that of the first step; and peak, the largest |e|
    from then on.
    """
    evaluated = steps_with_metrics(table)
    away = np.hypot(*(column(evaluated, axis) for axis in AXES))
    measured = np.hypot(column(table, "pose_error_x_m"), column(table, "pose_error_y_m"))
    seen = np.isfinite(measured)
    return {
        "road": _of_error(column(evaluated, "time_s"), np.nan_to_num(away, nan=DARK_PERCENT), LEAST_START_PERCENT),
        "camera": _of_error(column(table, "time_s")[seen], measured[seen], 0.0),
    }


def effort(table: pa.Table) -> float | None:
    """Length of the path of a symbol's pose along x and y, relative to the way from its first to its last pose; None without a way."""
    places = np.stack([column(table, "x_m"), column(table, "y_m")], -1)
    way = float(np.linalg.norm(places[-1] - places[0])) if len(places) else 0.0
    return float(np.linalg.norm(np.diff(places, axis=0), axis=-1).sum()) / way if way > LEAST_WAY_M else None


def _of_error(times_s: NDArray[np.floating], error: NDArray[np.floating], least_start: float) -> Summary:
    """Figures of an error `[steps]` >= 0. least_start: initial error up to which there is no rise."""
    if not len(error):
        return dict.fromkeys(("iae", "itae", "ise", "rise_s", "peak"))
    since_s = times_s - times_s[0]
    risen = np.flatnonzero(error <= RISEN * error[0])
    rises = len(risen) > 0 and error[0] > least_start
    return {
        "iae": float(np.trapezoid(error, since_s)),
        "itae": float(np.trapezoid(since_s * error, since_s)),
        "ise": float(np.trapezoid(error**2, since_s)),
        "rise_s": float(since_s[risen[0]]) if rises else None,
        "peak": float(error[risen[0] :].max()) if rises else None,
    }
