"""Differential imaging: what noise makes, what a symbol makes, and the gate's reasons."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter
from torch import Tensor
from torch.nn.functional import avg_pool1d
from torch.testing import assert_close

from luxloop.perception.appearance import appearance, image_axes
from luxloop.perception.camera import CameraParams, expose, luminance_of
from luxloop.perception.extraction import ExtractionParams, ExtractionStatus, difference, gate, symbol_image, threshold
from luxloop.perception.noise import FrameNoise

PARAMS = ExtractionParams()
SOFT = ExtractionParams(edges="soft")
GREY, BINARY = ExtractionParams(edges="grey"), ExtractionParams(edges="binary")
CAMERAS = {
    "12 bits, linear": CameraParams(),
    "8 bits, gamma 2.2": CameraParams(bits=8, gamma=2.2),
    "10 bits, much read noise": CameraParams(bits=10, read_noise_e=8.0),
}


def frames(on: Tensor, off: Tensor, camera: CameraParams, seed: int = 1) -> tuple[Tensor, Tensor]:
    return expose(on, camera, FrameNoise.of(seed, 0, 0)), expose(off, camera, FrameNoise.of(seed, 0, 1))


def extracted(on: Tensor, off: Tensor, camera: CameraParams, params: ExtractionParams = PARAMS) -> Tensor:
    return symbol_image(difference(on, off, camera), threshold(off, camera, params), params)


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("luminance", [0.0, 0.01, 0.02, 0.1, 0.5])
def test_noise_alone_makes_no_symbol(name, luminance, device):
    dark = torch.full((360, 640), luminance, device=device)
    symbol = extracted(*frames(dark, dark, CAMERAS[name]), CAMERAS[name])
    # Five sigma leave 3e-7 of 230,000 pixels, shot noise at a dozen electrons a little more. Thresholds from single pixels of the off
    # frame, themselves noisy, would let 200 pass at 0.02 cd/m^2, the default ambient light.
    assert symbol.sum() <= 1


@pytest.mark.parametrize("params", [GREY, BINARY], ids=["grey", "binary"])
@pytest.mark.parametrize("name", CAMERAS)
def test_a_symbol_is_found_as_it_is(name, params, device):
    camera = CAMERAS[name]
    off = torch.linspace(0.05, 0.3, 640, device=device).expand(360, -1)
    true = torch.zeros(360, 640, device=device)
    true[100:160, 200:400] = 1
    true[120:130, 250:300] = 0
    limit = threshold(expose(off, camera), camera, params)
    symbol = extracted(*frames(off + 2 * limit * true, off, camera), camera, params)
    # At twice the threshold a miss needs another five sigma, of a somewhat larger noise.
    assert ((symbol > 0) != (true > 0)).sum() <= 10
    # Grey, a pixel counts wholly from 1.5 thresholds on, two sigma lower: some 3 % fall short, by a fifth of a pixel.
    assert (symbol - true).abs().sum() <= (0.008 * true.sum() if params is GREY else 10)


def test_differences_are_signed(device):
    camera = CameraParams()
    on, off = torch.full((2, 2), 10.0, device=device), torch.full((2, 2), 12.0, device=device)
    assert_close(difference(on, off, camera), luminance_of(on, camera) - luminance_of(off, camera))
    assert not extracted(torch.zeros(2, 2, device=device), 4095 * torch.ones(2, 2, device=device), camera).any(), "shadows are no symbol"


def test_threshold_is_absolute_and_grows_with_the_light_that_is_there():
    camera = CameraParams()
    off = expose(torch.tensor([[0.05, 0.2, 0.8]]), camera)
    limit = threshold(off, camera, PARAMS)[0]
    light = torch.tensor([0.125, 0.35, 0.5])  # mean with the neighbours
    electrons = light * camera.exposure_s * camera.sensitivity_e_per_cd_s_m2
    per_electron = 1 / (camera.exposure_s * camera.sensitivity_e_per_cd_s_m2)
    level = camera.saturation_e / 4095
    expected = 5 * math.sqrt(2) * (electrons + camera.read_noise_e**2 + level**2 / 12).sqrt() * per_electron
    assert_close(limit, expected, rtol=1e-3, atol=0)  # off is quantised
    assert_close(threshold(off, camera, ExtractionParams(threshold_sigma=7))[0], limit / 5 * 7)


@pytest.mark.parametrize("shape", [(2, 3, 20, 30), (9, 40), (1, 1), (2, 50), (50, 2)])
def test_the_brightest_is_looked_for_three_rows_high_and_seven_columns_wide(shape, device):
    contrast = torch.randn(shape, generator=torch.Generator().manual_seed(2)).exp().to(device)
    limit = torch.full(shape[-2:], 0.3, device=device)
    brightest = maximum_filter(contrast.cpu().numpy(), (*[1] * (len(shape) - 2), 3, 7), mode="constant", cval=-np.inf)
    wholly = torch.maximum(0.6 * torch.from_numpy(brightest).to(device), 1.5 * limit)
    expected = ((contrast - limit) / (wholly - limit)).clamp(0, 1)
    assert_close(symbol_image(contrast, limit, GREY), expected)
    assert torch.equal(symbol_image(contrast, limit, BINARY), (contrast > limit).to(contrast))


def rectangle(u: float, v: float, blur: int, samples: int = 40) -> Tensor:
    """Contrast `[24, 44]` of a rectangle 20.3 x 9.7 px whose centre is (u, v), integrated over pixels; edges `blur` samples wide."""

    def line(centre: float, length: float, pixels: int) -> Tensor:
        x = (torch.arange(pixels * samples) + 0.5) / samples
        lit = ((x - centre).abs() < length / 2).double()[None]
        return avg_pool1d(avg_pool1d(lit, blur, 1, blur // 2), samples)[0]

    return line(v, 9.7, 24)[:, None] * line(u, 20.3, 44)


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)], ids=["u", "v", "both"])
def test_centres_follow_a_rectangle_by_parts_of_a_pixel(direction):
    """Edges are 1.5 px wide, as those of a pixellight in the camera's image; the threshold is a twentieth of the light."""
    worst = {}
    for params in (GREY, BINARY):
        off = []
        for part in torch.linspace(0, 1, 21).tolist():
            u, v = 22 + part * direction[0], 12 + part * direction[1]
            symbol = symbol_image(rectangle(u, v, blur=61), torch.tensor(0.05, dtype=torch.float64), params)
            seen = appearance(symbol, image_axes(24, 44, like=symbol)).centroids[0]
            off.append((seen - torch.tensor([u, v])).abs().max())
        worst[params.edges] = max(off).item()
    # The ramp from 0.05 to 0.6 of the light counts what an edge moves a hundredth of a pixel early or late; measured 0.013.
    assert worst["grey"] < 0.02
    assert worst["binary"] > 0.2, "an edge that crosses the threshold moves the centre by half a pixel at once"


