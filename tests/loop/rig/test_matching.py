"""Which light a frame shows, by its time and by a mark."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.light import Shine, limit
from luxloop.loop.rig.matching import Regularity, draw_mark, limits_beside_mark, read_mark, shows
from luxloop.loop.rig.params import LimitParams, MarkParams, TimingParams
from tests.refusal import refusal

MARK = MarkParams(row=2, column=4, rows=4, columns=16, u_px=40, v_px=20, width_px=160, height_px=40)


def test_a_frame_counts_when_all_earlier_light_must_be_gone():
    timing = TimingParams(latency_s=0.05, jitter_s=0.02, rolling_s=0.03)
    assert [shows(lag_s, timing) for lag_s in (-0.1, 0.0199, 0.021, 0.0699, 0.0701)] == ["old", "old", "mixed", "mixed", "clear"]
    # The rhythm by which a picture is 0.1 s late may itself be late by half of the jitter.
    assert [shows(lag_s, timing, 0.1) for lag_s in (0.0199, 0.1599, 0.1601)] == ["old", "mixed", "clear"]


def test_a_picture_that_is_stuck_is_late_and_so_are_those_behind_it():
    regularity = Regularity()
    drawn = np.random.default_rng(0)
    late = [regularity.late(k / 30 + 0.01 * drawn.random()) for k in range(200)]
    assert max(late[8:]) < 0.015 and late[7] == float("inf")  # the jitter, and a little
    stuck = [regularity.late(max(k / 30, 201 / 30 + 0.1)) for k in range(200, 206)]  # 200 to 204 come together
    assert stuck[0] == pytest.approx(0.1 + 1 / 30, abs=0.02)
    assert stuck[1] == pytest.approx(0.1, abs=0.02) and stuck[-1] < 0.02
    assert shows(0.15, TimingParams(latency_s=0.05, jitter_s=0.02), stuck[0]) == "mixed"
    lost = [regularity.late(k / 30) for k in range(207, 240)]  # one is missing
    assert lost[0] == pytest.approx(1 / 30, abs=0.02) and lost[-1] < 0.003
    jam_s = 250 / 30
    jammed = [(regularity.late(max(k / 30, jam_s)), jam_s - k / 30) for k in range(240, 251)]  # in a third of a second none comes
    assert all(late_s == pytest.approx(true_s, abs=0.01) for late_s, true_s in jammed)


def test_a_mark_names_the_exposure_modulo_four_or_none():
    dark = (np.zeros((20, 30), np.float32),)
    images = []
    for number in range(9):
        light = draw_mark(dark, MARK, number)[0]
        images.append(40 + 150 * cv2.resize(light, None, fx=10, fy=10, interpolation=cv2.INTER_AREA))  # ten camera pixels a lamp pixel
        assert read_mark(images[-1], MARK) == number % 4
    assert read_mark(images[0] * 0 + 40, MARK) is None
    for before, after in pairwise(images):  # half of each
        assert read_mark((before + after) / 2, MARK) is None


def test_a_mark_is_within_the_limit_of_power():
    limits = limits_beside_mark(LimitParams(power_w=20.0, full_w=80.0), MARK, ((20, 30),))
    given = limit(Shine(1, (np.ones((20, 30), np.float32),)), None, 1.0, limits)
    assert 0.2 < Shine(1, draw_mark(given.shine.pictures, MARK, 1)).share < 0.25
    bare = limit(Shine(1, (np.pad(np.ones((4, 30), np.float32), ((16, 0), (0, 0))),)), None, 1.0, limits)  # beside the mark alone
    assert Shine(1, draw_mark(bare.shine.pictures, MARK, 1)).share == pytest.approx(0.25)
    with refusal(r"mark: takes 5.3% of the lamp's power, where limits allow 1.0%; make it smaller"):
        limits_beside_mark(LimitParams(power=0.01), MARK, ((20, 30),))
