"""A simulation goes on with other values of keys."""

import pytest
import torch

from luxloop import Scenario, Simulation, load
from luxloop.loop.recording.replay import apply_edit
from luxloop.loop.scenario.edits import acts, with_overrides
from luxloop.loop.simulation.result import SimulationState, StepResult
from tests.refusal import refusal

SMALL = ("camera.width_px=320", "camera.height_px=180", "camera.oversampling=1", "judge_every=0")


def scenario(*overrides: str) -> Scenario:
    return load("snowflake", (*SMALL, *overrides))


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return Simulation.prepare(scenario())


def stepped(simulation: Simulation, state: SimulationState, steps: int) -> tuple[SimulationState, list[StepResult]]:
    results = []
    for _ in range(steps):
        state, result = simulation.step(state)
        results.append(simulation.evaluate(result))
    return state, results


def poses(simulation: Simulation, state: SimulationState) -> torch.Tensor:
    """Of the next three steps."""
    return torch.stack([each.symbol.pose for each in stepped(simulation, state, 3)[1]])


def test_the_same_values_change_nothing(simulation):
    state, _ = stepped(simulation, simulation.start(), 3)
    assert acts(simulation.scenario, scenario()) == "step"
    expected = poses(simulation, state)
    assert poses(*apply_edit(simulation, state, scenario())).equal(expected)


def test_a_gain_holds_from_the_next_step_on_and_the_controller_goes_on(simulation):
    state, _ = stepped(simulation, simulation.start(), 3)
    other = scenario("functions.symbol.controller.position.kp=0.2")
    found = poses(*apply_edit(simulation, state, other))
    assert found.equal(poses(Simulation.prepare(other), state))
    before = poses(simulation, state)
    assert found[0].equal(before[0])  # which the step before has measured
    assert found[1:, :2].ne(before[1:, :2]).all()


def test_functions_come_and_go():
    guarded, plain = (load("gfhb", (*SMALL, *overrides)) for overrides in ((), ("functions={}", "checks={}")))
    simulation = Simulation.prepare(guarded)
    assert acts(guarded, plain) == "step"
    state, masked = stepped(simulation, simulation.start(), 1)
    open_, state = apply_edit(simulation, state, plain)
    state, bright = stepped(open_, state, 1)
    _, again = stepped(*apply_edit(open_, state, guarded), 1)
    dark, lit, back = (sum(float(u.sum()) for u in result.lights) for (result,) in (masked, bright, again))
    assert lit > 1.05 * max(dark, back)


WHEN = {
    "step": ["functions.symbol.controller.position.kp=0.2", "judge_every=1", "steps=50", "lighting.base.beam=low"],
    "prepared": ["road.kind=flat", "light.ambient_lx=1.0", "camera.pitch_deg=2.1", "headlight.level_deg=0.1", "camera.latency_steps=1"],
    "restart": ["camera.bits=8", "camera.width_px=300", "seed=1", "rate_hz=20.0", "off_share=0.48", "headlight.model=ssl-hd-lores"],
}


@pytest.mark.parametrize("when", WHEN)
def test_keys_act_when_it_is_said(when):
    before = scenario("headlight.model=ssl-hd")
    assert {key: acts(before, with_overrides(before, [key])) for key in WHEN[when]} == dict.fromkeys(WHEN[when], when)


def test_what_has_stayed_is_not_made_anew(simulation):
    state = simulation.start()
    after, _ = apply_edit(simulation, state, scenario("functions.symbol.controller.position.kp=0.2"))
    assert after.world is simulation.world and after.modules == simulation.modules
    assert after.symbol.sensor is simulation.symbol.sensor and after.symbol.evaluator is simulation.symbol.evaluator
    assert after.symbol.controller is not simulation.symbol.controller
    object_ = 'objects=[{kind = "box", name = "box", size_m = [0.4, 0.4, 0.3], track = [{position_m = [25.0, 3.0, 0.0]}]}]'
    fuller, _ = apply_edit(after, state, scenario("functions.symbol.controller.position.kp=0.2", object_))
    assert fuller.world is not after.world and fuller.world.scene.bodies[0] is after.world.scene.bodies[0]
    assert fuller.symbol.sensor is after.symbol.sensor and fuller.symbol.evaluator is not after.symbol.evaluator


def test_the_world_changes_while_a_run_goes_on(simulation):
    state, _ = stepped(simulation, simulation.start(), 3)
    after, state = apply_edit(simulation, state, scenario("light.ambient_lx=3.0"))
    _, (result,) = stepped(after, state, 1)
    assert result.step == 3
    fresh = Simulation.prepare(scenario("light.ambient_lx=3.0"))
    luminance = fresh.world.lit(0.0).base
    assert after.world.lit(result.time_s).base.equal(luminance)
    assert luminance.mean() > 5 * simulation.world.lit(0.0).base.mean()


def test_a_symbol_that_cannot_be_drawn_is_refused(simulation):
    with refusal(r"functions\.symbol"):
        apply_edit(simulation, simulation.start(), scenario("functions.symbol.x_m=400.0"))


def test_what_came_between_two_steps_and_is_gone_again_leaves_no_trace(simulation):
    state, _ = stepped(simulation, simulation.start(), 3)
    there, back = scenario("functions.symbol.controller=open"), scenario()
    other, _ = apply_edit(simulation, state, there)
    again, then = apply_edit(other, state, back, simulation.scenario)
    assert poses(again, then).equal(poses(simulation, state))
