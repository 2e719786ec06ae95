"""Each pixel looks where its lens lets it look, and light is spread but not lost."""

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.simulated.faults import LensParams
from luxloop.loop.rig.simulated.lens import Lens, distort, undistort
from luxloop.perception.camera import CameraParams
from tests.refusal import refusal

CAMERA = CameraParams(width_px=160, height_px=120, hfov_deg=60)
BARREL = LensParams(coefficients=(-0.25, 0.06, 0.002, -0.001, 0.01), centre_px=(3.2, -1.7))
FISHEYE = LensParams(model="fisheye", coefficients=(-0.02, 0.004))
DIVISION = LensParams(model="division", coefficients=(-0.3,))
PLACES = np.random.default_rng(0).uniform(-0.55, 0.55, (500, 2))


def test_models_are_those_of_opencv():
    k = np.array([*FISHEYE.coefficients, 0, 0])
    assert abs(cv2.fisheye.distortPoints(PLACES[:, None], np.eye(3), k)[:, 0] - distort(FISHEYE, PLACES)).max() < 1e-9
    radius = np.hypot(*PLACES.T)[:, None]
    assert abs(undistort(DIVISION, PLACES, 1.0) - PLACES / (1 - 0.3 * radius**2)).max() < 1e-12


@pytest.mark.parametrize("params", [BARREL, FISHEYE, DIVISION], ids=["opencv", "fisheye", "division"])
def test_a_pixel_looks_where_opencv_says(params):
    """Of a picture whose brightness is a place, which linear interpolation reproduces."""
    lens = Lens.of(params, CAMERA)
    focal = CAMERA.focal_px
    assert lens.camera.focal_px == pytest.approx(focal, rel=1e-12)
    wide = [(np.arange(n) + 0.5 - n / 2) / focal for n in (lens.camera.width_px, lens.camera.height_px)]
    x, y = np.meshgrid(*wide)
    seen = np.stack([lens.image(each.astype(np.float32)) for each in (x, y)], -1).reshape(-1, 2).astype(float)
    u, v = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    back = distort(params, seen) @ lens.matrix[:2, :2].T + lens.matrix[:2, 2]
    assert abs(back - np.stack([u.ravel(), v.ravel()], 1)).max() < 0.02  # px: single precision, and OpenCV's 32 steps a pixel


def test_light_is_spread_and_not_lost():
    point = np.zeros((120, 160), np.float32)
    point[60, 80] = 1000
    seen = Lens.of(LensParams(blur_px=1.5, veil=0.2, veil_px=15), CAMERA).image(point)
    assert seen.sum() == pytest.approx(1000, rel=2e-2)  # the veil is made eight times coarser
    assert seen[50:71, 70:91].sum() == pytest.approx(800, rel=0.08)
    assert seen[60, 80] == pytest.approx(800 / (2 * np.pi * 1.5**2), rel=0.08)
    flat = Lens.of(LensParams(blur_px=1.5, veil=0.2, veil_px=15, vignetting=0.4), CAMERA).image(np.ones((120, 160), np.float32))
    assert flat[60, 80] == pytest.approx(1, abs=1e-3) and flat[0, 0] == pytest.approx(0.6, abs=1e-3)


def test_colours_part_towards_the_border():
    lens = Lens.of(LensParams(chromatic_percent=1), CAMERA)
    lines = np.zeros((lens.camera.height_px, lens.camera.width_px), np.float32)
    column = lens.camera.width_px // 2 + 60
    lines[:, column] = 1
    row = lens.image(lines)[60]
    found = np.flatnonzero(row > 0.05) - (column - (lens.camera.width_px - 160) // 2)
    assert found.min() < 0 < found.max(), "blue to the middle, red away from it"


def test_a_lens_that_folds_the_picture_is_refused():
    with refusal(r"lens.coefficients: \[-3.0\] fold the picture of the model opencv; give weaker"):
        Lens.of(LensParams(coefficients=(-3.0,)), CAMERA)
    with refusal(r"more than 3 times the camera's 160 x 120"):
        Lens.of(LensParams(model="division", coefficients=(-1.8,)), CAMERA)
