"""The camera's law, its noise and its geometry."""

import math

import cv2
import numpy as np
import pytest
import torch
from pydantic import ValidationError
from torch.testing import assert_close

from luxloop.perception.camera import CameraParams, OncomingParams, camera_view, expose, glare, luminance_of, noise_std
from luxloop.perception.noise import FrameNoise
from luxloop.world.frames import inverse, pose_from_degrees, transform

BITS = [8, 10, 12]
PER_ELECTRON = 1 / (0.015 * 50_000)  # cd/m^2 of the default camera


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_law_of_the_docstring(gamma, device):
    params = CameraParams(bits=8, gamma=gamma, exposure_s=0.03, sensitivity_e_per_cd_s_m2=25_000.0)
    electrons = torch.tensor([[0.0, 1.0, 250.0], [999.0, 1000.0, 5000.0]], dtype=torch.float64, device=device)
    dn = expose(electrons * PER_ELECTRON, params)
    expected = torch.round(255 * (electrons.clamp(max=1000) / 1000) ** (1 / gamma))
    assert_close(dn, expected)
    assert dn[0, 0] == 0
    assert dn[1, 1] == dn[1, 2] == 255


@pytest.mark.parametrize("gamma", [1.0, 2.2, 3.0])
@pytest.mark.parametrize("bits", BITS)
def test_every_level_survives_the_round_trip(bits, gamma, device):
    params = CameraParams(bits=bits, gamma=gamma)
    dn = torch.arange(2**bits, dtype=torch.float32, device=device)[None]
    assert_close(expose(luminance_of(dn, params), params), dn, rtol=0, atol=0)


@pytest.mark.parametrize(("bits", "gamma"), [(8, 1.0), (8, 2.2), (12, 1.0), (12, 2.2)])
@pytest.mark.parametrize("electrons", [30.0, 200.0, 800.0])
def test_noise_has_the_mean_and_variance_of_the_law(bits, gamma, electrons, device):
    params = CameraParams(bits=bits, gamma=gamma, read_noise_e=3)
    luminance = torch.full((300, 300), electrons * PER_ELECTRON, dtype=torch.float64, device=device)
    seen = luminance_of(expose(luminance, params, FrameNoise.of(1, 0, 0)), params)
    std = noise_std(luminance, params)[0, 0].item()
    # 90,000 samples: five standard errors of the mean are std / 60, of the standard deviation 1.2 %. A curved code shifts the mean
    # by up to 1 % of std at 30 electrons, its quantisation is not quite uniform: 2 % in all.
    assert seen.mean().item() == pytest.approx(luminance[0, 0].item(), abs=std / 40)
    assert seen.std().item() == pytest.approx(std, rel=0.02)
    if bits == 12:
        assert std / PER_ELECTRON == pytest.approx(math.sqrt(electrons + 9), rel=1e-3)  # 12 bits add next to nothing


@pytest.mark.parametrize(
    ("electrons", "share", "brighter_dn"), [(0, 0.58, 3.3), (1, 0.73, 2.0), (2, 0.83, 1.2), (4, 0.93, 0.4), (8, 0.99, 0.0)]
)
def test_near_black_frames_vary_less_and_are_brighter(electrons, share, brighter_dn):
    """The table of docs/camera.md: there is no pedestal that would keep noise below zero."""
    params = CameraParams()
    luminance = torch.full((600, 600), electrons * PER_ELECTRON, dtype=torch.float64)
    dn = expose(luminance, params, FrameNoise.of(1, 0, 0))
    # 360,000 samples: five standard errors of the deviation are 0.6 %, of the mean 0.1 DN; the table is rounded to half a digit more.
    assert luminance_of(dn, params).std().item() == pytest.approx(share * noise_std(luminance, params)[0, 0].item(), rel=0.015)
    assert dn.mean().item() - electrons / params.saturation_e * 4095 == pytest.approx(brighter_dn, abs=0.15)


