"""Image metrics against SciPy and by hand, and figures of how well things stand out."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from torch.testing import assert_close

from luxloop.perception.metrics import dssim, edge_definition, iou, mae, mare, ring, rmse, ssim, unevenness, weber_contrast
from tests.refusal import refusal


def scipy_ssim(a: np.ndarray, b: np.ndarray, radius: float, data_range: float) -> float:
    def blur(x: np.ndarray) -> np.ndarray:
        return gaussian_filter(x, radius, mode="nearest", radius=math.ceil(3 * radius))

    ma, mb = blur(a), blur(b)
    va, vb, cov = blur(a * a) - ma**2, blur(b * b) - mb**2, blur(a * b) - ma * mb
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    return (((2 * ma * mb + c1) * (2 * cov + c2)) / ((ma**2 + mb**2 + c1) * (va + vb + c2))).mean()


@pytest.mark.parametrize("radius", [0.01, 0.8, 2.0, 9.5])
def test_ssim_agrees_with_scipy(radius: float, device: torch.device) -> None:
    rng = np.random.default_rng(0)
    a = rng.random((2, 3, 21, 17)) * 4
    b = a + rng.normal(size=a.shape)
    ours = ssim(torch.from_numpy(a).to(device), torch.from_numpy(b).to(device), radius, 4.0).cpu()
    expected = [[scipy_ssim(a[i, j], b[i, j], radius, 4.0) for j in range(3)] for i in range(2)]
    np.testing.assert_allclose(ours, expected, rtol=1e-10)


def test_ssim_gradient() -> None:
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.rand(6, 7, generator=generator, dtype=torch.float64, requires_grad=True) for _ in range(2))
    assert torch.autograd.gradcheck(lambda x, y: dssim(x, y, 1.0, 1.0), [a, b])


@pytest.mark.parametrize(("radius", "data_range"), [(0.0, 1.0), (1.0, 0.0)])
def test_ssim_refuses_empty_windows_and_ranges(radius: float, data_range: float) -> None:
    with refusal("positive radius and data_range"):
        ssim(torch.zeros(3, 3), torch.zeros(3, 3), radius, data_range)


def test_iou(device: torch.device) -> None:
    a = torch.zeros(4, 10, 10, dtype=torch.bool, device=device)
    b = torch.zeros_like(a)
    a[0, :, :4], b[0, :, 2:6] = True, True  # 20 of 60
    a[1, :5] = b[1, :5] = True
    a[2, 0], b[2, 1] = True, True
    assert_close(iou(a, b).cpu(), torch.tensor([1 / 3, 1.0, 0.0, 1.0]))


def test_errors_by_hand(device: torch.device) -> None:
    wanted = torch.tensor([[0.0, 2.0], [4.0, 0.0]], device=device)
    actual = torch.tensor([[[1.0, 2.0], [2.0, 0.0]], [[0.0, 2.0], [4.0, 0.0]]], device=device)
    assert_close(mae(actual, wanted).cpu(), torch.tensor([3 / (2 * 4), 0.0]))
    assert_close(rmse(actual, wanted).cpu(), torch.tensor([math.sqrt(5 / 2) / 4, 0.0]))
    assert_close(mare(actual, wanted).cpu(), torch.tensor([(1e12 + 0.5) / 2, 0.0]))


@pytest.mark.parametrize("error", [mae, rmse, mare])
def test_errors_need_a_positive_setpoint(error: Callable[[torch.Tensor, torch.Tensor], torch.Tensor]) -> None:
    wanted = torch.ones(2, 3, 3)
    wanted[1] = 0
    with refusal("dark everywhere"):
        error(torch.ones(3, 3), wanted)


MASK = torch.zeros(40, 60, dtype=torch.bool)
MASK[10:30, 20:40] = True


def patch(own: float, background: float) -> torch.Tensor:
    return torch.where(MASK, own, background).double()


def test_weber_contrast_is_the_difference_over_the_background() -> None:
    assert float(weber_contrast(patch(3.0, 1.0), MASK, 0.0)) == pytest.approx(2.0)
    assert float(weber_contrast(patch(0.25, 1.0), MASK, 0.0)) == pytest.approx(0.75)
    assert float(weber_contrast(1e-6 * patch(3.0, 1.0), MASK, 1e-3)) < 0.01  # nobody can tell


def test_edges_are_as_steep_as_the_ratio_says() -> None:
    one = edge_definition(patch(2.0, 1.0), MASK, 0.0)
    assert float(edge_definition(patch(4.0, 1.0), MASK, 0.0)) == pytest.approx(2 * float(one))
    assert float(edge_definition(patch(1.0, 1.0), MASK, 0.0)) < 1e-5
    assert float(one) == pytest.approx(0.693, rel=0.05)  # log 2 a px; at the one corner that counts it is steeper by root two


def test_even_light_is_even() -> None:
    assert float(unevenness(patch(5.0, 0.0), MASK, 0.0)) == pytest.approx(0.0)
    stripes = torch.arange(60.0).remainder(2).expand(40, 60)
    assert float(unevenness(stripes, MASK, 0.0)) == pytest.approx(1.0)


def test_the_ring_lies_around() -> None:
    around = ring(MASK, 3)
    assert not bool((around & MASK).any()) and int(around.sum()) == 26 * 26 - 20 * 20


@pytest.mark.parametrize("measure", [weber_contrast, edge_definition, unevenness])
def test_gradients_are_right(measure) -> None:
    light = torch.rand(40, 60, dtype=torch.float64, generator=torch.Generator().manual_seed(3)).add(0.5).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda image: measure(image, MASK, 0.01), (light,), fast_mode=True)
