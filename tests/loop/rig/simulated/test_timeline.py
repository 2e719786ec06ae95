"""What is lit when: without a gap, and never longer than its sender lives."""

import time
from itertools import pairwise

import numpy as np

from luxloop.loop.rig.simulated.lamp import Timeline
from tests.loop.rig.simulated.conftest import light

ON, OFF = np.full(4, 255, np.uint8), np.zeros(4, np.uint8)


def test_it_goes_out_when_nothing_comes():
    timeline, before_s = Timeline(0.25), time.monotonic()  # a busy machine sleeps some tens of milliseconds longer
    assert timeline.state()["dark_since_s"] <= before_s
    timeline.show(light(ON, 1))
    assert timeline.state()["lit"] and timeline.state()["light_sum"] == 4
    time.sleep(0.15)
    timeline.show(light(ON, 1))  # sent again
    time.sleep(0.15)
    assert timeline.state()["lit"]
    time.sleep(0.25)
    state, now_s = timeline.state(), time.monotonic()
    assert not state["lit"] and 0.05 < now_s - state["dark_since_s"] < 0.25
    segments = timeline.between(before_s, now_s)
    assert [each.light and each.light.timecodes for each in segments] == [None, (1,), None]
    assert all(a.to_s == b.from_s for a, b in pairwise(segments))
    assert segments[0].from_s == before_s and segments[-1].to_s == now_s
    assert segments[1].to_s == state["dark_since_s"]
    timeline.show(light(ON, 1))
    assert timeline.state()["lit"], "the same light shines anew"


def test_dark_frames_are_darkness():
    timeline = Timeline(1.0)
    timeline.show(light(ON, 1))
    timeline.show(light(OFF, 2))
    first = timeline.state()["dark_since_s"]
    timeline.show(light(OFF, 3))
    assert first is not None and timeline.state()["dark_since_s"] == first


def test_light_is_as_late_as_its_lamp():
    timeline = Timeline(1.0, latency_s=0.02)
    asked_s = time.monotonic()
    timeline.show(light(ON, 1))
    shown_s = time.monotonic()
    time.sleep(0.025)
    dark, lit = timeline.between(asked_s, time.monotonic())
    assert dark.light is None and asked_s + 0.02 <= lit.from_s <= shown_s + 0.02
