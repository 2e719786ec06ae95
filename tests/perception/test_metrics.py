"""Image metrics against SciPy and by hand, and figures of how well things stand out."""

import math

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor
from torch.nn.functional import avg_pool2d
from torch.testing import assert_close

from luxloop.perception.birdseye import birds_eye, rectify, region_around
from luxloop.perception.camera import CameraParams, average_rows, camera_view
from luxloop.perception.metrics import (
    SSIM_RADIUS,
    Target,
    dssim,
    edge_definition,
    evaluate,
    iou,
    mae,
    mare,
    ring,
    rmse,
    ssim,
    target,
    unevenness,
    weber_contrast,
)
from luxloop.world.rendering.gbuffer import flat_road
from tests.refusal import refusal


def scipy_ssim(a: np.ndarray, b: np.ndarray, radius: float, data_range: float) -> float:
    def blur(x: np.ndarray) -> np.ndarray:
        return gaussian_filter(x, radius, mode="nearest", radius=math.ceil(3 * radius))

    ma, mb = blur(a), blur(b)
    va, vb, cov = blur(a * a) - ma**2, blur(b * b) - mb**2, blur(a * b) - ma * mb
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    return (((2 * ma * mb + c1) * (2 * cov + c2)) / ((ma**2 + mb**2 + c1) * (va + vb + c2))).mean()


@pytest.mark.parametrize("radius", [0.01, 0.8, 2.0, 9.5])
def test_ssim_agrees_with_scipy(radius, device):
    rng = np.random.default_rng(0)
    a = rng.random((2, 3, 21, 17)) * 4
    b = a + rng.normal(size=a.shape)
    ours = ssim(torch.from_numpy(a).to(device), torch.from_numpy(b).to(device), radius, 4.0).cpu()
    expected = [[scipy_ssim(a[i, j], b[i, j], radius, 4.0) for j in range(3)] for i in range(2)]
    np.testing.assert_allclose(ours, expected, rtol=1e-10)


def test_ssim_gradient():
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.rand(6, 7, generator=generator, dtype=torch.float64, requires_grad=True) for _ in range(2))
    assert torch.autograd.gradcheck(lambda x, y: dssim(x, y, 1.0, 1.0), [a, b])


@pytest.mark.parametrize(("radius", "data_range"), [(0.0, 1.0), (1.0, 0.0)])
def test_ssim_refuses_empty_windows_and_ranges(radius, data_range):
    with refusal("positive radius and data_range"):
        ssim(torch.zeros(3, 3), torch.zeros(3, 3), radius, data_range)


def test_iou(device):
    a = torch.zeros(4, 10, 10, dtype=torch.bool, device=device)
    b = torch.zeros_like(a)
    a[0, :, :4], b[0, :, 2:6] = True, True  # 20 of 60
    a[1, :5] = b[1, :5] = True
    a[2, 0], b[2, 1] = True, True
    assert_close(iou(a, b).cpu(), torch.tensor([1 / 3, 1.0, 0.0, 1.0]))


def test_errors_by_hand(device):
    wanted = torch.tensor([[0.0, 2.0], [4.0, 0.0]], device=device)
    actual = torch.tensor([[[1.0, 2.0], [2.0, 0.0]], [[0.0, 2.0], [4.0, 0.0]]], device=device)
    assert_close(mae(actual, wanted).cpu(), torch.tensor([3 / (2 * 4), 0.0]))
    assert_close(rmse(actual, wanted).cpu(), torch.tensor([math.sqrt(5 / 2) / 4, 0.0]))
    assert_close(mare(actual, wanted).cpu(), torch.tensor([(1e12 + 0.5) / 2, 0.0]))


@pytest.mark.parametrize("error", [mae, rmse, mare])
def test_errors_need_a_positive_setpoint(error):
    wanted = torch.ones(2, 3, 3)
    wanted[1] = 0
    with refusal("dark everywhere"):
        error(torch.ones(3, 3), wanted)


MASK = torch.zeros(40, 60, dtype=torch.bool)
MASK[10:30, 20:40] = True


def patch(own: float, background: float) -> torch.Tensor:
    return torch.where(MASK, own, background).double()


def test_weber_contrast_is_the_difference_over_the_background():
    assert float(weber_contrast(patch(3.0, 1.0), MASK, 0.0)) == pytest.approx(2.0)
    assert float(weber_contrast(patch(0.25, 1.0), MASK, 0.0)) == pytest.approx(0.75)
    assert float(weber_contrast(1e-6 * patch(3.0, 1.0), MASK, 1e-3)) < 0.01  # nobody can tell


def test_edges_are_as_steep_as_the_ratio_says():
    one = edge_definition(patch(2.0, 1.0), MASK, 0.0)
    assert float(edge_definition(patch(4.0, 1.0), MASK, 0.0)) == pytest.approx(2 * float(one))
    assert float(edge_definition(patch(1.0, 1.0), MASK, 0.0)) < 1e-5
    assert float(one) == pytest.approx(0.693, rel=0.05)  # log 2 a px; at the one corner that counts it is steeper by root two


