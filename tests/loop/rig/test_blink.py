"""The blink test: latency from drawn pictures, and blinks in which a part of the rig drops out."""

import math
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from luxloop.loop.rig import blink
from luxloop.loop.rig.matching import Regularity, shows
from luxloop.loop.rig.params import TimingParams
from luxloop.loop.rig.rig import Rig, await_camera, open_rig
from tests.loop.rig.conftest import Process, eventually

PERIOD_S, EXPOSURE_S, READOUT_S, LIGHT_S, REST_S = 1 / 30, 0.015, 0.003, 0.004, 0.03
LEAST_S = LIGHT_S + EXPOSURE_S + READOUT_S + REST_S  # latency without jitter
BLINKS = 100
GRID = (12, 16)


def drawn(seed: int, jitter_s: float, stuck: float = 0.0, drift: float = 0.0) -> tuple[blink.BlinkPictures, np.ndarray]:
    """Pictures of a camera of 30 Hz, one in a hundred of which is lost, and by how much each is late. stuck: share that is 50 ms late.
    drift: s in a s by which they come later and later.
    """
    rng = np.random.default_rng(seed)
    sent_s = 1 + np.cumsum(blink.HOLD_S + blink.SPREAD_S * rng.random(BLINKS + 1))
    begins_s = np.arange(rng.random() * PERIOD_S, sent_s[-1], PERIOD_S)
    begins_s = begins_s[rng.random(len(begins_s)) > 0.01]
    late_s = jitter_s * rng.random(len(begins_s)) + 0.05 * (rng.random(len(begins_s)) < stuck) + drift * begins_s
    arrived_s = np.maximum.accumulate(begins_s + EXPOSURE_S + READOUT_S + REST_S + late_s) + 1e-9 * np.arange(len(begins_s))
    regularity = Regularity()
    told_s = np.array([regularity.late(each) for each in arrived_s])
    of = np.searchsorted(sent_s, arrived_s, "right") - 1
    rows_s = begins_s[:, None] + np.linspace(0, READOUT_S, 6)  # [n, 6]
    share = ((rows_s + EXPOSURE_S - sent_s[of, None] - LIGHT_S) / EXPOSURE_S).clip(0, 1) + 0.002 * rng.standard_normal(rows_s.shape)
    kept = (of >= 0) & (arrived_s < sent_s[-1])
    columns = (arrived_s - sent_s[of], sent_s[of], told_s, share.min(1), share.max(1))
    looks = blink.BlinkPictures(*(each[kept] for each in columns), 0.01, np.diff(arrived_s), 0.0)
    return looks, (arrived_s - begins_s - (LEAST_S - LIGHT_S))[kept]


def contents(found: blink.BlinkResult, looks: blink.BlinkPictures, part: np.ndarray) -> list[str]:
    """Of some pictures, with the timing that was found."""
    timing = TimingParams(**found.timing)
    return [shows(lag_s, timing, late_s) for lag_s, late_s in zip(looks.lag_s[part], looks.late_s[part], strict=True)]


@pytest.mark.parametrize("jitter_s", [0.0, 0.01, 0.02])
def test_the_mean_latency_is_found_through_jitter(jitter_s):
    found = [blink.evaluate(drawn(seed, jitter_s)[0], BLINKS) for seed in range(8)]
    # A hundred blinks give 3 pictures a ms, at random times, so that the mean scatters by sqrt(J / 9 ms): by 1.5 ms at J = 20 ms
    scatter_s = 0.0005 + math.sqrt(jitter_s * PERIOD_S / BLINKS / 3)
    assert max(abs(each.latency_s - LEAST_S - jitter_s / 2) for each in found) < 3 * scatter_s
    assert max(abs(each.rolling_s - EXPOSURE_S - READOUT_S) for each in found) < 4 * scatter_s  # from two of these
    others, _ = drawn(8, jitter_s)
    assert not any("clear" in contents(each, others, others.least < 1 - others.seen) for each in found)