def test_noise_std_without_noise_is_a_uniform_level(device):
    params = CameraParams(bits=8, noise=False)
    level = luminance_of(torch.tensor(1.0), params).item()
    std = noise_std(torch.tensor([[0.5]], device=device), params)
    assert std.item() == pytest.approx(level / math.sqrt(12), rel=1e-5)


def test_noise_by_key_given_batch_and_switched_off():
    params, even = CameraParams(), torch.full((2, 40, 50), 0.3)
    frames = [expose(even, params, FrameNoise.of(*key)) for key in ((7, 3, 1), (7, 3, 1), (8, 3, 1), (7, 4, 1), (7, 3, 0), (7, 1, 3))]
    assert torch.equal(frames[0], frames[1]) and not any(torch.equal(frames[0], other) for other in frames[2:])
    assert torch.equal(even, torch.full((2, 40, 50), 0.3))  # left alone although the work is done in place
    luminance = torch.rand(3, 20, 30, generator=torch.Generator().manual_seed(0))
    noise = torch.randn(3, 20, 30, generator=torch.Generator().manual_seed(1))
    batch = expose(luminance, params, noise)
    assert batch.dtype == torch.float32
    for k in range(3):
        assert torch.equal(expose(luminance[k], params, noise[k]), batch[k])
    silent = CameraParams(noise=False)
    assert torch.equal(expose(luminance, silent, noise), expose(luminance, params))


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_unrounded_signal_is_differentiable(gamma):
    params = CameraParams(bits=8, gamma=gamma)
    luminance = (torch.linspace(0.05, 1.2, 12, dtype=torch.float64).reshape(3, 4)).requires_grad_()
    noise = torch.linspace(-1, 1, 12, dtype=torch.float64).reshape(3, 4)
    assert torch.autograd.gradcheck(lambda x: expose(x, params, noise, quantise=False), [luminance])
    assert torch.autograd.gradcheck(lambda x: noise_std(x, params), [luminance])
    assert torch.equal(expose(luminance, params, noise, quantise=False).round(), expose(luminance, params, noise))

    black = torch.zeros(2, 2, requires_grad=True)
    (slope,) = torch.autograd.grad(expose(black, params, quantise=False).sum(), black)
    assert slope.isfinite().all()


def test_horizontal_field_of_view_is_exact():
    view = camera_view(CameraParams(x_m=0, z_m=0, pitch_deg=0))
    assert view.fx == view.fy == pytest.approx(2388.5, abs=0.1)  # 640 / tan(15 deg)
    edge = torch.tensor([[1.0], [math.tan(math.radians(15))], [0.0]], dtype=torch.float64)  # 15 deg to the left
    uv, depth = view.project(edge)
    assert_close(uv[:, 0], torch.tensor([0.0, 360.0], dtype=torch.float64), atol=1e-9, rtol=0)
    assert depth.item() == pytest.approx(1.0)


def test_projection_agrees_with_opencv_shifted_by_half_a_pixel():
    params = CameraParams(x_m=-1.2, y_m=0.3, roll_deg=2, pitch_deg=4, yaw_deg=-3, width_px=640, height_px=480)
    view = camera_view(params)
    rng = np.random.default_rng(0)
    points = rng.uniform([8, -3, -0.2], [40, 3, 1.5], (50, 3))
    T_view_world = inverse(view.T_world_view).numpy()
    K = np.array([[view.fx, 0, view.cx - 0.5], [0, view.fy, view.cy - 0.5], [0, 0, 1]])  # OpenCV's centres are integers
    expected, _ = cv2.projectPoints(points, cv2.Rodrigues(T_view_world[:3, :3])[0], T_view_world[:3, 3], K, None)
    uv, _ = view.project(torch.from_numpy(points.T))
    np.testing.assert_allclose(uv.T, expected[:, 0] + 0.5, atol=1e-8)


