"""The camera by itself: response, board, lens and vignetting."""

import cv2
import numpy as np
import pytest
from PIL import Image as Picture
from rig_bench import BROWN, views

from luxloop.loop.rig.calibration.geometry import CameraModel
from luxloop.loop.rig.calibration.intrinsics import BoardParams, Corners, brightness, corners, lens, picture, print_board, vignetting
from luxloop.loop.rig.calibration.shots import response_curve
from luxloop.loop.rig.simulated.faults import LensParams
from tests.refusal import refusal


@pytest.mark.parametrize(("gamma", "levels", "black"), [(1.0, 4095, 64.0), (2.2, 255, 3.0)])
def test_response_is_found_from_exposures(gamma, levels, black):
    rng = np.random.default_rng(0)
    scene = rng.uniform(0.02, 1.3, (60, 80))
    times = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)
    frames = []
    for time in times:
        code = black + (levels - black) * (scene * time).clip(0, 1) ** (1 / gamma)
        frames.append(np.mean([np.round((code + rng.normal(0, 0.004 * levels, code.shape)).clip(0, levels)) for _ in range(8)], 0))
    found = response_curve(frames, times, levels)
    light = np.linspace(0.05, 0.95, 50)
    code = np.round(black + (levels - black) * light ** (1 / gamma)).astype(int)
    share = found[code] / light
    # 2 %: the digital numbers of 8 bits alone are 1 % of the light there.
    assert np.abs(share / np.median(share) - 1).max() < 0.02
    assert (np.diff(found) > 0).all()


def test_too_short_a_series_is_told():
    frames = [np.full((20, 20), 100.0), np.full((20, 20), 200.0)]
    with refusal("at least three exposures"):
        response_curve(frames, (0.5, 1.0), 255)


def test_board_is_printed_at_its_size_and_read_again(tmp_path):
    board = BoardParams()
    print_board(tmp_path / "board.png", board, "a4")
    page = Picture.open(tmp_path / "board.png")
    dpi = page.info["dpi"][0]
    assert dpi == pytest.approx(300, rel=0.01) and page.width / dpi * 25.4 == pytest.approx(210, abs=0.1)
    found = corners(np.asarray(page.convert("L")), board)
    assert isinstance(found, Corners) and len(found.board) == 70
    per_m = np.linalg.norm(np.ptp(found.pixels, axis=0)) / np.linalg.norm(np.ptp(found.board, axis=0))
    assert per_m * 0.0254 == pytest.approx(dpi, rel=5e-4)
    print_board(tmp_path / "board.pdf", board, "a4")
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")


def test_corners_are_sharp_in_a_tilted_view():
    board = BoardParams()
    drawn = picture(board, 150)
    high, wide = drawn.shape
    aim = np.float32([[300, 80], [980, 160], [900, 650], [260, 600]])
    H = cv2.getPerspectiveTransform(np.float32([[0, 0], [wide, 0], [wide, high], [0, high]]), aim)
    fine = cv2.warpPerspective(drawn, np.diag([4.0, 4, 1]) @ H, (4 * 1280, 4 * 720), flags=cv2.INTER_AREA, borderValue=255)
    seen = cv2.resize(fine, (1280, 720), interpolation=cv2.INTER_AREA)
    found = corners(seen.astype(np.uint16) * 257, board)
    assert isinstance(found, Corners) and len(found.board) == 70
    per_m = wide / (board.columns * board.square_mm / 1000)
    # OpenCV warps from pixel centre to pixel centre; the mean of four pixels lies 1.5 of them further.
    true = cv2.perspectiveTransform((found.board * per_m - 0.5)[None], H)[0] - 1.5 / 4 + 0.5
    assert np.sqrt(((found.pixels - true) ** 2).sum(1).mean()) < 0.1


def test_too_large_a_board_and_another_format_are_refused(tmp_path):
    with refusal("a3"):
        print_board(tmp_path / "board.pdf", BoardParams(square_mm=40), "a4")
    with refusal(r"\.pdf or a \.png"):
        print_board(tmp_path / "board.svg", BoardParams(), "a4")


def test_lens_is_found_within_its_uncertainty():
    camera = CameraModel(640, 480, np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]]))
    scale = (900 / 320) ** 2
    params = LensParams(model="opencv", coefficients=tuple(each * scale**k for k, each in enumerate(BROWN, 1)))
    found, rms = lens(views(camera, params, np.random.default_rng(3)), 640, 480)
    std = np.sqrt(np.diag(found.covariance))[:4]
    # Four standard deviations; the noise of the corners is all that differs.
    assert (np.abs(found.values[:4] - camera.values[:4]) < 4 * std).all()
    assert 0.02 < rms < 0.06
    u, v = np.random.default_rng(0).uniform(20, 460, (2, 100))
    np.testing.assert_allclose(found.project(found.rays(u, v)), np.stack([u, v], 1), atol=1e-4)


def test_vignetting_is_found():
    true = np.array([-0.3, 0.05, -0.02])
    shade = brightness(true, 120, 160)
    flat = 0.7 * shade + 0.002 * np.random.default_rng(0).standard_normal(shade.shape)
    found, left = vignetting([flat, 0.5 * flat])
    np.testing.assert_allclose(brightness(found, 120, 160), shade, atol=0.003)
    assert left < 0.01
