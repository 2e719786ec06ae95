"""Cameras of one's own in an open rig: one that is triggered, one that never stops, one with another clock."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from luxloop.loop.rig.calibration.setups import rig_setup
from luxloop.loop.rig.camera import CameraPicture, check_picture
from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.params import RigParams
from luxloop.loop.rig.rig import Rig, await_camera, look, open_rig
from luxloop.perception.camera import CameraParams
from luxloop.world.errors import LuxloopError
from luxloop.world.validation import validate_model
from tests.refusal import refusal

GRID = (4, 4)
CAMERA = CameraParams(width_px=64, height_px=48, bits=8)
OWN = """
import threading
import time
import numpy as np
from luxloop.loop.rig.camera import CameraPicture

PICTURE = np.full((48, 64), 200, np.uint16)

class Triggered:
    def __init__(self):
        self.asked = threading.Event()
    def trigger(self):
        self.asked.set()
    def read(self, timeout_s):
        if not self.asked.wait(timeout_s):
            return None
        self.asked.clear()
        return CameraPicture(time.monotonic(), True, PICTURE.astype(np.uint8))
    def close(self):
        pass

class Ceaseless:
    def read(self, timeout_s):
        return CameraPicture(time.monotonic(), False, PICTURE.astype(np.uint8))
    def close(self):
        pass

class Deep:
    def read(self, timeout_s):
        time.sleep(0.01)
        return CameraPicture(time.monotonic(), True, 100 * PICTURE)
    def close(self):
        pass
"""


def params(folder: Path, name: str, **camera: object) -> RigParams:
    module = f"camera_{name.lower()}"  # Python knows each name once
    (folder / f"{module}.py").write_text(OWN)
    timing = {"latency_s": 0.02, "jitter_s": 0.01, "rolling_s": 0.006, "wait_s": 0.3}
    given = {"kind": f"{folder}/{module}:{name}", "timeout_s": 0.3, **camera}
    return validate_model(RigParams, {"light": {"kind": "files", "folder": str(folder)}, "camera": given, "timing": timing}, "")


@contextmanager
def rig_of(given: RigParams) -> Iterator[Rig]:
    with open_rig(given, (GRID,), CAMERA, armed=True) as rig:
        yield rig


def shine(number: int) -> Shine:
    return Shine(number, (np.full(GRID, 0.5, np.float32),))


def test_a_triggered_camera_gives_a_frame_an_exposure_also_after_a_pause(tmp_path):
    with rig_of(params(tmp_path, "Triggered", triggered=True)) as rig:
        assert await_camera(rig) and look(rig, 0.2)["rate_hz"] > 10
        for number in range(3):
            assert rig.expose(shine(number), 0.001)[1].image is not None
        time.sleep(0.5)  # a step that takes longer than the camera's timeout_s
        reasons = [rig.expose(shine(number), 0.001)[1].reason for number in range(3, 9)]
        assert reasons[-1] == "", reasons


def test_pictures_that_never_end_do_not_hold_an_exposure_up(tmp_path):
    given = params(tmp_path, "Ceaseless")
    patient = given.light.model_copy(update={"dark_after_s": 60.0})  # the keeper gets its turn late beside such a camera
    with rig_of(given.model_copy(update={"light": patient})) as rig:
        assert await_camera(rig)
        began_s = time.monotonic()
        _, taken = rig.expose(shine(0), 0.001)
        assert taken.image is None and "all pictures had lain in a queue" in taken.reason
        assert look(rig, 0.1)["late"] == 1
        assert time.monotonic() - began_s < 2


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (CameraPicture(time.time(), True, b"picture"), r"read gives the time .*; give time.monotonic\(\)"),
        (CameraPicture(float("nan"), True, b"picture"), "read gives the time nan"),
        (CameraPicture(0.0, True, np.zeros((48, 64))), r"read gives a picture of float64 \[48, 64\]"),
        ("picture", "read gives a str; return a luxloop.CameraPicture"),
    ],
)
def test_what_is_no_picture_is_refused(given, words):
    with refusal(words):
        check_picture(given)


def test_numbers_beyond_those_of_the_camera_are_told_in_a_calibration(tmp_path):
    given = params(tmp_path, "Deep", bits=12)

    def ready(rig: Rig) -> None:
        assert await_camera(rig)

    with (
        pytest.raises(LuxloopError, match=r"camera.bits: a picture has the number 20000, more than the largest, 4095"),
        rig_setup(tmp_path / "rig.toml", given, (GRID,), ready) as setup,
    ):
        setup.frames([np.ones(16)], 1, 1.0)
