"""The rig as a projector: it shows the page of a loop whose light is `screen`."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.params import ScreenLightParams
from luxloop.loop.rig.screen import ScreenLight
from luxloop.loop.rig.simulated.lamp import ScreenInput, Timeline
from tests.loop.rig.conftest import eventually

GRIDS = [(2, 3), (1, 4)]


def shine(number: int) -> Shine:
    """Another pattern for each number."""
    drawn = np.random.default_rng(number)
    return Shine(number, tuple(drawn.random(grid, np.float32) for grid in GRIDS))


@contextmanager
def showing(timeout_s: float, grids: list[tuple[int, int]] = GRIDS) -> Iterator[tuple[ScreenLight, ScreenInput, Timeline]]:
    """A loop's light, and a rig that shows it."""
    light, timeline = ScreenLight(ScreenLightParams(kind="screen", port=0), GRIDS), Timeline(timeout_s)
    rig = ScreenInput(timeline, grids, ("127.0.0.1", light.port))
    try:
        assert eventually(lambda: light.has_page)
        yield light, rig, timeline
    finally:
        rig.close()
        light.close()


def test_pixels_are_those_that_were_sent_in_their_order():
    with showing(60.0) as (light, rig, timeline):
        begun_s = time.monotonic()
        for number in range(5):
            assert light.show(shine(number)) is None and light.answer["number"] == number
        lit = [each.light for each in timeline.between(begun_s, time.monotonic()) if each.light and each.light.timecodes]
        assert [each.timecodes for each in lit] == [(number,) for number in range(5)]
        for each in lit:
            sent = np.concatenate([u.ravel() for u in shine(each.timecodes[0]).pictures])
            assert np.array_equal(each.codes, np.rint(255 * sent))
        light.dark()
        assert eventually(lambda: not timeline.state()["lit"])
        assert rig.counts()["frames"] == 5


def test_it_is_dark_without_word_of_the_loop_and_says_so():
    with showing(1.0) as (light, _, timeline):
        began_s = last_s = time.monotonic()
        assert light.show(shine(1)) is None
        while time.monotonic() < began_s + 1.5:
            time.sleep(0.2)
            lit = light.show(shine(1)) is None and timeline.state()["lit"]
            now_s = time.monotonic()
            assert lit or now_s > last_s + 1.0, "the same light says that the loop is alive, unless a busy machine stood still"
            last_s = now_s
        assert eventually(lambda: not timeline.state()["lit"])
        assert eventually(lambda: "darkened by itself" in str(light.show(shine(1))))
        assert eventually(lambda: light.show(shine(1)) is None and timeline.state()["lit"]), "it is sent whole again"


def test_a_picture_of_another_size_is_not_shown():
    with showing(60.0, [(2, 3)]) as (light, rig, timeline):
        assert "has not shown it in time" in str(light.show(shine(1)))
        assert rig.counts()["refused"] == 1 and not timeline.state()["lit"]


def test_it_comes_back_to_a_loop_that_has_gone():
    with showing(60.0) as (light, _, timeline):
        assert light.show(shine(1)) is None and timeline.state()["lit"]
        port = light.port
        light.close()
        assert eventually(lambda: not timeline.state()["lit"])
        again = ScreenLight(ScreenLightParams(kind="screen", port=port), GRIDS)
        try:
            assert eventually(lambda: again.has_page) and again.show(shine(2)) is None
        finally:
            again.close()
