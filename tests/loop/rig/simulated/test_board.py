"""Somebody shows a board to the rig process' camera, and reads a luxmeter."""

import numpy as np
import pytest
import torch

from luxloop.loop.rig.calibration.intrinsics import corners
from luxloop.loop.rig.simulated.board import LAID_S, BoardView, board_pose, readings
from luxloop.loop.rig.simulated.faults import BoardFaultParams
from luxloop.loop.rig.simulated.scene import RigScene
from tests.loop.rig.simulated.conftest import faults_of, scenario_of

BOARD = BoardFaultParams(shown=True, columns=5, rows=7, square_mm=50)


@pytest.fixture(scope="module")
def lit() -> RigScene:
    return RigScene(scenario_of("camera.width_px=480", "camera.height_px=360"), faults_of())


def test_its_corners_are_where_it_is_held(lit):
    shown = BoardView.of(BOARD, lit)
    camera, found = lit.lens.camera, 0
    for pose in range(0, 20, 4):
        seen = corners(shown.image(pose), shown.board)
        if isinstance(seen, str):
            continue
        found += 1
        points = np.concatenate([seen.board, np.zeros((len(seen.board), 1)), np.ones((len(seen.board), 1))], 1)
        x, y, z = (board_pose(shown.board, camera, pose) @ points.T)[:3]
        expected = camera.focal_px * np.stack([x / z, y / z], 1) + [camera.width_px / 2, camera.height_px / 2]
        assert np.median(np.hypot(*(seen.pixels - expected).T)) < 0.15  # some stray, in squares of a few pixels
    assert found >= 4


def test_it_is_taken_away_for_light(lit):
    shown = BoardView.of(BOARD, lit)
    in_hand, on_screen = shown.at(5.0, None), shown.at(20.0, 20.0 - LAID_S)
    assert in_hand is not None and on_screen is not None and not np.array_equal(in_hand, on_screen)
    assert shown.at(20.0, 19.9) is None


def test_a_luxmeter_shows_what_falls_on_the_road(lit):
    lux = lit.world.lit(0.0, direct=True).light([torch.ones(each.headlight.n_pixels) for each in lit.modules])[0].numpy()
    read = readings(lit)
    assert len(read) == 9
    values = [value for value, *_ in read]
    assert min(values) > 0
    assert max(values) <= 1.1 * lux.max()