@given(st.floats(-10, 10), st.floats(0.01, 2))
def test_the_soft_form_is_the_hard_one_a_few_sigma_away(sigmas, sigma):
    limit = torch.tensor(5 * sigma)
    contrast = limit + sigmas * sigma
    soft = symbol_image(contrast, limit, SOFT).item()
    assert soft == pytest.approx(1 / (1 + math.exp(-sigmas)), abs=1e-4)


def test_the_soft_form_passes_gradients_where_the_hard_one_has_none():
    camera = CameraParams()
    off = torch.full((8, 8), 200.0, dtype=torch.float64)
    on = (off + torch.linspace(0, 400, 64, dtype=torch.float64).view(8, 8)).requires_grad_()
    limit = threshold(off, camera, PARAMS)
    assert torch.autograd.gradcheck(lambda on: symbol_image(difference(on, off, camera), limit, SOFT), (on,))
    symbol_image(difference(on, off, camera), limit, SOFT).sum().backward()
    assert on.grad is not None and on.grad.isfinite().all() and (on.grad >= 0).all() and on.grad.max() > 0


def test_the_gate_names_its_reason(device):
    expected = torch.tensor(100.0, device=device)
    areas = {
        0: ExtractionStatus.NOTHING,
        7.9: ExtractionStatus.NOTHING,
        8.1: ExtractionStatus.TOO_SMALL,
        44.9: ExtractionStatus.TOO_SMALL,
        45.1: ExtractionStatus.SEEN,
        189: ExtractionStatus.SEEN,
        191: ExtractionStatus.TOO_LARGE,
    }
    codes = gate(torch.tensor(list(areas), device=device), expected, PARAMS)
    assert codes.dtype == torch.int64
    assert codes.tolist() == [int(code) for code in areas.values()]
    assert gate(torch.zeros(2, 3, device=device), expected, PARAMS).shape == (2, 3)
    for area, wanted, code in ((0.0, 0.0, "NOTHING"), (5.0, 0.0, "TOO_LARGE"), (math.nan, 5.0, "NOTHING")):
        assert gate(torch.tensor(area), torch.tensor(wanted), PARAMS) == ExtractionStatus[code]
