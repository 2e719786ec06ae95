"""Scenarios run, are recorded as they went, and replay."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from luxloop import Simulation, run
from luxloop.controllers.functions.base_beams import BaseBeam
from luxloop.loop.report.picture import camera_luminance
from luxloop.perception.camera import noise_std
from tests.loop.conftest import scenario_of, simulated, toml, van
from tests.refusal import sentence

BOX = van((40.0, 3.0, 180.0), (30.0, 3.0, 180.0))


LIT = """
name = "lit"
steps = 3
rate_hz = 5
renderer = "raycast"
headlight.model = "hd84"
camera = { width_px = 160, height_px = 90 }
surface.grain = 0.0
lighting.base.beam = "high"
functions.guard.kind = "glare_free"
"""


def lit(*overrides: str, **changes: Any) -> Simulation:
    return simulated(LIT, *overrides, **{"objects": [BOX], **changes})


def test_objects_on_a_road_are_seen_and_tracked_at_its_height():
    """On 5 % from 10 m on after a curve of 4 m, 40 m ahead is 1.4 m up, and the van sinks by 0.5 m on its way of 10 m."""
    road = toml("{ kind = 'grade', grade_percent = 5.0, crossfall_percent = 0.0, start_x_m = 10.0 }")
    simulation = lit(road=road, objects=[BOX | {"on_road": True}])
    assert not torch.equal(simulation.world.scene.at(0.0).placed[1].T_world_body, simulation.world.scene.at(1.0).placed[1].T_world_body)
    for t_s, height_m in ((0.0, 1.4), (1.0, 0.9)):
        (van,) = simulation.situation(t_s).objects
        foot = simulation.world.scene.at(t_s).placed[1].corners[..., 2].min()
        assert float(van.T_world_object[2, 3]) == pytest.approx(height_m, abs=1e-9) == float(foot)
    (sunk,) = lit(road=road).situation(0.0).objects
    assert float(sunk.T_world_object[2, 3]) == 0


def test_a_beam_leaves_the_rest_of_its_share_to_another():
    def u(*keys: str) -> torch.Tensor:
        simulation = lit(*(f"lighting.base.{key}" for key in keys), functions={})
        return simulation.modules[0].base(simulation.planner.plan(simulation.situation(0.0)))

    high, low, mixed = u(), u("beam=low"), u("rest=low", "share=0.3")
    torch.testing.assert_close(mixed, 0.3 * high + 0.7 * low)
    assert torch.equal(u("share=0.3"), 0.3 * high) and torch.equal(u("beam=off", "rest=low", "share=0"), low)
    bent = u("rest=low", "share=0.3", "bend_deg=5")
    torch.testing.assert_close(bent, 0.3 * u("bend_deg=5") + 0.7 * u("beam=low", "bend_deg=5"))
    result = lit("lighting.base.rest=low", "lighting.base.beam=off", "lighting.base.share=0.5", functions={}).at(0)
    assert result.plan.base.shares == " at 50 %, low beam at 50 %" and float(result.illuminance.max()) > 0


def test_rules_judge_the_beam_with_its_rest_and_undimmed_without():
    beam = BaseBeam("high", share=0.3)
    assert beam.undimmed == BaseBeam("high") and replace(beam, rest="low").undimmed.share == 0.3


def test_pictures_have_the_cameras_noise_and_measured_light_has_none():
    noisy, other, still = (lit(*each) for each in ((), ("seed=1",), ("camera.noise=false",)))
    result, camera = noisy.at(1), noisy.scenario.camera
    assert torch.equal(result.luminance, other.at(1).luminance) and torch.equal(result.illuminance, other.at(1).illuminance)
    image, exact = camera_luminance(result, noisy), result.luminance
    assert torch.equal(image, camera_luminance(result, noisy)) and not torch.equal(image, camera_luminance(other.at(1), other))
    clear = (exact > 0.03) & (exact < 0.8)  # ten standard deviations of the read noise from black, and as far from saturation
    z = ((image - exact) / noise_std(exact, camera))[clear]
    assert len(z) > 1000 and float(z.mean()) == pytest.approx(0, abs=5 / len(z) ** 0.5)  # five standard errors, as the next
    assert float(z.std()) == pytest.approx(1, abs=5 / (2 * len(z)) ** 0.5)
    level = 1.34 / (2**camera.bits - 1)  # cd/m^2
    torch.testing.assert_close(camera_luminance(still.at(1), still)[clear], exact[clear], rtol=0, atol=0.51 * level)


def test_functions_without_effect_are_told(tmp_path):
    beside = "functions.far={ kind='symbol', image='snowflake', y_m=60.0 }"  # beside all light
    late = "functions.late={ kind='glare_free', categories=['truck'] }"
    summary = run(scenario_of(LIT, beside, late, "steps=1", objects=[BOX]), tmp_path / "lit", video=False, report=False).summary
    assert summary["idle_functions"] == ["functions.far (symbol)", "functions.late (glare_free)"]


def test_light_on_an_object_is_that_of_the_law_of_distances():
    """An upright plate far ahead, in the full beam of one lamp: E = I / d^2 within what its extent makes of it."""
    plate = BOX | toml("{ name = 'plate', size_m = [0.02, 0.2, 0.2], track = [{ position_m = [20, 0, 0.65] }] }")
    one = ("lighting.base.beam=full", "headlight={ model='hd84', lamps=['left'], distance_m=0.0 }", "functions={}")
    simulation = lit(*one, "camera={ width_px=320, height_px=180, hfov_deg=3, pitch_deg=1.7 }", objects=[plate])
    light = simulation.at(0).objects["plate"]
    headlight = simulation.modules[0].headlight
    ahead = headlight.intensity(headlight.light_texture(torch.ones(84)), torch.tensor([[1.0], [0.0], [0.0]]))
    assert light.pixels > 50 and not light.masked
    assert light.lx_mean == pytest.approx(float(ahead) / 19.99**2, rel=0.05)  # the beam's slope over 0.6 deg
    assert light.lx_min <= light.lx_mean <= light.lx_max


def test_an_object_appears_to_the_tracker_when_it_does_in_the_scene():
    results = list(lit("steps=4", objects=[BOX | {"appears_s": 0.3, "vanishes_s": 0.5}]).evaluations())
    seen = [(result.objects["van"].pixels > 0, result.objects["van"].masked) for result in results]
    assert seen == [(step == 2, step == 2) for step in range(4)] and results[0].dark_lx_max is None


def test_what_stands_still_is_rendered_once():
    simulation = lit(objects=[])
    assert simulation.world.lit(0.0) is simulation.world.lit(5.0)
    torch.testing.assert_close(simulation.at(0).illuminance, simulation.at(2).illuminance)


def test_conditions_hold_until_the_next():
    timeline = scenario_of(LIT, "conditions=[{ time_s=1, wet=true }, { time_s=3, street_lit=true }]")
    assert [timeline.conditions_at(time_s).wet for time_s in (0.0, 1.0, 2.9, 3.0, 9.0)] == [True, True, True, False, False]


WRONG = {
    "functions.own.modules": "functions.own={ kind='lane', modules=['hires'] }",
    "functions.own.names": "functions.own={ kind='glare_free', names=['bus'] }",
    "functions.own.observer.name": "functions.own={ kind='symbol', image='snowflake', observer.name='x' }",
    "functions.own: ": "functions.own={ kind='symbol', image='snowflake', observer.centre_m=[10, 0, 2] }",  # its picture is too high
    "headlight.modules": "headlight.modules=['lores']",
}


@pytest.mark.parametrize(("key", "override"), WRONG.items())
def test_what_is_not_there_is_named_in_a_sentence(key, override):
    with sentence(key):
        lit(override)
