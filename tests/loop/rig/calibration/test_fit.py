"""Values of a scenario are found again in the frames of another one."""

from collections.abc import Mapping

import pytest
import torch
from scipy.ndimage import gaussian_filter

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.rig.calibration.twin import BLUR, RecordedExposure, fit
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.scenario.overrides import overridden
from luxloop.loop.simulation.lamps import lamp_modules, mount
from luxloop.loop.simulation.protocol import Exposure
from luxloop.loop.simulation.simulated import simulated_plant
from luxloop.perception.camera import expose
from luxloop.perception.noise import FrameNoise
from tests.refusal import refusal


def scenario_with(values: Mapping[str, float]) -> Scenario:
    """A lamp of 3 x 28 pixels before a screen, seen in 160 x 90 px."""
    screen = {"kind": "box", "name": "screen", "size_m": [0.1, 9.0, 6.0], "track": [{"position_m": [6.0, 0.0, -2.0]}]}
    scenario = {
        "name": "wall",
        "steps": 1,
        "renderer": "raycast",
        "surface": {"grain": 0.0},
        "headlight": {"model": "hd84", "lamps": ["left"]},
        "camera": {"width_px": 160, "height_px": 90, "exposure_s": 1e-3, "oversampling": 2},
        "objects": [screen],
    }
    data = overridden(validate(scenario, "wall").model_dump(mode="json"), [f"{key}={value!r}" for key, value in values.items()])
    return validate(data, "wall")


def shown(values: Mapping[str, float], blur_px: float = 0.0) -> list[RecordedExposure]:
    """Frames of a rig with these values, of two lights."""
    scenario = scenario_with(values)
    modules = lamp_modules(mount(scenario.headlight))
    world = simulated_plant(scenario, modules).world
    found = []
    for number in range(2):
        n = [each.headlight.n_pixels for each in modules]
        lights = tuple(Utilisation((torch.arange(k) // 3 % 2 == number).float()) for k in n)
        luminance = world.luminance(0.0, lights)[0].double().numpy()
        luminance = gaussian_filter(luminance, blur_px) if blur_px else luminance
        image = expose(torch.from_numpy(luminance).float(), world.camera, FrameNoise.of(1, number, 0))
        found.append((Exposure(0, 0.0, 0.0, lights), image))
    return found


def test_values_are_found_with_their_uncertainty():
    true = {"camera.pitch_deg": 3.2, "objects[0].albedo": 0.23}
    found = fit(
        scenario_with,
        shown(true, blur_px=0.8),
        {"camera.pitch_deg": 0.3, "objects[0].albedo": 0.05, BLUR: 1.0},
    )
    for key, value in {**true, BLUR: 0.8}.items():
        assert found.stds[key] > 0
        # Noise that is cut off at black makes dark pixels a little brighter than the fit has them.
        assert found.values[key] == pytest.approx(value, abs=max(5 * found.stds[key], 0.02 * value))
    assert found.after["rmse"] < 0.3 * found.before["rmse"]
    assert found.after["ssim"] > found.before["ssim"]


def test_uncertainty_covers_what_is_not_fitted_and_the_residual_tells_of_it():
    true = {"camera.x_m": -1.55, "camera.roll_deg": 0.3}
    found = fit(scenario_with, shown(true), {"camera.x_m": 0.1, "camera.z_m": 0.05})
    left = {"camera.x_m": found.values["camera.x_m"] + 1.55, "camera.z_m": found.values["camera.z_m"] - 1.35}
    # The camera's roll, which is not fitted, moves them by up to four standard deviations of independent pixels.
    assert all(abs(each) < 1.5 * found.stds[key] for key, each in left.items())
    assert found.after["rmse"] > 1.2 * found.noise


@pytest.mark.parametrize(
    ("key", "told"),
    [("camera.pich_deg", "has no number there"), ("headlight.model", "is not a number, and only numbers can be varied")],
)
def test_what_cannot_be_fitted_is_named(key, told):
    with refusal(told):
        fit(scenario_with, shown({}), {key: 0.1})
