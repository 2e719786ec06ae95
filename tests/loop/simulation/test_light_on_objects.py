"""The light on objects is computed at the pixels that see them, and is that of the whole image there."""

import pytest
import torch

from luxloop import Simulation, load
from luxloop.loop.simulation.world import World
from luxloop.world.traffic.tracked import ROAD_USERS
from tests.loop.conftest import simulation_of

SMALL = ("camera.width_px=240", "camera.height_px=136", "judge_every=0")


@pytest.fixture(scope="module")
def driven() -> tuple[Simulation, World, float]:
    """A drive with road users, its world where nothing has been rendered yet, and a time at which a car passes the camera's plane."""
    simulation = simulation_of(load("night_drive", SMALL))
    given = simulation.world
    return simulation, World(given.scene, given.modules, given.camera, given.source, given.motion, True, given.given), 3.05


@pytest.mark.parametrize("later_s", [-1.5, 0.0])
def test_light_on_objects_is_that_of_the_whole_image(driven, later_s):
    simulation, world, time_s = driven
    time_s += later_s
    lights = simulation.step(simulation.start())[1].exposures[0].lights
    light = world.on_objects(time_s, lights)
    whole, lx = world.lit(time_s), world.illuminance(time_s, lights)
    numbers = whole.surfaces.object_id
    assert len(light.lx) == int((numbers > 0).sum()) > 100 and float(light.lx.max()) > 1
    for number in range(1, len(world.given) + 1):
        torch.testing.assert_close(light.on(number), lx[numbers == number], rtol=1e-6, atol=0)  # the last bits of float32
    users = [number for number, each in enumerate(world.given, 1) if each.category in ROAD_USERS]
    torch.testing.assert_close(light.on_eyes(users), lx[whole.eyes], rtol=1e-6, atol=0)
    again = world.on_objects(time_s, lights)  # now that the whole image is known
    assert again.lx.equal(lx[numbers > 0]) and again.eyes.equal(light.eyes)


def test_a_module_is_driven_once_where_both_exposures_draw_the_same(driven):
    simulation = driven[0]
    result = simulation.step(simulation.start())[1]
    on, off = (each.lights for each in result.exposures)
    assert [k for k, each in enumerate(on) if each is not off[k]] == list(simulation.controlled["way"].drawn_by)
    drawn = simulation.planner.draw(result.now, result.planning.functions)
    alone = simulation.lights_of(result, {name: each for name, each in drawn.items() if name != "way"})
    assert all(one.u.equal(other.u) for one, other in zip(off, alone, strict=True))
