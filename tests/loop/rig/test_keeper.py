"""What keeps the lamp alive darkens it also where a device fails, and tells whoever takes a frame of every gap."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest

from luxloop.loop.rig import keeper
from luxloop.loop.rig.keeper import Keeper
from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.params import LightParams
from tests.loop.rig.conftest import eventually

SHINE = Shine(0, (np.ones((1, 1), np.float32),))


class Lamp:
    """What was asked of a lamp whose code fails or hangs."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.fails: set[str] = set()
        self.hangs, self.goes_on = False, threading.Event()

    def _do(self, what: str) -> None:
        self.asked.append(what)
        if what in self.fails:
            raise RuntimeError(f"no {what}")

    def show(self, shine: Shine) -> str | None:
        if self.hangs:
            self.goes_on.wait(10)
        self._do("show")
        return None

    def dark(self) -> None:
        self._do("dark")

    def close(self) -> None:
        self._do("close")


@pytest.fixture
def kept() -> Iterator[Callable[..., tuple[Lamp, Keeper]]]:
    """Lamps with their keepers, lit."""
    started: list[Keeper] = []

    def start(**keys: float) -> tuple[Lamp, Keeper]:
        lamp = Lamp()
        started.append(Keeper(lamp, LightParams().model_copy(update=keys), 60.0, lambda: None))  # not validated: one sends too seldom
        assert started[-1].show(SHINE) is None
        return lamp, started[-1]

    yield start
    for each in started:
        each.close()


def test_a_lamp_whose_code_fails_is_darkened_until_that_is_done(kept):
    lamp, keeper = kept(keep_alive_s=0.01)
    lamp.fails = {"show", "dark"}
    assert eventually(lambda: lamp.asked.count("dark") > 2, 2)
    assert keeper.since_s is None and keeper.reason == "no dark" and keeper.darkened == 0
    lamp.fails = {"show"}
    assert eventually(lambda: keeper.darkened == 1, 2)
    count = len(lamp.asked)
    time.sleep(0.05)
    assert lamp.asked[-1] == "dark" and len(lamp.asked) == count, "in the dark it is left alone"
    lamp.fails = set()
    assert keeper.show(SHINE) is None and keeper.since_s is not None


def test_only_a_loop_and_a_camera_that_are_alive_keep_the_lamp_lit():
    fault: list[str] = []
    for dead in ("loop", "camera"):
        lamp = Lamp()
        with closing(Keeper(lamp, LightParams(keep_alive_s=0.01), 0.3, lambda: fault[0] if fault else None)) as keeper:
            assert keeper.show(SHINE) is None
            for _ in range(20):
                time.sleep(0.02)
                keeper.beat()
            assert "dark" not in lamp.asked and lamp.asked.count("show") > 5, "sent again and again while both are alive"
            silent_s = time.monotonic()
            if dead == "camera":
                fault.append("camera: no picture")
            assert eventually(lambda: "dark" in lamp.asked, 2)  # noqa: B023
            assert time.monotonic() - silent_s > 0.2 or dead == "camera"
            assert keeper.darkened == 1 and keeper.since_s is None
            assert keeper.reason == ("camera: no picture" if fault else "the loop has said nothing for 0.3 s")


def test_a_gap_is_told_before_the_thread_has_seen_it(kept):
    _, keeper = kept(keep_alive_s=5.0, dark_after_s=0.5)
    assert keeper.since_s is not None
    time.sleep(0.5)
    assert keeper.since_s is None and "the lamp may have been dark" in keeper.reason and keeper.interruptions == 1
    assert keeper.since_s is None and keeper.interruptions == 1


def test_a_lamp_that_hangs_is_told_to_go_dark_at_the_end(kept, monkeypatch):
    monkeypatch.setattr(keeper, "CLOSE_S", 0.1)
    lamp, kept_alive = kept(keep_alive_s=0.01)
    lamp.hangs = True
    time.sleep(0.05)
    began_s = time.monotonic()
    kept_alive.close()
    assert time.monotonic() - began_s < 1 and lamp.asked[-2:] == ["dark", "close"]
    lamp.hangs = False
    lamp.goes_on.set()


def test_a_lamp_that_does_not_go_dark_is_left_all_the_same(kept):
    lamp, keeper = kept()
    lamp.fails = {"dark"}
    with pytest.raises(RuntimeError, match="no dark"):
        keeper.close()
    assert lamp.asked[-1] == "close"
    lamp.fails = set()
