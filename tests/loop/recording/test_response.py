"""Figures of a response: those of an exponential are its integrals, and missing steps count as they should."""

import math

import numpy as np
import pyarrow as pa
import pytest

from luxloop.loop.studies.runs import response

TIMES_S = np.linspace(0.0, 4.0, 401)


def table(x_percent: np.ndarray, iou: np.ndarray, measured_m: np.ndarray) -> pa.Table:
    zero = np.zeros(len(x_percent))
    columns = {"time_s": TIMES_S[: len(zero)], "centroid_error_x_percent": x_percent, "centroid_error_y_percent": zero, "iou": iou}
    return pa.table({**columns, "pose_error_x_m": measured_m, "pose_error_y_m": zero}, schema=None)


def test_an_exponential_has_its_integrals():
    decay = np.exp(-TIMES_S / 0.5)
    found = response(table(-40 * decay, np.ones(401), 2 * decay))
    # To infinity 40 T, 40 T^2 and 40^2 T / 2; what lies beyond 8 T and the trapezoids of 0.01 s are within 0.5 %.
    assert [found["road"][key] for key in ("iae", "itae", "ise")] == pytest.approx([20.0, 10.0, 400.0], rel=5e-3)
    assert found["road"]["rise_s"] == pytest.approx(0.5 * math.log(10), abs=0.01) and found["road"]["peak"] <= 4.0
    assert found["camera"]["iae"] == pytest.approx(1.0, rel=5e-3)


def test_an_overshoot_is_the_peak():
    away = np.array([10.0, 4.0, 0.5, -3.0, 1.0, 0.0])
    found = response(table(away, np.ones(6), np.abs(away)))
    assert (found["road"]["peak"], found["road"]["rise_s"]) == (3.0, pytest.approx(0.02))


def test_darkness_is_an_error_and_what_is_not_seen_or_evaluated_is_none():
    iou = np.array([0.5, 0.0, 0.9, np.nan])
    away = np.array([10.0, np.nan, 0.0, np.nan])
    given = table(away, iou, np.array([1.0, np.nan, 0.1, 0.1]))
    given = given.set_column(given.column_names.index("iou"), "iou", pa.array(iou, from_pandas=True))
    found = response(given)
    assert found["road"]["iae"] == pytest.approx((55.0 + 50.0) * 0.01), "a step without light counts as 100 %"
    assert found["camera"]["rise_s"] == pytest.approx(0.02)
    dark = response(table(away[1:2], iou[1:2], away[1:2]))
    assert set(dark["camera"].values()) == {None}
