"""Pixel controllers by name: each drives lighting functions and symbols that are held, and keeps masks dark."""

import pytest
import torch

from luxloop import Ssc
from luxloop.controllers.pixels.jpo import Jpo
from tests.loop.conftest import box, simulated, van
from tests.refusal import sentence

SYMBOL = """
name = "drawn"
renderer = "raycast"
functions.symbol = { kind = "symbol", image = "snowflake", width_m = 4.0, length_m = 8.0, controller = "thesis_pid" }
headlight = { model = "ssl-hd-lores", lamps = ["left"] }
camera = { width_px = 320, height_px = 180 }
"""
LIT = """
name = "lit"
renderer = "raycast"
headlight.model = "hd84"
camera = { width_px = 480, height_px = 200, pitch_deg = 1.0 }
surface.grain = 0.0
lighting.base = { beam = "high", bend_deg = 2.0 }
functions.guard = { kind = "glare_free", categories = ["car", "other"], soft_zones = [{ margin_m = 0.6, u_rel = 0.4 }] }
functions.carpet = { kind = "lane", value = 0.8 }
"""
OBJECTS = [van((30.0, 1.0, 180.0)), box("pole", (0.05, 0.05, 2), (12.0, -1.5, 0.0), category="other")]
OWN = """
from dataclasses import dataclass, replace

from luxloop.controllers.pixels.ssc import Ssc, Utilisation


@dataclass(frozen=True)
class Half:
    ssc: Ssc

    @classmethod
    def prepare(cls, headlight):
        return cls(Ssc.prepare(headlight))

    @property
    def headlight(self):
        return self.ssc.headlight

    @property
    def default(self):
        return self.ssc.default

    def over(self, default):
        return replace(self, ssc=self.ssc.over(default))

    def utilisation(self, primitives, T_world_headlight, secondary=None):
        return Utilisation(0.5 * self.ssc.utilisation(primitives, T_world_headlight, secondary).u)


class Unfinished:
    pass
"""


@pytest.mark.parametrize(("model", "objective"), [("hd84", "mae"), ("hd84", "least_squares"), ("ssl-hd-lores", "mae")])
def test_masks_are_exactly_dark_with_joint_optimisation_too(model, objective):
    """Measured on what the camera sees of the bodies; what is not masked is lit, so that darkness is none of the lamps'."""
    jpo = ("pixel_controller=jpo", f"jpo={{ objective='{objective}', iterations=10 }}")
    result = simulated(LIT, f"headlight.model={model}", *jpo, objects=OBJECTS).at(0)
    assert all(each.masked and each.pixels > 5 and each.lx_max == 0.0 for each in result.objects.values()), result.objects
    assert result.dark_lx_max == 0.0 and float(result.illuminance.max()) > 1.0


def test_a_symbol_is_drawn_by_the_controller_that_is_named():
    jpo_keys = ("pixel_controller=jpo", "jpo.iterations=7")
    ssc, jpo = (simulated(SYMBOL, "ssc.a_r=2.0", *keys).symbol.projector for keys in ((), jpo_keys))
    (one,), (other,) = ssc.modules, jpo.modules
    assert isinstance(one.pixel_controller, Ssc) and one.pixel_controller.params.a_r == 2.0
    assert isinstance(other.pixel_controller, Jpo) and other.pixel_controller.params.iterations == 7
    assert other.pixel_controller.ssc.params.a_r == 2.0  # it starts from there
    assert not torch.equal(ssc.light(ssc.target)[0].u, jpo.light(jpo.target)[0].u)


@pytest.mark.usefixtures("own")
def test_one_of_the_users_own_drives_functions_and_symbols_that_are_held():
    for base, objects in ((LIT, OBJECTS), (SYMBOL, ())):
        whole, half = (simulated(base, *own, objects=objects).at(0).lights for own in ((), ("pixel_controller=own:Half",)))
        assert any(bool(u.any()) for u in whole)
        for u, full in zip(half, whole, strict=True):
            torch.testing.assert_close(u, 0.5 * full, rtol=0, atol=0)


WRONG = {
    "pixel_controller=jop": "pixel_controller: there is no pixel controller 'jop'",
    "jpo.iterations=5": 'pixel_controller = "jpo"',
    "pixel_controller=no_such_package:Half": "no_such_package:Half",
    "pixel_controller=own:Unfinished": "own:Unfinished: has no method prepare",
}


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(("override", "words"), WRONG.items())
def test_what_cannot_drive_is_named_in_a_sentence(override, words):
    with sentence(words):
        simulated(LIT, override)
