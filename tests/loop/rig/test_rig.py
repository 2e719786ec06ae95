"""An open rig shows light and gets frames of it, each of its own exposure or none; when something stops, it is dark."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from luxloop.loop.rig.blink import evaluate, record
from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.rig import Rig, RigFrame, await_camera, open_rig
from luxloop.perception.camera import CameraParams
from tests.loop.rig.conftest import DDP, Process, eventually, free_port
from tests.refusal import refusal

GRID = (12, 16)
PATIENT_S = 0.5  # time-out of a lamp that stays lit also where a busy machine lets the keeper come late
CAMERA = CameraParams(width_px=64, height_px=48, bits=8)


def shine(number: int, share: float | None = None) -> Shine:
    """Even numbers are lit, odd ones are half as bright."""
    share = (0.8 if number % 2 == 0 else 0.4) if share is None else share
    return Shine(number, (np.full(GRID, share, np.float32),))


@contextmanager
def rig_of(process: Process, **tables: object) -> Iterator[Rig]:
    with open_rig(process.params(**tables), (GRID,), CAMERA, armed=True) as rig:
        assert await_camera(rig)
        yield rig


def frame_of(rig: Rig, number: int, share: float | None = None) -> RigFrame:
    """Show light at least for a moment; its frame."""
    return rig.expose(shine(number, share), 0.001)[1]


def said(image: np.ndarray) -> set[int]:
    """Time codes plus 1 that a picture says it shows, 0 for the dark."""
    return set(np.frombuffer(image[0, :8].astype(np.uint8).tobytes(), "<u4").tolist())


def camera_sees(rig: Rig, level: float) -> bool:
    picture = rig.camera.next(time.monotonic() + 0.2)
    return picture is not None and rig.rectify is not None and abs(float(rig.rectify(picture.data)[10:].mean()) - level) < 2


@pytest.fixture(scope="module")
def steady() -> Iterator[Process]:
    """A rig that goes on."""
    with Process(192, dark_s=PATIENT_S) as process:
        yield process


def test_each_frame_shows_its_own_exposure_alone(steady):
    with rig_of(steady) as rig:
        for number in range(20):
            given, taken = rig.expose(shine(number), 0.001)
            assert given.whole and taken.image is not None, taken.reason
            assert said(taken.image) == {number + 1}
            assert taken.sent_s < taken.arrived_s <= time.monotonic()
        assert rig.statistics.lateness.quantile_s(0.5) < 0.07  # latency, jitter and two periods of the camera
        time.sleep(0.5)
        assert rig.camera.dropped > 5, "pictures that nobody reads are dropped"
        taken = frame_of(rig, 20)
        assert taken.image is not None and said(taken.image) == {21}


def test_a_loop_that_says_nothing_leaves_the_lamp_dark_and_light_comes_back_slowly(steady, small_rig):
    with rig_of(small_rig(dark_s=PATIENT_S), limits={"loop_s": 0.2}) as rig:
        frame_of(rig, 0)
        assert eventually(lambda: rig.keeper.darkened == 1, 2)
        assert eventually(lambda: camera_sees(rig, 20), 1.0)  # of a picture in the dark
        taken = frame_of(rig, 1)
        assert taken.image is not None and said(taken.image) == {3}  # lit again; the darkness between had a time code of its own
    with rig_of(steady, limits={"loop_s": 0.2, "change_per_s": 0.5}) as rig:
        frame_of(rig, 0, 0.8)
        assert eventually(lambda: rig.keeper.darkened == 1, 2)
        given, _ = rig.expose(shine(1, 0.8), 0.001)
        assert given.slowed < 0.5 and given.shine.share < 0.4


def test_power_and_change_are_limited_and_told(steady):
    with rig_of(steady, limits={"power": 0.5, "change_per_s": 4.0}) as rig:
        rig.expose(shine(0, 0.0), 0.2)
        given, _ = rig.expose(shine(1, 1.0), 0.001)
        assert given.dimmed == 0.5
        time.sleep(0.2)
        given, taken = rig.expose(shine(2, 0.5), 0.001)
        assert given.whole and taken.image is not None
        given, _ = rig.expose(shine(3, 0.0), 0.001)
        assert 0 < given.slowed < 1 and 0.1 < given.shine.share < 0.5


def test_a_dry_run_lights_nothing(steady):
    with open_rig(steady.params(), (GRID,), CAMERA, armed=False) as rig:
        assert await_camera(rig)
        taken = frame_of(rig, 0)
        assert taken.image is not None and said(taken.image) == {0}


def test_with_jitter_and_lost_packets_a_frame_is_right_or_lost(small_rig):
    process = small_rig(20_000, jitter_s=0.02, loss=0.01)  # 14 packets a frame, of which one is lost in every seventh
    timing = {"latency_s": 0.02, "jitter_s": 0.03, "rolling_s": 0.03, "wait_s": 0.6}
    light = {**DDP, "port": process.light, "repeats": 4}
    with open_rig(process.params(timing=timing, light=light), ((100, 200),), CAMERA, armed=True) as rig:
        assert await_camera(rig)
        came = 0
        for number in range(40):
            pictures = (np.full((100, 200), 0.8 if number % 2 else 0.3, np.float32),)
            _, taken = rig.expose(Shine(number, pictures), 0.001)
            came += taken.image is not None
            assert taken.image is None or said(taken.image) == {number + 1}
        assert came > 30


def test_a_camera_that_stops_darkens_the_lamp_and_comes_back(small_rig):
    with rig_of(small_rig(dark_s=PATIENT_S, mute_after_s=1.5, mute_for_s=1.2)) as rig:
        reasons, number, until_s = [], 0, time.monotonic() + 4.5
        while time.monotonic() < until_s:
            before = rig.keeper.darkened
            taken = frame_of(rig, number)
            reasons.append(taken.reason)
            allowed = [{number + 1 + darkened} for darkened in (before, rig.keeper.darkened)]  # which it may be just after the frame
            assert taken.image is None or said(taken.image) in allowed
            number += 1
        assert rig.keeper.darkened == 1 and any("no picture" in each for each in reasons)
        assert reasons[-1] == "" == reasons[0]


def test_a_rig_that_is_killed_and_started_again(small_rig):
    process = small_rig(dark_s=PATIENT_S)
    with rig_of(process) as rig:
        assert frame_of(rig, 0).image is not None
        process.kill()
        taken = frame_of(rig, 1)
        assert taken.image is None and ("camera" in taken.reason or "nobody listens" in taken.reason)
        process.start()
        assert eventually(lambda: rig.camera.alive, 5)
        for number in range(2, 8):
            taken = frame_of(rig, number)
        assert taken.image is not None and max(said(taken.image)) == min(said(taken.image)) > 0


class Relay:
    """Passes datagrams on until it is cut."""

    def __init__(self, to: int) -> None:
        self.port, self.cut = free_port(socket.SOCK_DGRAM), False
        self._in, self._out = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._in.bind(("127.0.0.1", self.port))
        self._out.connect(("127.0.0.1", to))
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while packet := self._in.recv(2000):
            if not self.cut:
                self._out.send(packet)


def test_a_network_that_is_cut_leaves_the_lamp_dark_and_comes_back(small_rig):
    process = small_rig()
    relay = Relay(process.light)
    with rig_of(process, light={**DDP, "port": relay.port}) as rig:
        assert frame_of(rig, 0).image is not None
        relay.cut = True
        assert eventually(lambda: camera_sees(rig, 20), 0.25)
        taken = frame_of(rig, 1)
        assert taken.image is None or said(taken.image) == {0}  # in the dark no symbol is seen, and none is measured
        relay.cut = False
        taken = frame_of(rig, 2)
        assert taken.image is not None and said(taken.image) == {3}


def test_pictures_that_do_not_fit_do_not_keep_the_lamp_lit(small_rig):
    process = small_rig(dark_s=60.0)
    with rig_of(process) as rig:
        assert frame_of(rig, 0).image is not None
        process.kill()
        process.start(width=80)
        with refusal(r"set camera\.width_px and camera\.height_px of the scenario"):
            eventually(rig.refuse_misfit, 5)  # as `luxloop run` does before it lights anything; pictures of before may still wait
        assert eventually(lambda: "80 x 48 px" in frame_of(rig, 1).reason and rig.keeper.dark_since_s is not None, 5)
        process.kill()
        process.start()
        assert eventually(lambda: frame_of(rig, 2).image is not None, 5)


def test_at_the_end_the_lamp_is_dark_at_once(small_rig):
    process = small_rig(dark_s=60.0)  # so that it does not darken by itself
    with pytest.raises(KeyboardInterrupt), rig_of(process) as rig:
        frame_of(rig, 0)
        raise KeyboardInterrupt
    with open_rig(process.params(), (GRID,), CAMERA, armed=False) as rig:
        assert await_camera(rig) and eventually(lambda: camera_sees(rig, 20), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("keys", [{"latency_s": 0.01}, {"latency_s": 0.04, "light_s": 0.02, "exposure_s": 0.015}])
def test_blinks_find_latency_and_exposure(small_rig, keys):
    process = small_rig(dark_s=PATIENT_S, **keys)
    with open_rig(process.params(), (GRID,), None, armed=True) as rig:
        assert await_camera(rig)
        found = evaluate(record(rig, (GRID,), 24, 1.0), 24)
    exposure_s = keys.get("exposure_s", 0.005)
    true_s = keys.get("light_s", 0.0) + exposure_s + keys["latency_s"]
    assert abs(found.latency_s - true_s) < 0.004  # a quarter of the camera's period: 24 blinks meet its phases every 0.8 ms
    assert abs(found.rolling_s - exposure_s) < 0.004
    assert found.jitter_s < 0.02 and abs(found.interval_s[0] - 0.02) < 0.002
