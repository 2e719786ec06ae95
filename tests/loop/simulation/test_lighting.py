"""Scenarios run, are recorded as they went, and replay."""

from pathlib import Path
from typing import Any

import pytest
import torch

from luxloop.loop.report.picture import camera_luminance
from luxloop.loop.run import run
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.perception.camera import noise_std
from luxloop.world.errors import LuxloopError
from tests.loop.conftest import simulation_of

BOX = {
    "kind": "box",
    "name": "van",
    "category": "car",
    "size_m": [4.5, 1.8, 1.9],
    "track": [{"time_s": 0, "position_m": [40, 3, 0], "yaw_deg": 180}, {"time_s": 1, "position_m": [30, 3, 0], "yaw_deg": 180}],
}
CAMERA = {"width_px": 160, "height_px": 90}
GLARE_FREE = {"kind": "glare_free"}
SYMBOL = {"kind": "symbol", "image": "snowflake"}


def scenario(**changes: Any) -> Scenario:
    base = {
        "name": "lit",
        "steps": 3,
        "rate_hz": 5,
        "headlight": {"model": "hd84"},
        "camera": CAMERA,
        "surface": {"grain": 0.0},
        "objects": [BOX],
        "lighting": {"base": {"beam": "high"}},
        "functions": {"guard": GLARE_FREE},
        "renderer": "raycast",
    }
    return validate(base | changes, "lit")


def test_objects_on_a_road_are_seen_and_tracked_at_its_height() -> None:
    """On 5 % from 10 m on after a curve of 4 m, 40 m ahead is 1.4 m up, and the van sinks by 0.5 m on its way of 10 m."""
    road = {"kind": "grade", "grade_percent": 5.0, "crossfall_percent": 0.0, "start_x_m": 10.0}
    simulation = simulation_of(scenario(road=road, objects=[BOX | {"on_road": True}]))
    assert not torch.equal(simulation.world.scene.at(0.0).placed[1].T_world_body, simulation.world.scene.at(1.0).placed[1].T_world_body)
    for t_s, height_m in ((0.0, 1.4), (1.0, 0.9)):
        (van,) = simulation.situation(t_s).objects
        foot = simulation.world.scene.at(t_s).placed[1].corners[..., 2].min()
        assert float(van.T_world_object[2, 3]) == pytest.approx(height_m, abs=1e-9) == float(foot)
    (sunk,) = simulation_of(scenario(road=road)).situation(0.0).objects
    assert float(sunk.T_world_object[2, 3]) == 0


def test_pictures_have_the_cameras_noise_and_measured_light_has_none() -> None:
    noisy, other, still = (simulation_of(scenario(**each)) for each in ({}, {"seed": 1}, {"camera": {**CAMERA, "noise": False}}))
    result, camera = noisy.at(1), noisy.scenario.camera
    assert torch.equal(result.luminance, other.at(1).luminance) and torch.equal(result.illuminance, other.at(1).illuminance)
    image, exact = camera_luminance(result, noisy), result.luminance
    assert torch.equal(image, camera_luminance(result, noisy)) and not torch.equal(image, camera_luminance(other.at(1), other))
    lit = (exact > 0.03) & (exact < 0.8)  # ten standard deviations of the read noise from black, and as far from saturation
    z = ((image - exact) / noise_std(exact, camera))[lit]
    assert len(z) > 1000 and float(z.mean()) == pytest.approx(0, abs=5 / len(z) ** 0.5)  # five standard errors, as the next
    assert float(z.std()) == pytest.approx(1, abs=5 / (2 * len(z)) ** 0.5)
    level = 1.34 / (2**camera.bits - 1)  # cd/m^2
    torch.testing.assert_close(camera_luminance(still.at(1), still)[lit], exact[lit], rtol=0, atol=0.51 * level)


