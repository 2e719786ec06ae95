"""Zones: what they measure, what they ask for, and that the loop comes to its target over every reflectance."""

import math
from dataclasses import replace

import cv2
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from luxloop.controllers.functions.zone import ZoneParams, box_region
from luxloop.controllers.pixels.primitives import E_V
from luxloop.controllers.pixels.secondary import PotentialLight
from luxloop.controllers.situation import CameraImage, Situation
from luxloop.perception.camera import CameraParams, camera_view, expose, luminance_of, saturation_luminance
from luxloop.perception.noise import FrameNoise
from luxloop.world.frames import pose_from_degrees, transform
from luxloop.world.lamps.presets import idealised
from tests.controllers.situations import HERE, LAMPS, now

CAMERA = CameraParams(width_px=160, height_px=90, saturation_e=2000)
VIEW = camera_view(CAMERA)
WALL = {"centre_m": (20.0, 0.0, 1.0), "size_m": (0.0, 2.0, 1.5), "luminance_cd_m2": 0.5}


def measured(luminance: float, step: int) -> Situation:
    """Everything as bright as that, with the camera's noise."""
    digital = expose(torch.full((90, 160), luminance), CAMERA, FrameNoise.of(0, step, 0))
    seen = CameraImage(step / 30, VIEW, luminance_of(digital, CAMERA), saturation_luminance(CAMERA))
    return Situation(step / 30, HERE, LAMPS, seen=seen)


def courses(reflectance: float, ambient_lx: float, zone: ZoneParams) -> list[float]:
    """Luminance of a diffuse wall in 11 steps."""
    state, found = zone.start(), []
    for step in range(11):
        found.append(reflectance / math.pi * (state.lx + ambient_lx))
        state = zone.step(state, measured(found[-1], step))
    return found


@settings(max_examples=25)
@given(reflectance=st.floats(0.05, 0.8), ambient_lx=st.floats(0.0, 0.3), target=st.floats(0.05, 1.5))
def test_a_zone_comes_within_5_percent_in_10_steps_over_all_reflectances(reflectance, ambient_lx, target):
    zone = ZoneParams(**WALL | {"luminance_cd_m2": target})
    if reflectance / math.pi * ambient_lx > 0.9 * target:
        return  # the lamps cannot take light away
    luminance = courses(reflectance, ambient_lx, zone)
    assert luminance[10] == pytest.approx(target, rel=0.05)


def test_what_no_lamp_can_give_does_not_wind_up():
    grid = idealised(40, 80)
    lights = (
        ("left", PotentialLight.of(grid, pose_from_degrees((0, 0.6, 0.75)))),
        ("right", PotentialLight.of(grid, pose_from_degrees((0, -0.6, 0.75)))),
    )
    zone, alone = ZoneParams(**WALL | {"luminance_cd_m2": 1e6}), ZoneParams(**WALL | {"luminance_cd_m2": 1e6, "modules": ("left",)})
    lx = {}
    for each in (zone, alone):
        state = each.start()
        for step in range(20):
            state = each.step(state, replace(measured(0.2, step), lights=lights))
        lx[each] = state.lx
        back = each.model_copy(update={"luminance_cd_m2": 0.1}).step(state, measured(0.2, 20))
        assert back.lx < 0.7 * state.lx  # at once
    # 400 m^2, face on: what the idealised lamp shines straight ahead, within what its beam falls off over the zone
    assert lx[alone] == pytest.approx(float(lights[0][1].full.max()) / 400, rel=0.1)
    assert lx[zone] == pytest.approx(2 * lx[alone], rel=0.01)


def test_more_than_the_camera_can_measure_is_not_asked_for():
    zone = ZoneParams(**WALL | {"luminance_cd_m2": 2 * saturation_luminance(CAMERA)})
    state = zone.start()
    assert zone.step(state, measured(100.0, 0)).lx == pytest.approx(state.lx)
    bright = ZoneParams(**WALL)
    assert bright.step(bright.start(), measured(100.0, 0)).lx < 0.5  # too bright by more than can be said, but too bright


def test_a_zone_that_is_not_in_the_image_keeps_its_light():
    zone = ZoneParams(**WALL | {"centre_m": (-20.0, 0.0, 1.0)})
    state = zone.start()
    assert zone.step(state, measured(0.1, 0)) is state
    assert zone.step(state, now()) is state


@pytest.mark.parametrize("size_m", [(0.0, 2.0, 1.5), (3.0, 2.0, 0.0), (2.0, 0.0, 1.0), (1.0, 2.0, 1.5)])
def test_light_is_asked_for_on_the_side_that_looks_at_the_lamps(size_m):
    zone = ZoneParams(**WALL | {"size_m": size_m, "centre_m": (20.0, 4.0, 0.2), "yaw_deg": 30.0})
    (light,) = zone.adapted(zone.start(), now())
    middle = light.corners()[0].mean(0)
    torch.testing.assert_close(middle, torch.tensor(zone.centre_m, dtype=torch.float64))
    assert (LAMPS.mean(0) - middle) @ light.normal[0] > 0
    assert float(light.value) == zone.start_lx and int(light.quantity) == E_V


def test_the_region_of_a_box_is_the_hull_of_its_corners():
    T, high = pose_from_degrees((15.0, 1.0, 0.5), 10, 20, 40), torch.tensor([1.0, 0.7, 0.4], dtype=torch.float64)
    region = box_region(VIEW, T, -high, high)
    signs = torch.tensor([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], dtype=torch.float64).T
    uv, _ = VIEW.project(transform(T, signs * high[:, None]))
    hull = cv2.convexHull(uv.T.float().numpy())
    centres = torch.stack(torch.meshgrid(torch.arange(160.0) + 0.5, torch.arange(90.0) + 0.5, indexing="xy"), -1)
    inside = [cv2.pointPolygonTest(hull, (float(u), float(v)), True) for u, v in centres.flatten(0, 1)]
    distance = torch.tensor(inside).view(90, 160)
    clear = distance.abs() > 1e-3  # px from the border, where rounding decides
    assert torch.equal(region[clear], distance[clear] > 0) and 50 < int(region.sum()) < 5000


@pytest.mark.parametrize(("key", "value"), [("size_m", (0.0, 2.0, 0.0)), ("size_m", (-1.0, 2.0, 1.0)), ("luminance_cd_m2", 0.0)])
def test_zones_that_are_none_are_refused(key, value):
    with pytest.raises(ValidationError, match=key):
        ZoneParams(**WALL | {key: value})


def test_a_flat_zone_on_the_road_is_seen_where_it_lies():
    region = box_region(VIEW, HERE, torch.tensor([10.0, -1.0, 0.0]), torch.tensor([20.0, 1.0, 0.0]))
    rows = torch.nonzero(region.any(1))[:, 0]
    for row, x in ((rows[0], 20.0), (rows[-1], 10.0)):
        _, v = VIEW.project(torch.tensor([[x], [0.0], [0.0]], dtype=torch.float64))[0][:, 0]
        assert abs(float(row) + 0.5 - float(v)) < 1  # px
