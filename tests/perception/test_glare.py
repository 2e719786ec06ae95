"""Oncoming headlamps in the camera's image."""

import math

import pytest
import torch

from luxloop.perception.camera import CameraParams, OncomingParams, camera_view, glare

VIEW = camera_view(CameraParams(width_px=320, height_px=180, pitch_deg=0.0))
PIXEL_SR = 1 / VIEW.fx**2  # of a pixel in the middle


def lamp(**keys: object) -> OncomingParams:
    return OncomingParams.model_validate({"position_m": (40.0, 0.5, 1.0), "veil": 0.0} | keys)


@pytest.mark.parametrize("diameter_m", [0.1, 1.0])
def test_the_image_holds_the_illuminance_at_the_camera(diameter_m: float, device: torch.device) -> None:
    source = lamp(diameter_m=diameter_m, intensity_cd=800.0)
    image = glare(VIEW, source.position_at(0.0), source, device)
    away = source.position_at(0.0) - VIEW.origin
    # at 0.7 deg from the axis a pixel's solid angle is 0.02 % smaller; sampling a Gaussian at its own width costs as little
    assert float(image.sum()) * PIXEL_SR == pytest.approx(800 / float(away.square().sum()), rel=2e-3)
    v, u = divmod(int(image.argmax()), VIEW.width)
    uv, _ = VIEW.project(source.position_at(0.0)[:, None])
    assert abs(u + 0.5 - float(uv[0])) <= 0.5 and abs(v + 0.5 - float(uv[1])) <= 0.5


def test_a_near_lamp_looks_as_wide_as_it_is() -> None:
    source = lamp(position_m=(3.4, 0.0, 1.35), diameter_m=0.3)  # 5 m before the camera: 36 px
    image = glare(VIEW, source.position_at(0.0), source)
    u = torch.arange(VIEW.width) + 0.5 - VIEW.cx
    spread_px = float(((image.sum(0) * u.square()).sum() / image.sum()).sqrt())
    # a disc's standard deviation along an axis is a quarter of its diameter; a pixel of blur adds 0.6 % to 9 of them
    assert spread_px == pytest.approx(VIEW.fx * 0.3 / 5 / 4, rel=0.02)


def test_the_veil_follows_the_disability_glare_formula(device: torch.device) -> None:
    source = lamp(veil=0.2, intensity_cd=1e4, position_m=(38.4, 0.0, 1.35))  # on the axis, 40 m from the camera
    image = glare(VIEW, source.position_at(0.0), source, device)
    for column in (200, 250, 319):
        theta = math.degrees(math.atan(math.hypot(column + 0.5 - 160, 0.5) / VIEW.fx))
        assert float(image[90, column]) == pytest.approx(0.2 * 10 * (1e4 / 40**2) / theta**2, rel=1e-4)


def test_a_lamp_that_drives_past_is_gone() -> None:
    source = lamp(velocity_m_s=(-20.0, 0.0, 0.0), veil=1.0)
    columns = [int(glare(VIEW, source.position_at(t), source).max(0).values.argmax()) for t in (0.0, 1.0, 1.5)]
    assert columns[0] > columns[1] > columns[2]  # it lies to the left and comes nearer
    assert not glare(VIEW, source.position_at(2.5), source).any()
