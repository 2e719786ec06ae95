"""Lighting functions overlap by a rule of their own: the order in which a file has them means nothing."""

import random
from typing import Any

import pytest
import torch

from luxloop import Scenario
from tests.loop.conftest import box, scenario_of, simulation_of, toml, van

FUNCTIONS = toml("""
guard = { kind = "glare_free", categories = ["car"], soft_zones = [{ margin_m = 0.5, u_rel = 0.3 }] }
guard_softly = { kind = "glare_free", categories = ["car"], soft_zones = [{ margin_m = 0.5, u_rel = 0.8 }] }
bright = { kind = "symbol", image = "chevrons", x_m = 16.0, width_m = 4.0, length_m = 8.0 }
dim = { kind = "symbol", image = "snowflake", value = 0.3, x_m = 16.0, width_m = 4.0, length_m = 8.0 }
detour = { kind = "path", control_m = [[10, 0], [20, 1], [30, -1]], width_m = 3.0, value = 0.6 }
carpet = { kind = "lane", value = 0.5 }
own_width = { kind = "width", value = 0.9 }
line = { kind = "marker", width_m = 1.0, surround_m = 1.0 }
body = { kind = "marker", target = "body", value = 0.7 }
signs = { kind = "sign", priority = 0, categories = ["pedestrian"] }
object_light = { kind = "object_based", method = "constant", priority = 0, categories = ["pedestrian"] }
materials = { kind = "material", lights = [{ materials = ["asphalt"], lx = 2.0 }], categories = ["pedestrian"] }
place = { kind = "zone", centre_m = [16, 0, 0], size_m = [8, 4, 0], luminance_cd_m2 = 0.2 }
other_place = { kind = "zone", centre_m = [16, 1, 0], size_m = [8, 4, 0], luminance_cd_m2 = 0.5 }
""")  # all of one priority, and all on the same road and the same walker


OVERLAPPING = """
name = "overlapping"
renderer = "raycast"
headlight.model = "ssl-hd-lores"
camera = { width_px = 160, height_px = 90, oversampling = 1 }
lighting.base.beam = "high"
"""


def scenario(functions: dict[str, dict[str, Any]]) -> Scenario:
    walker = box("walker", (0.4, 0.5, 1.8), (20.0, 0.5, 90.0), category="pedestrian")
    return scenario_of(OVERLAPPING, functions=functions, objects=[walker, van((28.0, 2.0, 180.0))])


def lights(given: Scenario) -> list[torch.Tensor]:
    """Utilisations of the first two steps, the second with what functions have learnt."""
    simulation = simulation_of(given)
    state, first = simulation.step(simulation.start())
    return [*first.lights, *simulation.step(state)[1].lights]


def test_shuffled_functions_give_the_same_bits_and_the_same_digest():
    given = scenario(FUNCTIONS)
    expected = lights(given)
    for seed in range(2):
        shuffled = list(FUNCTIONS.items())
        random.Random(seed).shuffle(shuffled)
        again = scenario(dict(shuffled))
        assert again.digest == given.digest and list(again.functions) == list(given.functions)
        assert all(torch.equal(a, b) for a, b in zip(lights(again), expected, strict=True))


@pytest.mark.parametrize("pair", [("bright", "dim"), ("guard", "guard_softly"), ("carpet", "detour"), ("place", "other_place")])
def test_of_two_functions_alike_the_first_in_the_alphabet_lies_on_top(pair):
    """Other names, another light: what lies on top is not the same by chance."""
    one, other = pair
    only = {"a": FUNCTIONS[one], "b": FUNCTIONS[other]}
    swapped = {"a": FUNCTIONS[other], "b": FUNCTIONS[one]}
    assert list(scenario(only).functions) == ["a", "b"]
    assert any(not torch.equal(a, b) for a, b in zip(lights(scenario(only)), lights(scenario(swapped)), strict=True))


def test_masks_lie_over_symbols_over_paths_over_markers_over_the_light_of_places():
    assert list(scenario(FUNCTIONS).functions) == [
        *("guard", "guard_softly"),
        *("bright", "dim"),
        *("carpet", "detour", "own_width"),
        *("body", "line"),
        "signs",
        "object_light",
        *("materials", "other_place", "place"),
    ]
