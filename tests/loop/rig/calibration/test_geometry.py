"""Camera, screen and lamp are found from what is seen; a calibration's file holds them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from luxloop.loop.rig.calibration.calibrate import Calibration, load, save
from luxloop.loop.rig.calibration.geometry import ISO, CameraModel, Geometry, Observation, Pose, adjust, candela_factor, on_plane
from luxloop.loop.rig.calibration.shots import linear_response
from tests.refusal import refusal

CAMERA = CameraModel(640, 480, np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]]), np.array([-0.1, 0.02, 0, 0, 0]))
LAMP = Pose(Pose.of(np.block([[ISO, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])).turn, np.array([0.3, 0.2, 0.1]))
BOARD = np.stack(np.meshgrid(np.arange(7) * 0.03, np.arange(9) * 0.03), -1).reshape(-1, 2)


def screen(distance_m: float, tilt: float = 0.05) -> Pose:
    return Pose(np.array([0.0, np.pi + tilt, 0.0]), np.array([0.1, 0.0, distance_m]))


def seen(at: Pose, noise: float, board: bool = True) -> Observation:
    """A lamp of 21 x 31 pixels and a board on a screen."""
    rng = np.random.default_rng(0)
    tangents = np.stack(np.meshgrid(np.linspace(0.12, -0.12, 31), np.linspace(0.05, -0.08, 21)), -1).reshape(-1, 2)
    rays = np.concatenate([np.ones((len(tangents), 1)), tangents], 1) @ LAMP.rotation.T
    pixels = CAMERA.project(on_plane(rays, LAMP.place, at))
    corners = CAMERA.project(at.points(np.concatenate([BOARD, np.zeros((len(BOARD), 1))], 1)))
    found = Observation(tangents, pixels + rng.normal(0, noise, pixels.shape))
    return replace(found, board=BOARD, corners=corners + rng.normal(0, noise, corners.shape)) if board else found


def off(pose: Pose) -> Pose:
    return Pose(pose.turn + 0.02, pose.place + 0.1)


def test_lamp_and_screen_are_found_within_their_uncertainty():
    at = screen(5.0)
    found = adjust(CAMERA, off(at), off(LAMP), seen(at, 0.03))
    for pose, true, std in ((found.lamp, LAMP, found.std["lamp"]), (found.screen, at, found.std["screen"])):
        left = np.concatenate([pose.turn - true.turn, pose.place - true.place])
        # Five standard deviations of twelve numbers.
        assert (np.abs(left) < 5 * std + 1e-9).all()
    assert found.rms["lamp"] == pytest.approx(0.03 * np.sqrt(2), rel=0.15)
    assert found.rms["board"] < 0.06


@pytest.mark.parametrize("wrong", ["data sheet", "screen", "focal length"])
def test_uncertainty_covers_what_is_assumed(wrong):
    at, camera = screen(5.0), CAMERA
    given = seen(at, 0.003, board=wrong == "data sheet")
    assumed = off(at) if wrong == "data sheet" else at
    if wrong == "data sheet":
        given = replace(given, tangents=given.tangents * (1 + given.tangents**2))  # as of a lens with 1.4 % distortion
    elif wrong == "screen":
        assumed = Pose(at.turn, at.place + np.array([0.0, 0.0, 0.005]))
    else:
        camera = CAMERA.with_values(CAMERA.values * ([1.01, 1.01] + 7 * [1]))
    found = adjust(camera, assumed, off(LAMP), given)
    left = np.concatenate([found.lamp.turn - LAMP.turn, found.lamp.place - LAMP.place])
    # Noise moves them by 2e-6 rad and 1e-4 m at most, what is wrong by 1 to 100 times that.
    assert (np.abs(left) < 4 * found.std["lamp"]).all()
    assert found.std["lamp"].max() < 0.2


def test_intensity_follows_from_luminance():
    geometry = Geometry(CAMERA, screen(5.0, 0.0), LAMP)
    factor = candela_factor(geometry, (480, 640), lambda cos: np.full_like(cos, 0.5))
    point = geometry.on_screen(np.array(320.5), np.array(240.5))
    away = LAMP.place - point
    distance = np.linalg.norm(away)
    assert factor[240, 320] == pytest.approx(np.pi * distance**2 / (0.5 * abs(away[2]) / distance), rel=1e-6)
    behind = replace(geometry, lamp=Pose(LAMP.turn, np.array([0.0, 0.0, 7.0])))
    with refusal("different sides"):
        candela_factor(behind, (480, 640), lambda cos: cos)


def calibration() -> Calibration:
    camera = replace(CAMERA, covariance=np.eye(9))
    return Calibration(camera, linear_response(255, 4), np.array([-0.1, 0, 0]), screen(5.0), {"left hires": LAMP}, {"boards": 0.03})


def test_file_holds_a_calibration(tmp_path):
    save(tmp_path / "rig.npz", calibration())
    found = load(tmp_path / "rig.npz")
    assert_allclose(found.camera.values, CAMERA.values)
    assert_allclose(found.modules["left hires"].matrix, LAMP.matrix, atol=1e-12)
    assert_allclose(found.response, linear_response(255, 4))
    assert found.rms == {"boards": 0.03}
    with refusal("left hires, not 'left lores'"):
        found.geometry("left lores")
    with np.load(tmp_path / "rig.npz") as arrays:  # as a rig reads its lens
        assert_allclose(arrays["camera_matrix"][:2, 2], [319.5, 239.5])
        assert arrays["response"].shape == (256,) and arrays["response"].min() >= 0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("camera_matrix", np.zeros((3, 3))),
        ("T_camera_screen", np.zeros((4, 4))),
        ("size_px", np.array([0, 5])),
        ("header", np.frombuffer(b"{}", np.uint8)),
    ],
)
def test_damaged_files_are_told_in_a_sentence(tmp_path, name, value):
    save(tmp_path / "rig.npz", calibration())
    with np.load(tmp_path / "rig.npz") as arrays:
        np.savez(tmp_path / "bad.npz", **{**arrays, name: value})
    with refusal(r"bad\.npz: .*luxloop rig calibrate"):
        load(tmp_path / "bad.npz")
