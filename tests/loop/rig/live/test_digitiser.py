"""From a picture of the screen to the light texture that was there."""

from dataclasses import replace

import numpy as np
import torch
from rig_bench import OpticalSetup, lens_setup
from torch.testing import assert_close

from luxloop.loop.rig.calibration.geometry import CameraModel
from luxloop.loop.rig.calibration.intrinsics import brightness
from luxloop.loop.rig.calibration.setups import simulated_setup
from luxloop.loop.rig.live.plant import Beam, Digitiser, luminous
from tests.loop.rig.live.walls import LAMP, blob, calibration, module, off_by, wall
from tests.refusal import refusal

GOAL = 0.03  # of the request; what is left is the camera's noise, 1 to 2 %, and its pixels' width at edges


def test_lens_response_vignetting_and_other_light_are_taken_off():
    scenario, lamp = wall(ambient_lx=100.0, gamma=2.2), module()
    pinhole = CameraModel.of(scenario.camera)
    lens = pinhole.with_values(np.array([*pinhole.values[:4], -0.8, 0.4, 0.002, -0.001, 0.0]))

    def straight(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rays, (fx, fy, cx, cy) = lens.rays(u, v), pinhole.values[:4]
        return cx + fx * rays[..., 0], cy + fy * rays[..., 1]

    darkening = np.array([-0.3, 0.0, 0.0])
    shade = brightness(darkening, 120, 160)
    setup = OpticalSetup(**vars(lens_setup(scenario, lamp, straight)), optics=lambda luminance: luminance * shade)
    known = replace(calibration(setup.camera, lamp, lens), vignetting=darkening)
    reader = Digitiser.of(known, lamp.name, LAMP)
    exposure_s = setup.camera.exposure_s
    picture = setup.frames([blob()], 1, exposure_s)[0]
    assert off_by(reader.texture(picture), LAMP, blob()) > 2 * GOAL  # other light is in it
    dark = setup.frames([np.zeros(LAMP.n_pixels)], 8, exposure_s)
    assert off_by(reader.without(dark).texture(picture), LAMP, blob()) < GOAL
    assert reader.coverage == 1 and reader.saturation(picture) == 0


def test_colour_is_kept_and_its_luminance_is_the_light():
    scenario, lamp = wall(), module()
    setup = simulated_setup(scenario, [lamp])
    reader = Digitiser.of(calibration(setup.camera, lamp), lamp.name, LAMP)
    grey = setup.frames([blob()], 1, setup.camera.exposure_s)[0]
    white = reader.texture(np.stack([grey] * 3, -1))
    assert white.shape == (3, LAMP.rows, LAMP.cols)
    assert_close(luminous(white), reader.texture(grey))
    red = reader.texture(np.stack([0 * grey, 0 * grey, grey], -1))  # OpenCV's order
    assert_close(red[0], white[0])
    assert not red[1:].any()
    assert_close(luminous(red), 0.2126 * reader.texture(grey))


def test_what_does_not_fit_is_refused():
    scenario, lamp = wall(), module()
    known = calibration(scenario.camera, lamp)
    reader = Digitiser.of(known, lamp.name, LAMP)
    with refusal("is of 160 x 120 px, but the camera has 80 x 60"):
        reader.texture(np.zeros((60, 80), np.uint16))
    with refusal("numbers up to 4095, but the camera gives 9000"):
        reader.texture(np.full((120, 160), 9000, np.uint16))
    with refusal("has no scale; run `luxloop rig calibrate` again"):
        Digitiser.of(replace(known, lux=None), lamp.name, LAMP)
    with refusal("knows the modules left matrix, not 'right matrix'"):
        Digitiser.of(known, "right matrix", LAMP)
    aside = wall(yaw_deg=4.0).camera
    with refusal(r"sees [1-4]?[0-9]% of the light of 'left matrix' on the screen"):
        Digitiser.of(calibration(aside, lamp), lamp.name, LAMP)


def test_late_light_follows_darkness_in_its_order():
    dark, first, second = (torch.full((2, 3), float(k)) for k in range(3))
    beam = Beam(2, dark)
    came = [beam.take(each) for each in (first, None, second)]
    assert all(a is b for a, b in zip(came, (dark, dark, first), strict=True))
    assert beam.take(second) is None, "of the lost frame"
