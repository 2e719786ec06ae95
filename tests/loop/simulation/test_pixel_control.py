"""Pixel controllers by name: each drives lighting functions and symbols that are held, and keeps masks dark."""

from typing import Any

import pytest
import torch

from luxloop.controllers.pixels.jpo import Jpo
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.simulation.build_lamps import pixel_controller
from tests.loop.conftest import simulation_of
from tests.refusal import sentence

FLAKE = {"kind": "symbol", "image": "snowflake", "width_m": 4.0, "length_m": 8.0, "controller": "thesis_pid"}
SYMBOL = {
    "name": "drawn",
    "functions": {"symbol": FLAKE},
    "headlight": {"model": "ssl-hd-lores", "lamps": ["left"]},
    "camera": {"width_px": 320, "height_px": 180},
    "renderer": "raycast",
}
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


def lit(**changes: Any) -> Scenario:
    box = {
        "kind": "box",
        "name": "van",
        "category": "car",
        "size_m": [4.5, 1.8, 1.9],
        "track": [{"position_m": [30, 1, 0], "yaw_deg": 180}],
    }
    pole = {"kind": "box", "name": "pole", "category": "other", "size_m": [0.05, 0.05, 2], "track": [{"position_m": [12, -1.5, 0]}]}
    mask = {"kind": "glare_free", "categories": ["car", "other"], "soft_zones": [{"margin_m": 0.6, "u_rel": 0.4}]}
    lane = {"kind": "lane", "value": 0.8}
    return validate(
        {
            "name": "lit",
            "headlight": {"model": "hd84"},
            "camera": {"width_px": 480, "height_px": 200, "pitch_deg": 1.0},
            "surface": {"grain": 0.0},
            "objects": [box, pole],
            "lighting": {"base": {"beam": "high", "bend_deg": 2.0}},
            "functions": {"guard": mask, "carpet": lane},
            "renderer": "raycast",
            **changes,
        },
        "lit",
    )


@pytest.mark.parametrize(("model", "objective"), [("hd84", "mae"), ("hd84", "least_squares"), ("ssl-hd-lores", "mae")])
def test_masks_are_exactly_dark_with_joint_optimisation_too(model: str, objective: str) -> None:
    """Measured on what the camera sees of the bodies; what is not masked is lit, so that darkness is none of the lamps'."""
    jpo = {"objective": objective, "iterations": 10}
    simulation = simulation_of(lit(headlight={"model": model}, pixel_controller="jpo", jpo=jpo))
    result = simulation.at(0)
    assert all(each.masked and each.pixels > 5 and each.lx_max == 0.0 for each in result.objects.values()), result.objects
    assert result.dark_lx_max == 0.0 and float(result.illuminance.max()) > 1.0


def test_a_symbol_is_drawn_by_the_controller_that_is_named() -> None:
    ssc, jpo = (
        simulation_of(validate({**SYMBOL, **named}, "drawn")).symbol.projector
        for named in ({"ssc": {"a_r": 2.0}}, {"ssc": {"a_r": 2.0}, "pixel_controller": "jpo", "jpo": {"iterations": 7}})
    )
    (one,), (other,) = ssc.modules, jpo.modules
    assert isinstance(one.pixel_controller, Ssc) and one.pixel_controller.params.a_r == 2.0
    assert isinstance(other.pixel_controller, Jpo) and other.pixel_controller.params.iterations == 7
    assert other.pixel_controller.ssc.params.a_r == 2.0  # it starts from there
    assert not torch.equal(ssc.light(ssc.target)[0].u, jpo.light(jpo.target)[0].u)


@pytest.mark.usefixtures("own")
def test_one_of_the_users_own_drives_functions_and_symbols_that_are_held() -> None:
    for scenario in (lit(), validate(SYMBOL, "drawn")):
        own = validate(scenario.model_dump(mode="json") | {"pixel_controller": "own:Half"}, "own")
        whole, half = (simulation_of(each).at(0).lights for each in (scenario, own))
        assert any(bool(u.any()) for u in whole)
        for u, full in zip(half, whole, strict=True):
            torch.testing.assert_close(u, 0.5 * full, rtol=0, atol=0)


WRONG = {
    "typo": ({"pixel_controller": "jop"}, ["pixel_controller", "'jop'", "'jpo'", "package.module:Name"]),
    "table of the other": ({"jpo": {"iterations": 5}}, ["jpo", 'pixel_controller = "jpo"', "'ssc'"]),
    "package that is not there": ({"pixel_controller": "no_such_package:Half"}, ["no_such_package:Half", "No module", "PYTHONPATH"]),
    "no controller": ({"pixel_controller": "own:Unfinished"}, ["own:Unfinished", "no method prepare", "utilisation, over"]),
}


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(("changes", "words"), WRONG.values(), ids=WRONG.keys())
def test_what_cannot_drive_is_named_in_a_sentence(changes: dict[str, Any], words: list[str]) -> None:
    with sentence(*words):
        scenario = lit(**changes)
        pixel_controller(simulation_of(lit()).modules[0].headlight, scenario.pixel_controller, scenario.ssc, scenario.jpo)
