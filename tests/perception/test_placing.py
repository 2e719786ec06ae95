"""Boxes on the road look from the camera as the boxes in the image that they were made from."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.testing import assert_close

from luxloop.perception.boxes import FARTHEST_M, LENGTH_M, place_boxes
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.world.frames import transform

VIEW = camera_view(CameraParams(width_px=640, height_px=360, pitch_deg=1.5, yaw_deg=3.0))


def near_side(T: torch.Tensor, size: torch.Tensor) -> torch.Tensor:
    """Middles `[3, 4]` m of the foot, the top, the left and the right edge of the side that looks at the camera."""
    length, width, height = size.tolist()
    edges = [[0.0, 0.0], [0.0, height], [width / 2, height / 2], [-width / 2, height / 2]]
    return transform(T, torch.tensor([[-length / 2, y, z] for y, z in edges], dtype=torch.float64).T)


@given(st.floats(6, 80), st.floats(-0.2, 0.2), st.floats(0.3, 2.5), st.floats(0.5, 2.2))
def test_what_stands_on_the_road_comes_back(x: float, share: float, width: float, height: float) -> None:
    """A plate that is turned to the camera: foot, height and width are its own."""
    origin = VIEW.origin
    foot = torch.tensor([x, share * x, 0.0], dtype=torch.float64)
    ahead = torch.nn.functional.normalize(foot[:2] - origin[:2], dim=0)
    aside = torch.tensor([-ahead[1], ahead[0], 0.0], dtype=torch.float64)
    up = torch.tensor([0.0, 0.0, height], dtype=torch.float64)
    (u, v), _ = VIEW.project(torch.stack([foot, foot + up, foot + aside * width / 2, foot - aside * width / 2], -1))
    found = place_boxes(torch.tensor([[u[0] - (u[3] - u[2]) / 2, v[1], u[0] + (u[3] - u[2]) / 2, v[0]]]), ("pedestrian",), VIEW)
    length = LENGTH_M["pedestrian"]
    assert_close(near_side(found.T_world_box[0], found.size_m[0])[:, 0], foot, rtol=1e-5, atol=1e-5)
    assert found.size_m[0, 0] == length
    # Beside the middle of the image, where 12 deg away a pixel is 1 / cos^2 wide and top and foot are not above each other, 2 %
    assert float(found.size_m[0, 1]) == pytest.approx(width, rel=0.05)
    assert float(found.size_m[0, 2]) == pytest.approx(height, rel=0.05)


def test_what_reaches_above_the_horizon_is_far_away() -> None:
    found = place_boxes(torch.tensor([[300.0, 20.0, 340.0, 60.0]]), ("car",), VIEW)
    away = (found.T_world_box[0, :2, 3] - VIEW.origin[:2]).norm()
    assert float(away) == pytest.approx(FARTHEST_M + LENGTH_M["car"] / 2, rel=0.01)  # which is a depth, not a distance


def test_boxes_stand_upright_and_look_at_the_camera() -> None:
    found = place_boxes(torch.tensor([[100.0, 100.0, 140.0, 250.0], [500.0, 150.0, 600.0, 300.0]]), ("car", "sign"), VIEW)
    R = found.T_world_box[:, :3, :3]
    assert_close(R @ R.transpose(1, 2), torch.eye(3).double().expand(2, 3, 3))
    assert_close(R[:, :, 2], torch.tensor([0.0, 0, 1]).double().expand(2, 3))
    to_box = torch.nn.functional.normalize(found.T_world_box[:, :2, 3] - VIEW.origin[:2], dim=-1)
    assert_close(R[:, :2, 0], to_box)
    assert found.T_world_box[:, 2, 3].tolist() == [0.0, 0.0]
    assert place_boxes(torch.zeros(0, 4), (), VIEW).T_world_box.shape == (0, 4, 4)
    low = camera_view(CameraParams(width_px=640, height_px=360, z_m=0.0))
    assert bool(place_boxes(torch.tensor([[300.0, 100.0, 340.0, 300.0]]), ("car",), low).T_world_box.isfinite().all())