def test_pictures_that_are_stuck_leave_the_latency_as_it_is():
    looks, late_s = drawn(0, 0.01, stuck=0.03)
    found = blink.evaluate(looks, BLINKS)
    assert abs(found.latency_s - LEAST_S - 0.005) < 0.003
    assert late_s.max() > 0.05 and found.jitter_s < 0.05  # a run knows of these by the camera's rhythm
    assert "clear" not in contents(found, looks, looks.least < 1 - looks.seen)


@pytest.mark.parametrize("jitter_s", [0.0, 0.01])
def test_a_drift_is_told_and_its_scatter_is_not(jitter_s):
    steady, drifting = ([blink.evaluate(drawn(seed, jitter_s, drift=each)[0], BLINKS) for seed in range(8)] for each in (0.0, -0.015 / 60))
    # Four standard deviations, of which 50 draws tell 10 %. With jitter, 15 ms a minute are three of them, so that some are not told.
    assert all(abs(each.drift_s_per_min[0]) < 4 * each.drift_s_per_min[1] + 0.0003 for each in steady)
    assert all(abs(each.drift_s_per_min[0] + 0.015) < 4 * each.drift_s_per_min[1] + 0.0003 for each in drifting)
    assert not any(each.warning for each in steady)
    assert sum(bool(each.warning) for each in drifting) >= (6 if jitter_s else 8)


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blinks of a tenth of a second, for a camera whose latency is 15 ms."""
    for name, value in {"HOLD_S": 0.1, "SPREAD_S": 0.02, "LEARN_S": 0.3}.items():
        monkeypatch.setattr(blink, name, value)


def watched(process: Process, blinks: int, advance: Callable[[Rig], None], **tables: Any) -> blink.BlinkPictures:
    with open_rig(process.params(**tables), (GRID,), None, armed=True) as rig:
        assert await_camera(rig)
        return blink.record(rig, (GRID,), blinks, 1.0, lambda: advance(rig))


def first_s(looks: blink.BlinkPictures) -> float:
    """From light to the earliest picture that shows it."""
    return float(looks.lag_s[looks.most > looks.seen].min())


@pytest.mark.usefixtures("fast")
def test_a_camera_that_drops_out_voids_its_blinks(small_rig):
    process = small_rig(dark_s=0.5, mute_after_s=2.0, mute_for_s=0.6)
    darkened = []
    looks = watched(process, 20, lambda rig: darkened.append(rig.keeper.reason))
    assert any("no picture for 0.3 s" in each for each in darkened)
    assert 10 <= len(np.unique(looks.at_s)) < 20
    assert first_s(looks) > 0.01  # the latency without exposure: no earlier picture shows a change, so none was voided in part


@pytest.mark.usefixtures("fast")
def test_black_after_darkness_is_no_change_of_light(small_rig):
    reasons = list[str]()

    def advance(rig: Rig) -> None:
        reasons.append(rig.keeper.reason)
        if len(reasons) == 5:  # the next light is on, and goes out in its midst
            threading.Thread(target=darken, args=(rig, rig.keeper.since_s)).start()

    def darken(rig: Rig, before_s: float | None) -> None:
        if eventually(lambda: rig.keeper.since_s != before_s):
            rig.keeper.dark("somebody darkened it")

    looks = watched(small_rig(dark_s=0.5), 10, advance)
    assert [number for number, each in enumerate(reasons) if each] == [5]
    assert len(np.unique(looks.at_s)) == 8  # without that one, and without the black that followed
    assert first_s(looks) > 0.01


@pytest.mark.usefixtures("fast")
def test_a_rig_that_stays_away_ends_the_test_in_a_sentence(small_rig):
    process = small_rig(dark_s=0.5)
    with pytest.raises(blink.LuxloopError, match=r"blink: (camera|light)"):
        watched(process, 10, lambda rig: process.kill())
