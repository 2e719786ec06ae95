"""The rectified view: what lies on z = 0 gets its place and size in metres."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from luxloop.perception.appearance import appearance
from luxloop.perception.birdseye import Region, birds_eye, rectify, region_around
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.world.frames import View
from luxloop.world.rendering.gbuffer import flat_road
from luxloop.world.texels import Window

VIEW = camera_view(CameraParams())
REGION = region_around(17.0, 0.0, 4.0, 2.0)


def painted(x: tuple[float, float], y: tuple[float, float], view: View = VIEW, samples: tuple[int, int] = (4, 1)) -> Tensor:
    """Camera image `[height, width]` of a white rectangle on z = 0, with so many samples to a pixel's height and width."""
    v, u = samples
    fine = View(view.width * u, view.height * v, view.fx * u, view.fy * v, view.cx * u, view.cy * v, view.T_world_view)
    px, py, _ = flat_road(fine, 1.0).position
    inside = (px > x[0]) & (px < x[1]) & (py > y[0]) & (py < y[1])
    return inside.float().view(view.height, v, view.width, u).mean((1, 3))


def test_cells_look_where_their_point_projects():
    """An image of its own coordinates is linear, so bilinear sampling gives them back: the half pixels are right."""
    plane = birds_eye(REGION, VIEW, dtype=torch.float64)
    u = (torch.arange(VIEW.width, dtype=torch.float64) + 0.5).expand(VIEW.height, -1)
    v = (torch.arange(VIEW.height, dtype=torch.float64) + 0.5)[:, None].expand(-1, VIEW.width)
    sampled = rectify(plane, torch.stack([u, v]))
    rows, cols = sampled.shape[-2:]
    y, x = -plane.axes.u, -plane.axes.v
    ground = torch.stack([x[:, None].expand(rows, cols), y.expand(rows, cols), torch.zeros(rows, cols, dtype=torch.float64)])
    uv, _ = VIEW.project(ground.flatten(1))
    uv = uv.view(2, rows, cols)
    # Nearer to the image's border than half a cell the mean is one of fewer columns, and its centre another.
    border = torch.tensor([plane.columns // 2 + 1, 1]).view(2, 1, 1)
    inside = ((uv > border) & (uv < torch.tensor([VIEW.width, VIEW.height]).view(2, 1, 1) - border)).all(0)
    assert inside.float().mean() > 0.5
    assert_close(sampled[:, inside], uv[:, inside], rtol=0, atol=1e-9)


def test_an_edge_that_moves_by_a_part_of_a_cell_moves_the_centre_by_as_much():
    part_of_view = replace(VIEW, width=320, height=100, cx=VIEW.cx - 640, cy=VIEW.cy - 380)
    plane = birds_eye(REGION, part_of_view)
    pixel_m = 18.6 / VIEW.fx
    assert plane.columns == 5, "odd, and as wide as a cell of 4 cm in columns of 8 mm"
    single = replace(plane, columns=1)
    worst = {plane.columns: 0.0, 1: 0.0}
    for share in torch.linspace(0, 1, 9).tolist():
        y = share * REGION.cell_m - 0.9
        image = painted((15, 19), (y - 0.1, y + 0.1), part_of_view, samples=(4, 8))
        for view in (plane, single):
            u = appearance(rectify(view, image), view.axes).centroids[0, 0].item()
            worst[view.columns] = max(worst[view.columns], abs(u + y))
    # Both edges are known to an eighth of a pixel, as they are painted.
    assert worst[plane.columns] < pixel_m / 8
    assert worst[1] > pixel_m, "what the mean is good for"


def whole(crop: Window, part: Tensor) -> Tensor:
    image = part.new_zeros(*part.shape[:-2], VIEW.height, VIEW.width)
    image[..., *crop.slices] = part
    return image


CROPS = [Window(380, 500, 560, 720), Window(400, 401, 600, 640), Window(0, 720, 600, 700), Window(379, 720, 400, 1280)]
each_crop = pytest.mark.parametrize("crop", CROPS, ids=["around", "one row", "columns", "to the border"])


@pytest.mark.parametrize("margin_cells", [1, 0])
@each_crop
def test_a_crop_is_the_whole_image_with_zeros_around(crop, margin_cells, device):
    """margin_cells: dark columns of a crop on either side; in a footprint with a margin for unevenness there are four cells of them."""
    plane = birds_eye(REGION, VIEW)
    part = torch.rand(2, crop.v_stop - crop.v_start, crop.u_stop - crop.u_start, generator=torch.Generator().manual_seed(1)).to(device)
    dark = margin_cells * plane.columns
    part[..., :dark], part[..., part.shape[-1] - dark :] = 0, 0
    expected = rectify(plane, whole(crop, part))
    assert expected.any()
    # A float32 position in 0..1280 px is known to a ten thousandth, over which neighbours differ by no more than that.
    assert_close(rectify(plane, part, crop.u_start, crop.v_start), expected, rtol=0, atol=2e-4)


def test_outside_of_the_image_it_is_dark():
    plane = birds_eye(Region(-20, 60, 20, -20, cell_m=0.5), VIEW)
    seen = rectify(plane, torch.ones(VIEW.height, VIEW.width))
    rows, cols = seen.shape
    y, x = -plane.axes.u.expand(rows, cols), -plane.axes.v[:, None].expand(rows, cols)
    beside = y.abs() > 1.05 * (x + 1.6) * np.tan(np.radians(15)) + 0.5
    assert not seen[beside].any(), "beside the field of view, and behind the camera"
    within = (x > 12) & (y.abs() < 0.95 * (x + 1.6) * np.tan(np.radians(15)) - 0.5)
    assert_close(seen[within], torch.ones(int(within.sum())))


def test_axes_run_like_the_image():
    plane = birds_eye(Region(10, 12, 1, -1, cell_m=0.5), VIEW)
    assert plane.axes.u.tolist() == [-0.75, -0.25, 0.25, 0.75]  # -y, to the right
    assert plane.axes.v.tolist() == [-11.75, -11.25, -10.75, -10.25]  # -x, towards the car
    assert plane.map_u.shape == (4, 4)


@pytest.mark.parametrize(("x", "y"), [((15, 19), (-1, 1)), ((12, 14), (0.5, 1.5)), ((20, 26), (-2, -0.5))])
def test_a_rectangle_keeps_its_place_and_size(x, y):
    plane = birds_eye(REGION, VIEW)
    seen = appearance(rectify(plane, painted(x, y)), plane.axes)
    # Bilinear sampling blurs the edges symmetrically in the image; along x a pixel is 0.11 m at 17 m and grows with x squared.
    assert seen.area.item() == pytest.approx((x[1] - x[0]) * (y[1] - y[0]), rel=0.02)
    assert seen.centroids[0].tolist() == pytest.approx([-(y[0] + y[1]) / 2, -(x[0] + x[1]) / 2], abs=0.03)
    assert seen.length.item() == pytest.approx((x[1] - x[0]) / 12**0.5, rel=0.03)
    assert seen.shear.item() == pytest.approx(0, abs=0.02)
