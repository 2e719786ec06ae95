"""A rig without faults shows what the simulated plant shows, and each fault does what it says."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.rig.simulated.camera import read_out
from luxloop.loop.rig.simulated.faults import FaultParams, ScreenParams
from luxloop.loop.rig.simulated.scene import RigScene, gloss
from luxloop.loop.rig.wire.ddp import LightFrame
from luxloop.loop.scenario.model import load
from luxloop.loop.scenario.shipped import examples
from luxloop.loop.simulation.simulated import simulated_plant
from luxloop.loop.simulation.truth import LampModule
from luxloop.world.headlight.lamp import ModuleCommand
from tests.loop.rig.simulated.conftest import faults_of, light, scenario_of, seen_px

Images = Callable[..., np.ndarray]


@pytest.mark.parametrize("air", [(), ("air=[{ visibility_m = 50.0 }]",)])
def test_without_faults_its_frames_are_the_plants(pattern, air):
    scenario = scenario_of("camera.noise=false", *air)
    rig_scene = RigScene(scenario, faults_of("camera.columns=1"))
    given = tuple(LampModule(each.name, each.headlight, each.T_body_headlight) for each in rig_scene.modules)
    plant = simulated_plant(scenario, given)
    lights = (Utilisation(torch.from_numpy(pattern).float() / 255, None),)
    expected = plant.exposed(*plant.world.luminance(0.0, lights), 0, 0).numpy()
    codes = read_out(rig_scene.base(0.0) + rig_scene.light(light(pattern), 0.0), rig_scene.camera, FaultParams(), 0)
    assert abs(codes - expected).max() <= 1, "but for rounding: the lamp's light is added to the rest"


def test_light_adds_up(rig_scene, pattern):
    half = np.where(np.arange(rig_scene.pixels) % 2, pattern, 0).astype(np.uint8)
    whole, one, other = (rig_scene.light(light(each), 0.0) for each in (pattern, half, pattern - half))
    assert np.allclose(whole, one + other, rtol=1e-4, atol=1e-5)
    assert rig_scene.light(light(pattern), 0.0) is whole, "and is computed once"


def test_a_lamp_is_as_wrong_as_it_is_said_to_be(rig_scene, pattern, image_with):
    right = rig_scene.light(light(pattern), 0.0)
    assert np.allclose(image_with("lamp.scale=1.1"), 1.1 * right, rtol=1e-4)
    assert image_with("lamp.dead=0.5").sum() / right.sum() == pytest.approx(0.5, abs=0.1)
    dark = light(0 * pattern)
    glowing = RigScene(scenario_of(), faults_of("lamp.stuck=0.1")).light(dark, 0.0)
    full = rig_scene.light(light(np.full_like(pattern, 255)), 0.0)
    assert glowing.sum() / full.sum() == pytest.approx(0.1, abs=0.03) and not rig_scene.light(dark, 0.0).any()
    down, rows = image_with("lamp.pitch_deg=0.5"), np.arange(120)[:, None]
    assert (right * rows).sum() / right.sum() < (down * rows).sum() / down.sum()
    squared = light(np.uint16(np.rint(65535 * (pattern / 255.0) ** 2)))
    assert np.allclose(image_with("light.gamma=2.0"), rig_scene.light(squared, 0.0), atol=1e-3)


def test_modules_are_turned_and_dimmed(rig_scene, pattern):
    right = rig_scene.light(light(pattern), 0.0)
    dimmed = rig_scene.light(LightFrame(pattern, (1,), (ModuleCommand(intensity=0.25),)), 0.0)
    assert np.allclose(dimmed, right / 4, rtol=2e-2, atol=1e-3)
    left = rig_scene.light(LightFrame(pattern, (1,), (ModuleCommand(swivel_deg=2.0),)), 0.0)
    columns = np.arange(160)
    assert (left * columns).sum() / left.sum() < (right * columns).sum() / right.sum() - 3, "2 deg are 8 px, of which the border takes some"
    assert np.allclose(rig_scene.light(light(pattern), 0.0), right), "and go back"


def test_a_glossy_screen_shines_in_the_mirror_direction():
    params = ScreenParams(gloss=2.0, gloss_width_deg=10)
    y = torch.linspace(-2, 2, 81)
    position = torch.stack([torch.full_like(y, 3.0), y, torch.zeros_like(y)])[:, None]
    normal = torch.tensor([-1.0, 0, 0])[:, None, None].expand_as(position)
    factor = gloss(params, position, normal, torch.tensor([0.0, 1.0, 0.0]), torch.tensor([0.0, -1.0, 0.0]))[0]
    assert factor.argmax() == 40 and float(factor[40]) == pytest.approx(3.0, rel=1e-5)
    assert float(factor[0]) < 1.1 and torch.allclose(factor, factor.flip(0), rtol=1e-4)


def test_a_lamp_pixel_is_seen_where_the_truth_says():
    """The rig's matrix, coefficients and poses as OpenCV takes them, pixel centres at integer + 0.5."""
    keys = ["camera.width_px=320", "camera.height_px=240", "light.ambient_lx=0"]
    faults = faults_of(
        "lens.coefficients=[-0.3, 0.1, 0.002, -0.003, 0.05]", "lens.centre_px=[5, -8]", "lamp.yaw_deg=0.4", "camera.columns=4"
    )
    rig_scene = RigScene(load(str(examples()["rig_wall.toml"]), keys), faults)
    head = rig_scene.modules[0].headlight
    for row, column in ((20, 60), (166, 512), (300, 980)):
        codes = np.zeros((head.pixel_rows, head.pixel_cols), np.uint8)
        codes[row - 8 : row + 8, column - 8 : column + 8] = 255
        image = rig_scene.light(light(codes.ravel()), 0.0)
        v, u = np.mgrid[:240, :320] + 0.5
        seen = np.array([(image * u).sum(), (image * v).sum()]) / image.sum()
        y = head.left + (head.right - head.left) * column / head.pixel_cols
        z = head.top + (head.bottom - head.top) * row / head.pixel_rows
        expected = seen_px(rig_scene, np.array([y]), np.array([z]), 4.0)[0]
        assert abs(seen - expected).max() < 0.1, (row, column)  # px; with one sample over a pixel's width it can be 0.3
