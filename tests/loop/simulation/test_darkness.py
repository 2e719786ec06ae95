"""No light of the lamps on what a mask must keep dark: zero, measured on rendered surfaces, thin bodies and edges of masks included."""

from typing import Any

import pytest
import torch

from luxloop import Simulation, load
from luxloop.loop.scenario.shipped import scenario_files
from luxloop.loop.simulation.result import StepResult
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.world.frames import View
from luxloop.world.light.illumination import illuminance, lit_surface
from luxloop.world.rendering.gbuffer import gbuffer
from tests.loop.conftest import box, simulated, simulation_of, toml

SIZES = toml("""
pole = [0.05, 0.05, 2.0]
walker = [0.3, 0.5, 1.8]
motorcycle = [2.1, 0.8, 1.4]
car = [4.5, 1.8, 1.5]
truck = [12.0, 2.5, 4.0]
""")
# Where they are at three times: x, y in m and heading in deg, near and far, ahead and aside, straight on and across.
PLACES = toml("""
pole = [[9.0, -1.0, 0.0], [25.0, 1.5, 45.0], [60.0, -0.3, 10.0]]
walker = [[14.0, 2.0, 90.0], [40.0, -2.5, 70.0], [8.0, 0.3, 0.0]]
motorcycle = [[30.0, -0.5, 180.0], [12.0, -1.6, 160.0], [80.0, 1.0, 0.0]]
car = [[45.0, 3.3, 180.0], [70.0, 0.0, 2.0], [22.0, 4.0, 170.0]]
truck = [[90.0, 0.0, 0.0], [55.0, 4.5, 180.0], [35.0, -5.0, -20.0]]
""")
LAMPS = ("hd84", "ssl-hd", "idealised-332x1024")


DARK = """
name = "dark"
steps = 3
rate_hz = 1
renderer = "raycast"
camera = { width_px = 480, height_px = 120, hfov_deg = 34, pitch_deg = 1.0 }
surface.grain = 0.0
lighting.base.beam = "full"
functions.guard = { kind = "glare_free", categories = ["other"], margin_m = 0.0, margin_deg = 0.0 }  # no margin hides a fault
"""


def simulation(model: str, *overrides: str, **changes: Any) -> Simulation:
    boxes = [box(name, size, *PLACES[name], category="other") for name, size in SIZES.items()]
    return simulated(DARK, f"headlight.model={model}", *overrides, **{"objects": boxes, **changes})


def views(simulation: Simulation) -> dict[str, View]:
    """The camera's view and that of one module of each lamp."""
    first = {module.side: module for module in reversed(simulation.modules)}
    lamps = {side: module.headlight.view(module.T_world_module, 480, 130) for side, module in first.items()}
    return {"camera": camera_view(simulation.scenario.camera), **lamps}


def most_light(simulation: Simulation, result: StepResult, names: set[str]) -> dict[str, dict[str, float]]:
    """By view and body: the most light in lx of all modules on what the view sees of the body, as if nothing threw a shadow."""
    triangles = simulation.world.scene.at(result.time_s)
    found: dict[str, dict[str, float]] = {}
    for view_name, view in views(simulation).items():
        surfaces = gbuffer(triangles, view, simulation.world.source.face_ids(triangles, view))
        light = torch.zeros(surfaces.object_id.numel())
        for module, u in zip(simulation.modules, result.lights, strict=True):
            surface = lit_surface(surfaces, module.headlight, module.T_world_module)
            light[surface.index] += illuminance(surface, module.headlight.light_texture(u))
        bodies = {number: body.name for number, body in enumerate(simulation.world.scene.bodies) if body.name in names}
        ids = surfaces.object_id.flatten()
        found[view_name] = {name: float(light[ids == number].max()) for number, name in bodies.items() if (ids == number).any()}
    return found


@pytest.mark.parametrize("model", LAMPS)
def test_masked_bodies_get_exactly_no_light(model):
    masked = simulation(model)
    for step in range(3):
        result = masked.at(step)
        light = most_light(masked, result, set(SIZES))
        assert {"pole", "car"} <= {name for seen in light.values() for name in seen}, "a body is not in sight"
        assert all(lx == 0.0 for seen in light.values() for lx in seen.values()), (step, light)
        assert result.dark_lx_max == 0.0


def test_without_a_mask_they_are_lit():
    bright = simulation("hd84", "functions={}")
    light = most_light(bright, bright.at(0), set(SIZES))
    assert all(lx > 0.5 for lx in light["camera"].values()), light


def test_a_mask_that_fades_lights_no_other_masked_body():
    """A van vanishes before one car and a second one beside another, and their masks fade out over the next 0.6 s."""
    places = {"car": (50.0, 0.0, 0.0), "before": (20.0, 0.0, 0.0), "beside": (48.0, 3.0, 0.0)}
    gone = {"vanishes_s": 0.1}
    boxes = [box(name, SIZES["car"], place, category="car", **(gone if name != "car" else {})) for name, place in places.items()]
    fading = simulation("hd84", "rate_hz=4", objects=boxes, functions={"guard": {"kind": "glare_free"}})
    for step in (1, 2):
        result = fading.at(step)
        assert result.dark_lx_max == 0.0 and result.objects["car"].masked
        assert all(light["car"] == 0.0 for light in most_light(fading, result, {"car"}).values()), step


@pytest.mark.parametrize("name", [name for name in scenario_files() if name.startswith("gfhb")])
def test_shipped_glare_free_scenarios_are_dark_where_they_must_be(name):
    loaded = load(name, camera=CameraParams(width_px=480, height_px=200, hfov_deg=34, pitch_deg=1.5).model_dump(mode="json"))
    simulation = simulation_of(loaded)
    for step in range(0, loaded.steps, max(1, (loaded.steps - 1) // 2)):
        result = simulation.at(step)
        masked = {each for each, light in result.objects.items() if light.masked}
        light = most_light(simulation, result, masked)
        assert masked and all(lx == 0.0 for seen in light.values() for lx in seen.values()), (step, light)
