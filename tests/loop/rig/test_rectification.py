"""From a camera's picture to the scenario's image, and pictures that are none."""

import io
import zipfile

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.cameras import StreamCamera
from luxloop.loop.rig.params import (
    StreamCameraParams,
    load_rig,
)
from luxloop.loop.rig.rectification import WrongPicture, grey, rectifier
from luxloop.perception.camera import CameraParams
from tests.loop.rig.conftest import WHOLE
from tests.refusal import refusal


def test_pictures_are_cut_scaled_and_straightened(rig_file, tmp_path):
    camera = CameraParams(width_px=64, height_px=48, bits=12, hfov_deg=40.0)
    rig_file.write_text(WHOLE + "crop = { u_px = 3, v_px = 2, width_px = 64, height_px = 48 }\n")
    picture = np.random.default_rng(0).integers(0, 256, (60, 80), dtype=np.uint8)
    image = rectifier(load_rig(rig_file), camera)(cv2.imencode(".png", picture)[1].tobytes())
    assert np.array_equal(image, np.rint(picture[2:50, 3:67] / 255 * 4095))

    focal_px = 32 / np.tan(np.deg2rad(20))
    bent = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])
    matrix = np.array([[2 * focal_px, 0, 80.0], [0, 2 * focal_px, 60.0], [0, 0, 1]])
    response = (np.arange(256) / 255) ** 2.0  # a code is the root of the light
    np.savez(tmp_path / "rig.npz", size_px=[160, 120], camera_matrix=matrix, distortion=bent, response=response)
    rig_file.write_text(WHOLE + '[calibration]\nfile = "rig.npz"\n')
    straight = rectifier(load_rig(rig_file), camera)
    at = np.array([[[0.2, -0.1, 1.0]]])  # a point ahead of the camera
    seen = cv2.projectPoints(at, np.zeros(3), np.zeros(3), matrix, bent)[0].ravel()
    v, u = np.indices((120, 160))
    spot = np.exp(-((u - seen[0]) ** 2 + (v - seen[1]) ** 2) / 18)
    image = straight(np.rint(255 * np.sqrt(spot)).astype(np.uint8))
    weight = np.where(image > 0.1 * image.max(), image, 0)
    rows, columns = np.indices(image.shape) + 0.5
    centre = (columns * weight).sum() / weight.sum(), (rows * weight).sum() / weight.sum()
    assert centre == pytest.approx((32 + focal_px * 0.2, 24 - focal_px * 0.1), abs=0.1)  # of a straight pinhole camera


def test_a_calibration_of_another_depth_or_beyond_all_memory_is_refused(rig_file, tmp_path):
    rig_file.write_text(WHOLE + '[calibration]\nfile = "rig.npz"\n')
    camera, matrix = CameraParams(width_px=64, height_px=48), np.array([[90.0, 0, 32], [0, 90, 24], [0, 0, 1]])
    good = {"size_px": [64, 48], "camera_matrix": matrix, "distortion": np.zeros(5)}
    np.savez(tmp_path / "rig.npz", **good, response=np.linspace(0, 1, 4096))
    with pytest.raises(WrongPicture, match="pictures of 8 bits, where the calibration's response has 4096 numbers"):
        rectifier(load_rig(rig_file), camera)(np.zeros((48, 64), np.uint8))
    huge = io.BytesIO()
    np.lib.format.write_array_header_1_0(huge, {"descr": "|u1", "fortran_order": False, "shape": (10**13,)})
    np.savez(tmp_path / "rig.npz", **good)
    with zipfile.ZipFile(tmp_path / "rig.npz", "a") as archive:
        archive.writestr("response.npy", huge.getvalue())
    with refusal("longer than its file"):
        rectifier(load_rig(rig_file), camera)


@pytest.mark.parametrize(("data", "words"), [(b"no picture", "damaged"), (np.zeros((10, 10), np.uint8), "10 x 10 px, where the scenario")])
def test_a_picture_that_is_none_is_refused(rig_file, data, words):
    with pytest.raises(WrongPicture, match=words):
        rectifier(load_rig(rig_file), CameraParams(width_px=64, height_px=48))(data)


@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_half_a_picture_is_refused(ending):
    whole = cv2.imencode(ending, np.random.default_rng(0).integers(0, 256, (48, 64), np.uint8))[1].tobytes()
    assert grey(whole).shape == (48, 64)
    for cut in (len(whole) // 2, len(whole) - 30):
        with pytest.raises(WrongPicture, match="damaged"):
            grey(whole[:cut])


def test_damaged_pictures_of_a_stream_are_left_out(tmp_path):
    noise = np.random.default_rng(0).integers(0, 20, (48, 64), np.uint8)
    pictures = [cv2.imencode(".jpg", noise + np.uint8(40 * k))[1].tobytes() for k in range(6)]
    pictures[2] = pictures[2][: len(pictures[2]) * 2 // 3]
    (tmp_path / "stream.mjpeg").write_bytes(b"".join(pictures))
    source = StreamCamera(StreamCameraParams(kind="stream", url=str(tmp_path / "stream.mjpeg"), options={}))
    found = [source.read(1.0) for _ in range(5)]
    levels = {int(np.mean(each.data)) // 40 for each in found if each is not None and isinstance(each.data, np.ndarray)}
    assert 2 not in levels and {0, 1, 3} <= levels
    source.close()