def test_even_light_is_even():
    assert float(unevenness(patch(5.0, 0.0), MASK, 0.0)) == pytest.approx(0.0)
    stripes = torch.arange(60.0).remainder(2).expand(40, 60)
    assert float(unevenness(stripes, MASK, 0.0)) == pytest.approx(1.0)


def test_the_ring_lies_around():
    around = ring(MASK, 3)
    assert not bool((around & MASK).any()) and int(around.sum()) == 26 * 26 - 20 * 20


@pytest.mark.parametrize("measure", [weber_contrast, edge_definition, unevenness])
def test_gradients_are_right(measure):
    light = torch.rand(40, 60, dtype=torch.float64, generator=torch.Generator().manual_seed(3)).add(0.5).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda image: measure(image, MASK, 0.01), (light,), fast_mode=True)


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


def test_the_target_is_perfect(goal):
    metrics = evaluate(symbol(), PLANE, goal)
    assert metrics.centroid_percent.tolist() == [0, 0]
    assert metrics.iou == 1
    assert metrics.ssim.item() == pytest.approx(1)
    assert metrics.length == 1
    assert metrics.shear == goal.shape.shear
    # The threshold at a quarter takes a quarter of a pixel more at each edge.
    assert goal.mask.float().sum().item() * 0.04**2 == pytest.approx(4 * 0.8 + 1.4 * 1.2 + 0.5 * 1.2, rel=0.06)


@pytest.mark.parametrize(("dx", "dy"), [(0.4, 0.0), (-0.4, 0.0), (0.0, 0.2), (0.0, -0.2), (1.0, 0.5)])
def test_a_shift_is_given_in_percent_of_the_symbol_forward_and_to_the_left(goal, dx, dy):
    metrics = evaluate(symbol(dx, dy), PLANE, goal)
    # A pixel is 0.11 m long at 17 m; thresholded, its interpolation knows the centre to a sixth of that, 0.5 % of 4 m.
    assert metrics.centroid_percent[0].item() == pytest.approx(100 * dx / LENGTH, abs=0.5)
    assert metrics.centroid_percent[1].item() == pytest.approx(100 * dy / WIDTH, abs=0.1)
    assert metrics.iou < 0.9
    assert metrics.ssim < 0.98


@pytest.mark.parametrize(("shear", "stretch"), [(-0.3, 1.0), (0.3, 1.0), (0.0, 0.8), (0.0, 1.25)])
def test_shear_and_length_leave_each_other_and_the_centre(goal, shear, stretch):
    metrics = evaluate(symbol(shear=shear, stretch=stretch), PLANE, goal)
    # In the plane u = -y and v = -x grow to the right and towards the car.
    assert metrics.shear.item() == pytest.approx(shear, abs=0.03)
    assert metrics.length.item() == pytest.approx(stretch, rel=0.02)
    assert stretch != 1 or metrics.centroid_percent.abs().max() < 0.5


@pytest.mark.parametrize("dx", [0.0, 1.5, 9.0])
def test_similarity_is_that_of_the_whole_plane(goal, dx):
    """Though it is computed only where there is light."""
    luminance = torch.stack([symbol(dx, dy) for dy in (0.0, 0.7)])
    seen, wanted = (
        avg_pool2d((each / goal.median / 2).clamp(0, 1), 2) for each in (rectify(PLANE, luminance), goal.luminance.expand(2, -1, -1))
    )
    # In single precision a mean over half a million cells is good to some 1e-6.
    assert evaluate(luminance, PLANE, goal).ssim.tolist() == pytest.approx(ssim(seen, wanted, SSIM_RADIUS, 1.0).tolist(), abs=2e-6)


def test_a_crop_is_evaluated_as_the_whole_image_that_is_dark_beyond(goal):
    whole = torch.stack([symbol(), symbol(1.0, 0.5), torch.zeros_like(symbol())])
    v, u = whole.any(0).any(1).nonzero(), whole.any(0).any(0).nonzero()
    cut = whole[:, int(v[0]) - 3 : int(v[-1]) + 5, int(u[0]) - 4 : int(u[-1]) + 2]
    expected, found = evaluate(whole, PLANE, goal), evaluate(cut, PLANE, goal, u_start=int(u[0]) - 4, v_start=int(v[0]) - 3)
    for name, value in vars(expected).items():
        assert vars(found)[name].equal(value) or torch.allclose(vars(found)[name], value, rtol=0, atol=1e-5, equal_nan=True), name
    assert expected.iou[2] == 0, "nothing of the symbol is there"
    assert all(value[2].isnan().all() for value in (expected.centroid_percent, expected.length, expected.shear))


def test_brightness_does_not_move_the_symbol(goal):
    """The threshold is fixed, so edges of a brighter symbol win a little; ten times darker and it is gone."""
    dim, bright = evaluate(symbol(brightness=0.06), PLANE, goal), evaluate(symbol(brightness=0.2), PLANE, goal)
    for metrics in (dim, bright):
        assert metrics.iou > 0.95
        assert metrics.centroid_percent.abs().max() < 1
        assert metrics.ssim < 0.995
    assert evaluate(symbol(brightness=0.01), PLANE, goal).iou == 0
