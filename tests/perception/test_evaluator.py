"""The evaluator: errors in % of the symbol with the sign of the world's axes, whatever the extraction thinks."""

import pytest
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from luxloop.perception.birdseye import birds_eye, rectify, region_around
from luxloop.perception.camera import CameraParams, average_rows, camera_view
from luxloop.perception.metrics import SSIM_RADIUS, Target, evaluate, ssim, target
from luxloop.world.rendering.gbuffer import flat_road

CAMERA = CameraParams()
LENGTH, WIDTH = 4.0, 2.0
PLANE = birds_eye(region_around(17.0, 0.0, LENGTH, WIDTH), camera_view(CAMERA))
ROAD_X, ROAD_Y, _ = flat_road(camera_view(CAMERA).with_rows(4), 1.0).position


def symbol(dx: float = 0.0, dy: float = 0.0, stretch: float = 1.0, shear: float = 0.0, brightness: float = 0.1) -> Tensor:
    """Luminance `[height, width]` of a cross with a foot; far parts are darker. shear: x falls as y falls, in m/m."""
    x, y = (ROAD_X - 17 - dx - shear * (ROAD_Y - dy)) / stretch, ROAD_Y - dy
    cross = ((x.abs() < 2) & (y.abs() < 0.4)) | ((x.abs() < 0.7) & (y.abs() < 1)) | ((x < -1.5) & (x > -2) & (y.abs() < 1))
    return average_rows(brightness * cross / ROAD_X.clamp(min=1) ** 2 * 17**2, 4)


@pytest.fixture(scope="module")
def goal() -> Target:
    return target(symbol(), PLANE, LENGTH, WIDTH)


def test_the_target_is_perfect(goal: Target) -> None:
    metrics = evaluate(symbol(), PLANE, goal)
    assert metrics.centroid_percent.tolist() == [0, 0]
    assert metrics.iou == 1
    assert metrics.ssim.item() == pytest.approx(1)
    assert metrics.length == 1
    assert metrics.shear == goal.shape.shear
    # The threshold at a quarter takes a quarter of a pixel more at each edge.
    assert goal.mask.float().sum().item() * 0.04**2 == pytest.approx(4 * 0.8 + 1.4 * 1.2 + 0.5 * 1.2, rel=0.06)


@pytest.mark.parametrize(("dx", "dy"), [(0.4, 0.0), (-0.4, 0.0), (0.0, 0.2), (0.0, -0.2), (1.0, 0.5)])
def test_a_shift_is_given_in_percent_of_the_symbol_forward_and_to_the_left(goal: Target, dx: float, dy: float) -> None:
    metrics = evaluate(symbol(dx, dy), PLANE, goal)
    # A pixel is 0.11 m long at 17 m; thresholded, its interpolation knows the centre to a sixth of that, 0.5 % of 4 m.
    assert metrics.centroid_percent[0].item() == pytest.approx(100 * dx / LENGTH, abs=0.5)
    assert metrics.centroid_percent[1].item() == pytest.approx(100 * dy / WIDTH, abs=0.1)
    assert metrics.iou < 0.9
    assert metrics.ssim < 0.98


@pytest.mark.parametrize(("shear", "stretch"), [(-0.3, 1.0), (0.3, 1.0), (0.0, 0.8), (0.0, 1.25)])
def test_shear_and_length_leave_each_other_and_the_centre(goal: Target, shear: float, stretch: float) -> None:
    metrics = evaluate(symbol(shear=shear, stretch=stretch), PLANE, goal)
    # In the plane u = -y and v = -x grow to the right and towards the car.
    assert metrics.shear.item() == pytest.approx(shear, abs=0.03)
    assert metrics.length.item() == pytest.approx(stretch, rel=0.02)
    assert stretch != 1 or metrics.centroid_percent.abs().max() < 0.5


@pytest.mark.parametrize("dx", [0.0, 1.5, 9.0])
def test_similarity_is_that_of_the_whole_plane(goal: Target, dx: float) -> None:
    """Though it is computed only where there is light."""
    luminance = torch.stack([symbol(dx, dy) for dy in (0.0, 0.7)])
    seen, wanted = (
        avg_pool2d((each / goal.median / 2).clamp(0, 1), 2) for each in (rectify(PLANE, luminance), goal.luminance.expand(2, -1, -1))
    )
    # In single precision a mean over half a million cells is good to some 1e-6.
    assert evaluate(luminance, PLANE, goal).ssim.tolist() == pytest.approx(ssim(seen, wanted, SSIM_RADIUS, 1.0).tolist(), abs=2e-6)


def test_a_crop_is_evaluated_as_the_whole_image_that_is_dark_beyond(goal: Target) -> None:
    whole = torch.stack([symbol(), symbol(1.0, 0.5), torch.zeros_like(symbol())])
    v, u = whole.any(0).any(1).nonzero(), whole.any(0).any(0).nonzero()
    cut = whole[:, int(v[0]) - 3 : int(v[-1]) + 5, int(u[0]) - 4 : int(u[-1]) + 2]
    expected, found = evaluate(whole, PLANE, goal), evaluate(cut, PLANE, goal, u_start=int(u[0]) - 4, v_start=int(v[0]) - 3)
    for name, value in vars(expected).items():
        assert vars(found)[name].equal(value) or torch.allclose(vars(found)[name], value, rtol=0, atol=1e-5, equal_nan=True), name
    assert expected.iou[2] == 0, "nothing of the symbol is there"
    assert all(value[2].isnan().all() for value in (expected.centroid_percent, expected.length, expected.shear))


def test_brightness_does_not_move_the_symbol(goal: Target) -> None:
    """The threshold is fixed, so edges of a brighter symbol win a little; ten times darker and it is gone."""
    dim, bright = evaluate(symbol(brightness=0.06), PLANE, goal), evaluate(symbol(brightness=0.2), PLANE, goal)
    for metrics in (dim, bright):
        assert metrics.iou > 0.95
        assert metrics.centroid_percent.abs().max() < 1
        assert metrics.ssim < 0.995
    assert evaluate(symbol(brightness=0.01), PLANE, goal).iou == 0
