"""Webcams, by OpenCV and a V4L2 device that v4l2.c simulates: YUYV of 640 x 480 at 29.97 Hz and of 1280 x 720 at 10 Hz, MJPG of 1280 x 720
at 30 Hz.

As a program it opens a camera for each table of keys, and prints what the cameras give: `python test_webcam.py '[{"device": ...}, ...]'`.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.cameras import DeviceCamera
from luxloop.loop.rig.params import DeviceCameraParams
from luxloop.world.errors import LuxloopError

SLOT = 1280 * 720 * 2  # bytes of the device file for the picture of each mode
HD: dict[str, Any] = {"width_px": 1280, "height_px": 720}
CASES: list[tuple[dict[str, Any], list[int] | str]] = [  # keys; rows, columns and level of the pictures, or the key refused
    (HD | {"fourcc": "MJPG"}, [720, 1280, 200]),
    ({}, [480, 640, 0]),
    (HD | {"rate_hz": 10}, [720, 1280, 255]),
    (HD, "camera.rate_hz"),
    ({"width_px": 1920, "height_px": 1080}, "camera.width_px"),
    ({"fourcc": "H264"}, "camera.fourcc"),
    ({"exposure": 100.0}, "camera.exposure"),
    ({"gain": 1.0}, "camera.gain"),
]


def outcome(keys: dict[str, Any]) -> list[list[int]] | str:
    """Rows, columns and mean level of two pictures, or why there are none."""
    try:
        camera = DeviceCamera(DeviceCameraParams(kind="device", **keys))
    except LuxloopError as error:
        return str(error)
    pictures = [picture.data for picture in (camera.read(1.0), camera.read(1.0)) if picture is not None]
    camera.close()
    return [[*data.shape[:2], round(data.mean())] for data in pictures if isinstance(data, np.ndarray)]


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> list[list[list[int]] | str]:
    """The outcome of each case; LD_PRELOAD needs a process of its own, and one for all saves the imports."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler `cc` for the simulated V4L2 device")
    folder = tmp_path_factory.mktemp("webcam")
    library, device = folder / "v4l2.so", folder / "video0"
    subprocess.run([compiler, "-shared", "-fPIC", Path(__file__).with_name("v4l2.c"), "-o", library], check=True)
    jpeg = cv2.imencode(".jpg", np.full((720, 1280), 200, np.uint8))[1].tobytes()
    yuyv = bytes([16, 128]) * (640 * 480), bytes([235, 128]) * (1280 * 720)  # 16 is black, 235 is white
    device.write_bytes(b"".join(picture.ljust(SLOT, b"\0") for picture in (*yuyv, jpeg)))
    tables = json.dumps([{"device": str(device), **keys} for keys, _ in CASES])
    environment = {**os.environ, "LD_PRELOAD": str(library)}
    done = subprocess.run([sys.executable, __file__, tables], env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("case", range(len(CASES)), ids=lambda case: str(CASES[case][0]))
def test_a_webcam_gives_what_is_asked_for_or_is_refused(outcomes, case):
    expected, found = CASES[case][1], outcomes[case]
    if isinstance(expected, str):
        assert isinstance(found, str) and found.startswith(f"{expected}: ")
    else:
        assert found == [expected, expected]


if __name__ == "__main__":
    print(json.dumps([outcome(keys) for keys in json.loads(sys.argv[1])]))
