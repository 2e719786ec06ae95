"""Two cars in one night: what each sees of the other's light, and that they agree by it."""

from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from types import ModuleType

import pytest
import torch

import luxloop
from luxloop.loop.scenario.shipped import examples
from luxloop.loop.simulation.meeting import MeetingPlant
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.camera import luminance_of
from luxloop.world.frames import inverse
from tests.refusal import refusal

SMALL = ["camera={width_px=160, height_px=90}", "renderer='raycast'"]


def prepare(*changes: str) -> Simulation:
    return luxloop.prepare(luxloop.load("shared_stretch", [*SMALL, *changes]), "cpu")


def frame(simulation: Simulation, *, other: bool = False) -> torch.Tensor:
    """Luminance `[height, width]` in cd/m^2 of the first frame of a car."""
    _, result = simulation.step(simulation.start())
    image = (result.reception.plant.result if other else result).reception.frames[0].image
    return luminance_of(image[:, :], simulation.scenario.camera).double()


def test_of_two_alike_that_face_each_other_both_see_the_same():
    """On a uniform road, up to a step of the digital numbers, 0.002 cd/m^2; behind the first car the road ends."""
    both = prepare("camera.noise=false", "surface={grain=0.0}")
    near = slice(50, None)
    assert frame(both)[near].allclose(frame(both, other=True)[near], atol=0.004)


@pytest.mark.parametrize("pose", [(30.0, 0.0, 180.0), (2.0, -5.0, 10.0)])
def test_a_frame_is_the_sum_of_the_light_of_both(pose):
    """The other car's light is that of its own world alone, in the eye of the first car."""
    x, y, yaw = pose
    met = prepare("camera.noise=false", f"other_car={{x_m={x}, y_m={y}, yaw_deg={yaw}}}")
    alone, plant = prepare("camera.noise=false", "other_car={}"), met.plant
    assert isinstance(plant, MeetingPlant)
    first = alone.step(alone.start())[1].exposures[0]
    world, lights = plant.other.world, plant.other.step(replace(plant.other.start(), plant=((), first)))[1].lights
    seen = replace(met.view, T_world_view=inverse(world.motion.at(0.0).T_world_body) @ met.view.T_world_view)
    added = world.through(seen, 0.0).light(lights)[1].double()
    off = frame(met) - frame(alone) - added
    assert float(added.max()) > 0.1
    assert float(off.abs().mean()) < 0.02 * float(added.mean())


def test_two_who_want_the_same_stretch_agree_and_a_run_records_it(tmp_path):
    """As the shipped example does. 16 steps are the worst of 60 seeds on an ideal road (`test_carrier_sense`)."""
    found = luxloop.run("shared_stretch", tmp_path / "run", overrides=[*SMALL, "steps=60"], video=False, report=False).trajectory
    turns, lit, frames = example("turns.py").run(0, [*SMALL, "steps=60"])
    assert [found[f"{car}functions.crossing.turn"].to_pylist() for car in ("", "other_car.")] == turns.T.tolist()
    assert (turns[:19] == "idle").all() and not lit[:19].any() and len(frames) == 60
    figures = example("turns.py").figures(turns)
    assert figures["steps to agreement"] <= 16
    assert figures["both draw"] <= 16 / 41


def test_a_lone_car_draws_in_the_step_after_its_wish():
    """In its own low beam, which falls on the stretch, too."""
    alone = prepare("other_car={}", "steps=24")
    lit = [bool(result.planning.drawn["crossing"]) for result in alone.run()]
    assert not any(lit[:19])
    assert sum(lit[19:]) >= 4


def test_a_step_of_a_meeting_follows_those_before():
    """The other car's state is the plant's, even if no function learns."""
    plain = "functions.crossing.carrier_sense={}"
    assert prepare(plain).remembers and not prepare(plain, "other_car={}").remembers


def example(name: str) -> ModuleType:
    """A shipped example as a module."""
    spec = spec_from_file_location(name.removesuffix(".py"), examples()[name])
    assert spec and spec.loader
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("vehicle={course=[{speed_m_s=10.0}]}", "both cars stand"),
        ("functions.held={kind='symbol', image='snowflake', controller={name='luxloop'}}", "expose once a step"),
    ],
)
def test_what_a_meeting_excludes_is_refused(change, told):
    with refusal(told):
        luxloop.load("shared_stretch", [change])
