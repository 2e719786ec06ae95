"""Lighting functions of the user's own: planned among the others, and what is wrong with them is said in a sentence."""

from typing import Any

import pytest

from luxloop import Scenario, run
from tests.loop.conftest import scenario_of, simulation_of
from tests.refusal import sentence

OWN = """
import torch

from luxloop.controllers.pixels.primitives import rectangle

class Carpet:
    def __init__(self, value=0.5, far_m=20.0):
        self.value, self.far_m = value, far_m
    def primitives(self, now):
        T = now.T_world_vehicle
        corner = T[:3, 3] + self.far_m * T[:3, 0] + 1.5 * T[:3, 1]
        return [rectangle(corner, -3 * T[:3, 1], -8 * T[:3, 0], self.value, normal=T[:3, 2])]

class Brightening(Carpet):
    def start(self):
        return 0
    def step(self, state, now):
        assert now.seen is not None
        return state + 1
    def adapted(self, state, now):
        self.value = 0.1 * (1 + state)
        return self.primitives(now)
    def base_share(self, state):
        return 0.5

class Asking(Brightening):
    def base_share(self, state):
        return 1.5

class Listless(Carpet):
    def primitives(self, now):
        return super().primitives(now)[0]

class Failing(Carpet):
    def primitives(self, now):
        raise RuntimeError("no idea")

class Forgetful:
    def start(self):
        return None
"""


BASE = """
name = "own"
steps = 3
renderer = "raycast"
headlight.model = "hd84"
camera = { width_px = 160, height_px = 90, oversampling = 1 }
lighting.base.beam = "low"
"""


def scenario(**functions: Any) -> Scenario:
    return scenario_of(BASE, functions=functions)


def lights(**functions: Any) -> list[Any]:
    return [result.lights[0] for result in simulation_of(scenario(**functions)).evaluations()]


@pytest.mark.usefixtures("own")
def test_it_draws_as_the_others_do(tmp_path):
    """Above those of equal priority but for symbols; its options decide what."""
    carpet, dim = ({"kind": "own:Carpet", "options": {"value": value}} for value in (0.9, 0.1))
    lane = {"kind": "lane", "value": 0.2}
    alone, dimmer, over, under = (lights(**each)[0] for each in ({"a": carpet}, {"a": dim}, {"a": carpet, "b": lane}, {"b": lane}))
    both = lights(a=carpet, b=lane | {"priority": 1})[0]
    assert alone.sum() > dimmer.sum() and over.sum() > both.sum() and not both.equal(under)
    given = scenario(a=carpet)
    assert type(given).model_validate_json(given.model_dump_json()) == given, "recordings hold it"
    assert run(given, tmp_path / "run", video=False, report=False).summary["idle_functions"] == []


@pytest.mark.usefixtures("own")
def test_one_that_learns_keeps_its_state_from_step_to_step():
    first, second, third = lights(a={"kind": "own:Brightening"})
    assert (first.sum(), second.sum()) < (second.sum(), third.sum())
    simulation = simulation_of(scenario(a={"kind": "own:Brightening"}))
    state, result = simulation.step(simulation.start())
    assert simulation.planner.learns and state.functions == {"a": 1} and result.plan.base.share == 0.5


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("Carpet", {"valve": 1}, "functions.mine: options.valve"),
        ("Carpet", {"value": 2.0}, "the setpoint 2"),
        ("Carpets", {}, "own has no Carpets"),
        ("Asking", {}, "base_share gives 1.5"),
        ("Listless", {}, "primitives gives a Primitives; give a list"),
        ("Failing", {}, "primitives fails at"),
        ("Forgetful", {}, "has no method step"),
    ],
)
def test_what_is_wrong_with_it_is_said_in_a_sentence(name, options, words):
    with sentence(f"own:{name}", words):
        lights(mine={"kind": f"own:{name}", "options": options})