def test_functions_without_effect_are_told(tmp_path: Path) -> None:
    far = {"kind": "symbol", "image": "snowflake", "y_m": 60.0}  # beside all light
    late = {"kind": "glare_free", "categories": ["truck"]}
    told = run(
        scenario(steps=1, functions={"guard": GLARE_FREE, "far": far, "late": late}), tmp_path / "lit", video=False, report=False
    ).summary
    assert told["idle_functions"] == ["functions.far (symbol)", "functions.late (glare_free)"]


def test_light_on_an_object_is_that_of_the_law_of_distances() -> None:
    """An upright plate far ahead, in the full beam of one lamp: E = I / d^2 within what its extent makes of it."""
    plate = BOX | {"name": "plate", "size_m": [0.02, 0.2, 0.2], "track": [{"position_m": [20, 0, 0.65]}]}
    simulation = simulation_of(
        scenario(
            headlight={"model": "hd84", "lamps": ["left"], "distance_m": 0.0},
            objects=[plate],
            lighting={"base": {"beam": "full"}},
            functions={},
            camera={"width_px": 320, "height_px": 180, "hfov_deg": 3, "pitch_deg": 1.7},
        )
    )
    light = simulation.at(0).objects["plate"]
    module = simulation.modules[0]
    ahead = module.headlight.intensity(module.headlight.light_texture(torch.ones(84)), torch.tensor([[1.0], [0.0], [0.0]]))
    assert light.pixels > 50 and not light.masked
    assert light.lx_mean == pytest.approx(float(ahead) / 19.99**2, rel=0.05)  # the beam's slope over 0.6 deg
    assert light.lx_min <= light.lx_mean <= light.lx_max


def test_an_object_appears_to_the_tracker_when_it_does_in_the_scene() -> None:
    simulation = simulation_of(scenario(objects=[BOX | {"appears_s": 0.3, "vanishes_s": 0.5}], steps=4))
    results = list(simulation.evaluations())
    assert [result.objects["van"].pixels > 0 for result in results] == [False, False, True, False]
    assert [result.objects["van"].masked for result in results] == [False, False, True, False]
    assert results[0].dark_lx_max is None


def test_what_stands_still_is_rendered_once() -> None:
    simulation = simulation_of(scenario(objects=[]))
    assert simulation.world.lit(0.0) is simulation.world.lit(5.0)
    torch.testing.assert_close(simulation.at(0).illuminance, simulation.at(2).illuminance)


def test_conditions_hold_until_the_next() -> None:
    timeline = scenario(conditions=[{"time_s": 1, "wet": True}, {"time_s": 3, "street_lit": True}])
    assert [timeline.conditions_at(time_s).wet for time_s in (0.0, 1.0, 2.9, 3.0, 9.0)] == [True, True, True, False, False]


WRONG = {
    "module": ({"functions": {"own": {"kind": "lane", "modules": ["hires"]}}}, ["functions.own.modules", "'hires'", "left"]),
    "object": ({"functions": {"own": GLARE_FREE | {"names": ["bus"]}}}, ["functions.own.names", "'bus'", "van"]),
    "observer": ({"functions": {"own": SYMBOL | {"observer": {"name": "x"}}}}, ["functions.own.observer.name", "'x'", "van"]),
    "picture": ({"functions": {"own": SYMBOL | {"observer": {"centre_m": [10, 0, 2]}}}}, ["functions.own: ", "lower the picture"]),
    "lamp": ({"headlight": {"model": "hd84", "modules": ["lores"]}}, ["headlight.modules", "'hd84'", "'lores'", "matrix"]),
}


@pytest.mark.parametrize(("changes", "named"), WRONG.values(), ids=WRONG.keys())
def test_what_is_not_there_is_named_in_a_sentence(changes: dict[str, Any], named: list[str]) -> None:
    with pytest.raises(LuxloopError) as caught:
        simulation_of(scenario(**changes))
    assert all(part in str(caught.value) for part in named), caught.value
