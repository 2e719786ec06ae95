"""The simulated world of which a module is digitised, without a lamp: what it shines by, and what is refused."""

import math
from pathlib import Path

import pytest
import torch

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import load, validate
from luxloop.world.scene.vehicle import LateBody
from tests.loop.conftest import SMALL, assert_one_sentence
from tests.refusal import refusal


def test_the_world_is_lit_by_measured_light():
    """With the texture that the matrix would give, and with half of it."""
    simulated = prepare(validate(SMALL, "small"))
    digitised = prepare(validate({**SMALL, "modules": {"left": {"source": "digitised"}}}, "small"))
    plant = digitised.plant
    light = simulated.modules[0].headlight
    u = torch.zeros(light.n_pixels)
    u[7_500:12_500] = 0.5
    lights = (Utilisation(u, slice(7_500, 12_500)),)
    base = simulated.world.lit(0.0).base
    wanted = simulated.world.luminance(0.0, lights)[0] - base
    plant.measured.keep(u, 0.5 * light.light_texture(u))
    torch.testing.assert_close(plant.measured.light_texture(0.5 * u), light.light_texture(0.5 * u))  # which was not measured
    found = digitised.world.luminance(0.0, lights)[0] - base
    assert wanted.max() > 0.01
    torch.testing.assert_close(found, 0.5 * wanted, rtol=1e-3, atol=1e-4 * float(wanted.max()))


def test_the_body_is_late_and_the_way_is_not():
    keys = ("steps=4", "modules.left.source=digitised", "modules.left.latency_s=0.1")
    now, late = (load("driving", [*keys, f"modules.left.delay_body={each}", "renderer=raycast"]) for each in ("false", "true"))
    driven, delayed = (prepare(each).plant for each in (now, late))
    assert isinstance(delayed.night.world.motion, LateBody) and delayed.late == round(0.1 * now.rate_hz) * len(now.shares)
    a, b, before = driven.night.world.motion.at(0.15), delayed.night.world.motion.at(0.15), driven.night.world.motion.at(0.05)
    assert torch.equal(a.T_world_ground, b.T_world_ground) and torch.allclose(b.T_ground_body, before.T_ground_body, atol=1e-9)
    assert math.isclose(b.pitch_rad, before.pitch_rad, abs_tol=1e-9) and not math.isclose(b.pitch_rad, a.pitch_rad)
    felt = [[each.values.tolist() for each in plant.night.samples(0.15, 0.05)] for plant in (driven, delayed)]
    assert felt[0] and felt[0] == felt[1]


def test_without_a_rig_it_is_checked_and_not_run(lux):
    given = ("small.toml", "--set", "modules.left.source=digitised")
    code, out, _ = lux("check", *given)
    assert code == 0 and "modules.left: is digitised from a real lamp; run it with `luxloop run NAME --rig FILE`" in out
    code, _, error = lux("run", *given, "--out", "runs/none")
    assert code == 2 and "modules.left: is digitised from a real lamp" in error and not Path("runs").exists()
    assert_one_sentence(error)
    with refusal(r"modules\.left: is digitised"):
        next(prepare(load("small.toml", ["modules.left.source=digitised"])).evaluations())


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        (["modules.lft.source=digitised"], "there is no module 'lft'; name one of left matrix"),
        (["modules.left.latency_s=0.1"], 'for source = "digitised"'),
        (["modules.left={source='digitised', delay_body=true}"], "the vehicle stands"),
        (["modules.left.source=digitised", "modules.right.source=digitised"], "a camera cannot tell two beams apart"),
        (["modules.left.source=digitised", "plant.kind=remote"], "lights the simulated world, but the plant is remote"),
        (
            ["modules.left.source=digitised", "checks.a={metric='functions.symbol.iou', compare='open_loop', at_least=1.0}"],
            "is digitised; take",
        ),
    ],
)
def test_mistakes_are_told_in_a_sentence(lux, keys, told):
    code, _, error = lux("check", "small.toml", "--set", *keys)
    assert code == 2 and told in error
    assert_one_sentence(error)