def test_vehicle_axes_become_image_axes():
    params = CameraParams(roll_deg=10, pitch_deg=5, yaw_deg=20)
    T_mount_view = inverse(pose_from_degrees((params.x_m, params.y_m, params.z_m), 10, 5, 20)) @ camera_view(params).T_world_view
    axes = transform(T_mount_view, torch.eye(3, dtype=torch.float64))
    expected = torch.tensor([[0, -1, 0], [0, 0, -1], [1, 0, 0]], dtype=torch.float64).T  # right, down, forward in x, y, z of the mount
    assert_close(axes, expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    "bad", [{"bits": 9}, {"gamma": 0.5}, {"hfov_deg": 180}, {"exposure_s": 0}, {"latency_steps": 11}, {"drop_probability": 1.0}]
)
def test_bad_input(bad):
    with pytest.raises(ValidationError, match=next(iter(bad))):
        CameraParams(**bad)


SMALL_VIEW = camera_view(CameraParams(width_px=320, height_px=180, pitch_deg=0.0))
PIXEL_SR = 1 / SMALL_VIEW.fx**2  # of a pixel in the middle


def oncoming(**keys: object) -> OncomingParams:
    return OncomingParams.model_validate({"position_m": (40.0, 0.5, 1.0), "veil": 0.0} | keys)


@pytest.mark.parametrize("diameter_m", [0.1, 1.0])
def test_the_image_holds_the_illuminance_at_the_camera(diameter_m, device):
    source = oncoming(diameter_m=diameter_m, intensity_cd=800.0)
    image = glare(SMALL_VIEW, source.position_at(0.0), source, device)
    away = source.position_at(0.0) - SMALL_VIEW.origin
    # at 0.7 deg from the axis a pixel's solid angle is 0.02 % smaller; sampling a Gaussian at its own width costs as little
    assert float(image.sum()) * PIXEL_SR == pytest.approx(800 / float(away.square().sum()), rel=2e-3)
    v, u = divmod(int(image.argmax()), SMALL_VIEW.width)
    uv, _ = SMALL_VIEW.project(source.position_at(0.0)[:, None])
    assert abs(u + 0.5 - float(uv[0])) <= 0.5 and abs(v + 0.5 - float(uv[1])) <= 0.5


def test_a_near_lamp_looks_as_wide_as_it_is():
    source = oncoming(position_m=(3.4, 0.0, 1.35), diameter_m=0.3)  # 5 m before the camera: 36 px
    image = glare(SMALL_VIEW, source.position_at(0.0), source)
    u = torch.arange(SMALL_VIEW.width) + 0.5 - SMALL_VIEW.cx
    spread_px = float(((image.sum(0) * u.square()).sum() / image.sum()).sqrt())
    # a disc's standard deviation along an axis is a quarter of its diameter; a pixel of blur adds 0.6 % to 9 of them
    assert spread_px == pytest.approx(SMALL_VIEW.fx * 0.3 / 5 / 4, rel=0.02)


def test_the_veil_follows_the_disability_glare_formula(device):
    source = oncoming(veil=0.2, intensity_cd=1e4, position_m=(38.4, 0.0, 1.35))  # on the axis, 40 m from the camera
    image = glare(SMALL_VIEW, source.position_at(0.0), source, device)
    for column in (200, 250, 319):
        theta = math.degrees(math.atan(math.hypot(column + 0.5 - 160, 0.5) / SMALL_VIEW.fx))
        assert float(image[90, column]) == pytest.approx(0.2 * 10 * (1e4 / 40**2) / theta**2, rel=1e-4)


def test_a_lamp_that_drives_past_is_gone():
    source = oncoming(velocity_m_s=(-20.0, 0.0, 0.0), veil=1.0)
    columns = [int(glare(SMALL_VIEW, source.position_at(t), source).max(0).values.argmax()) for t in (0.0, 1.0, 1.5)]
    assert columns[0] > columns[1] > columns[2]  # it lies to the left and comes nearer
    assert not glare(SMALL_VIEW, source.position_at(2.5), source).any()
