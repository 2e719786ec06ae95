"""The rectified view: what lies on z = 0 gets its place and size in metres."""

import numpy as np
import pytest
import torch
from torch import Tensor

from perception.appearance import appearance
from perception.birdseye import Region, birds_eye, rectify, region_around
from perception.camera import CameraParams, camera_view
from world.flatroad import flat_road
from world.view import View

VIEW = camera_view(CameraParams())
REGION = region_around(17.0, 0.0, 4.0, 2.0)


def painted(x: tuple[float, float], y: tuple[float, float], view: View = VIEW, samples: int = 4) -> Tensor:
    """Camera image `[height, width]` of a white rectangle on z = 0, samples to a pixel's height."""
    fine = View(view.width, view.height * samples, view.fx, view.fy * samples, view.cx, view.cy * samples, view.T_world_view)
    px, py, _ = flat_road(fine, 1.0).position
    inside = (px > x[0]) & (px < x[1]) & (py > y[0]) & (py < y[1])
    return inside.float().view(view.height, samples, view.width).mean(1)


def test_cells_look_where_their_point_projects() -> None:
    """An image of its own coordinates is linear, so bilinear sampling gives them back: the half pixels are right."""
    plane = birds_eye(REGION, VIEW, torch.float64)
    u = (torch.arange(VIEW.width, dtype=torch.float64) + 0.5).expand(VIEW.height, -1)
    v = (torch.arange(VIEW.height, dtype=torch.float64) + 0.5)[:, None].expand(-1, VIEW.width)
    sampled = rectify(plane, torch.stack([u, v]))
    rows, cols = sampled.shape[-2:]
    y, x = -plane.axes.u, -plane.axes.v
    ground = torch.stack([x[:, None].expand(rows, cols), y.expand(rows, cols), torch.zeros(rows, cols, dtype=torch.float64)])
    uv, _ = VIEW.project(ground.flatten(1))
    uv = uv.view(2, rows, cols)
    inside = ((uv > 1) & (uv < torch.tensor([VIEW.width, VIEW.height]).view(2, 1, 1) - 1)).all(0)
    assert inside.float().mean() > 0.5
    torch.testing.assert_close(sampled[:, inside], uv[:, inside], rtol=0, atol=1e-9)


def test_axes_run_like_the_image() -> None:
    plane = birds_eye(Region(10, 12, 1, -1, cell_m=0.5), VIEW)
    assert plane.axes.u.tolist() == [-0.75, -0.25, 0.25, 0.75]  # -y, to the right
    assert plane.axes.v.tolist() == [-11.75, -11.25, -10.75, -10.25]  # -x, towards the car
    assert plane.map_u.shape == (4, 4)


@pytest.mark.parametrize(("x", "y"), [((15, 19), (-1, 1)), ((12, 14), (0.5, 1.5)), ((20, 26), (-2, -0.5))])
def test_a_rectangle_keeps_its_place_and_size(x: tuple[float, float], y: tuple[float, float]) -> None:
    plane = birds_eye(REGION, VIEW)
    seen = appearance(rectify(plane, painted(x, y)), plane.axes)
    # Bilinear sampling blurs the edges symmetrically in the image; along x a pixel is 0.11 m at 17 m and grows with x squared.
    assert seen.area.item() == pytest.approx((x[1] - x[0]) * (y[1] - y[0]), rel=0.02)
    assert seen.centroids[0].tolist() == pytest.approx([-(y[0] + y[1]) / 2, -(x[0] + x[1]) / 2], abs=0.03)
    assert seen.length.item() == pytest.approx((x[1] - x[0]) / 12**0.5, rel=0.03)
    assert seen.shear.item() == pytest.approx(0, abs=0.02)


def test_outside_of_the_image_it_is_dark() -> None:
    plane = birds_eye(Region(-20, 60, 20, -20, cell_m=0.5), VIEW)
    seen = rectify(plane, torch.ones(VIEW.height, VIEW.width))
    rows, cols = seen.shape
    y, x = -plane.axes.u.expand(rows, cols), -plane.axes.v[:, None].expand(rows, cols)
    beside = y.abs() > 1.05 * (x + 1.6) * np.tan(np.radians(15)) + 0.5
    assert not seen[beside].any(), "beside the field of view, and behind the camera"
    within = (x > 12) & (y.abs() < 0.95 * (x + 1.6) * np.tan(np.radians(15)) - 0.5)
    torch.testing.assert_close(seen[within], torch.ones(int(within.sum())))


def test_batches_keep_dtype_and_device(device: torch.device) -> None:
    plane = birds_eye(Region(12, 20, 2, -2, cell_m=0.1), VIEW)
    images = torch.rand(2, 3, VIEW.height, VIEW.width, device=device)
    seen = rectify(plane, images)
    assert seen.shape == (2, 3, 80, 40)
    assert (seen.dtype, seen.device.type) == (torch.float32, device.type)
    torch.testing.assert_close(seen[1, 2], rectify(plane, images[1, 2]))
    assert rectify(plane, images[0, 0].double()).dtype == torch.float64
