"""Light that surfaces reflect onto each other, in the camera's frames and on objects."""

import pytest
import torch

from luxloop import Simulation
from luxloop.controllers.pixels.ssc import Utilisation
from tests.loop.conftest import simulated, van

STREET = """
name = "street"
steps = 3
rate_hz = 5
renderer = "raycast"
headlight.model = "hd84"
camera = { width_px = 320, height_px = 180, noise = false }
surface.grain = 0.0
lighting.base.beam = "high"
"""
KEY = "light.interreflection=true"
WALL = {"kind": "box", "name": "wall", "size_m": [16.0, 0.3, 3.0], "albedo": 0.6, "track": [{"position_m": [14.0, 3.0, 0.0]}]}
VAN = van((24.0, 0.0, 180.0), (23.0, 0.0, 180.0))


def lights(simulation: Simulation) -> tuple[Utilisation, ...]:
    return simulation.step(simulation.start())[1].exposures[0].lights


def test_without_bodies_no_bit_changes():
    plain, keyed = (simulated(STREET, *each) for each in ((), (KEY,)))
    shown = lights(plain)
    assert plain.world.luminance(0.0, shown)[0].equal(keyed.world.luminance(0.0, shown)[0])
    assert plain.world.illuminance(0.0, shown).equal(keyed.world.illuminance(0.0, shown))


@pytest.mark.parametrize("objects", [[WALL], [WALL, VAN]])
def test_a_wall_lights_the_road(objects):
    """Whether its world stands, with light as matrices, or moves, with light that is traced; twice the light gives twice the bounce."""
    plain, keyed = (simulated(STREET, *each, objects=objects) for each in ((), (KEY,)))
    shown = lights(plain)
    lit, dark = keyed.world.lit(0.0), plain.world.lit(0.0)
    added = lit.shown(shown) - dark.shown(shown)
    wall, road = (lit.surfaces.object_id == number for number in (1, 0))
    assert float(added.min()) > -1e-5 and float(added[road].max()) > 0.05 and float(added[wall].max()) > 0.01
    u = [each.u for each in shown]
    torch.testing.assert_close(2 * lit.reflected([each / 2 for each in u]), lit.reflected(u), rtol=1e-4, atol=1e-6)
    traced = keyed.world.lit(0.0, direct=True).reflected(u)
    torch.testing.assert_close(lit.reflected(u), traced, rtol=1e-3, atol=1e-4)
    lx, without = (each.world.lit(0.0, direct=True).light(u)[0] for each in (keyed, plain))
    assert (lx - without).sub(traced).abs().max() < 1e-4


def test_parts_and_objects_have_the_light_of_the_whole():
    keyed = simulated(STREET, KEY, objects=[WALL, VAN])
    shown, part = lights(keyed), (slice(60, 120), slice(40, 200))
    keyed.world.after(None)
    whole = keyed.world.lit(0.0)
    alone = whole.within(part)
    assert alone.expose(shown, (), False)[1].equal(whole.expose(shown, (), False)[1][part])
    on_objects = keyed.world.on_objects(0.0, shown)
    lx = keyed.world.lit(0.0, direct=True).light([each.u for each in shown])[0]
    torch.testing.assert_close(on_objects.lx, lx[whole.surfaces.object_id > 0], rtol=1e-5, atol=1e-6)


CAR = {"kind": "car", "name": "car", "seed": 1, "track": [{"position_m": [40.0, 3.2, 0.0], "yaw_deg": 180.0}]}
WET = "surface.wet=1.0"


def test_a_wet_road_shines_into_oncoming_eyes():
    """The low beam lights a head beyond its cut-off by way of the water; a dry road does not."""
    low, found = "lighting.base.beam='low'", dict[str, float]()
    for name, overrides in {"off": (WET,), "dry": (KEY,), "wet": (KEY, WET)}.items():
        simulation = simulated(STREET, low, *overrides, objects=[CAR])
        light = simulation.world.on_objects(0.0, lights(simulation))
        found[name] = float(light.on_eyes([1]).max())
    assert found["wet"] > 2 * found["off"] and found["dry"] < 1.3 * found["off"]
    dark = tuple(Utilisation(0 * each.u) for each in lights(simulation))
    assert not simulation.world.on_objects(0.0, dark).lx.any(), "the car's own lamps are no light of ours"


def test_the_camera_sees_others_lamps_in_a_wet_road():
    plain, keyed, dry = (simulated(STREET, *each, objects=[CAR]).world for each in ((WET,), (KEY, WET), (KEY,)))
    road = plain.lit(0.0).surfaces.object_id == 0
    most = [float(each.lit(0.0).base[road].max()) for each in (plain, keyed, dry)]
    assert most[1] > 10 * most[0] and most[1] > 10 * most[2]


@pytest.mark.parametrize("place_m", [(200.0, 0.0, 0.0), (-80.0, 0.0, 0.0)])
def test_bodies_out_of_reach_change_nothing(place_m):
    far = {"kind": "box", "name": "far", "size_m": [1.0, 1.0, 1.0], "track": [{"position_m": place_m}]}
    keyed = simulated(STREET, KEY, objects=[far])
    lit = keyed.world.lit(0.0)
    reflected = lit.reflected([each.u for each in lights(keyed)])
    assert not reflected[lit.surfaces.object_id == 0].any()
