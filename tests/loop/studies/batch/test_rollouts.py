"""Batched rollouts: each is the single run, and errors are differentiable in gains."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from luxloop import LuxloopError, Scenario, Simulation, load
from luxloop.controllers.symbol.feedback import ThesisPid
from luxloop.loop.scenario.model import HeadlightParams
from luxloop.loop.simulation.lamps import MountedModule, mount
from luxloop.loop.studies.batch.rollouts import GAINS, check, rollouts, with_gains
from luxloop.loop.studies.ranges import value_of, with_values
from luxloop.world.symbols import load_still
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of

SMALL = [
    *(
        "functions.symbol.controller.name=thesis_pid",
        f"headlight.model={SMALL_LAMP}",
        "functions.symbol={ width_m=3.0, length_m=8.0 }",
        "functions.symbol.start.x_m=15.0",
    ),
    *("camera={ width_px=240, height_px=135, oversampling=1 }", "renderer=raycast", "road.kind=flat"),
]
KEYS = ("functions.symbol.controller.position.kp", "functions.symbol.controller.rotation.ki", "functions.symbol.controller.roll_rate_deg")


def scenario(*more: str, steps: int = 5) -> Scenario:
    return load("snowflake", [*SMALL, f"steps={steps}", *more])


@pytest.fixture(
    scope="module",
    params=[(), ("camera.latency_steps=1",), ("headlight={ model='ssl-hd', lamps=['left', 'right'] }", "lighting.base.beam=low")],
)
def simulation(request: pytest.FixtureRequest) -> Simulation:
    return simulation_of(scenario(*request.param))


def test_each_rollout_is_the_run_with_its_gains(simulation):
    given = {key: float(value_of(simulation.scenario, key) or 0.0) for key in KEYS}
    single = list(simulation.evaluations())
    poses = torch.stack([result.symbol.pose for result in single])
    alone = rollouts(simulation, {key: torch.tensor([value]) for key, value in given.items()})
    # Sums are rounded in another order; a digital number that this turns by one moves later poses by some 1e-4 m.
    torch.testing.assert_close(alone.poses[0], poses, rtol=0, atol=5e-4)
    both = rollouts(simulation, {key: torch.tensor([0.5 * value, value]) for key, value in given.items()})
    torch.testing.assert_close(both.poses[1], poses, rtol=0, atol=5e-4)
    assert (both.poses[0] - poses).abs().max() > 0.1
    assert both.poses.shape == both.errors.shape == (2, 5, 4)
    late = simulation.scenario.camera.latency_steps
    assert both.seen[:, late:].all() and not both.seen[:, :late].any() and not both.errors[:, :late].any()


def test_every_gain_arrives_where_parameters_would_put_it(simulation):
    for key in GAINS:
        expected = ThesisPid.prepare(
            with_values(simulation.scenario, {f"functions.symbol.{key}": 0.37}).symbol.controller, simulation.symbol.projector.target
        ).gains
        made = with_gains(simulation.symbol.controller.inner, {key: torch.tensor([0.1, 0.37])}).gains
        for name in ("kp", "ki", "kd", "rate_limit", "tracking_time"):
            torch.testing.assert_close(getattr(made, name).expand(2, 4)[1], getattr(expected, name))


def in_float64(params: HeadlightParams, device: str) -> tuple[MountedModule, ...]:
    lights = ((each, each.headlight.matrix.to(torch.float64)) for each in mount(params, device))
    return tuple(replace(each, headlight=replace(each.headlight, matrix=matrix)) for each, matrix in lights)


def test_errors_are_differentiable_in_gains(monkeypatch):
    monkeypatch.setattr("luxloop.loop.simulation.build.mount", in_float64)
    monkeypatch.setattr("luxloop.loop.simulation.controlled.load_still", lambda file: load_still(file).double())
    loop = Simulation.prepare(scenario("functions.symbol.extraction.edges=soft", "seed=2", steps=4))
    keys = ("functions.symbol.controller.position.kp", "functions.symbol.controller.position.kd", "functions.symbol.controller.rotation.kp")

    def errors(*gains: Tensor) -> Tensor:
        found = rollouts(loop, dict(zip(keys, gains, strict=True)), quantise=False)
        assert found.seen.all()
        return found.errors[:, 1:]

    gains = [torch.tensor([value], dtype=torch.float64, requires_grad=True) for value in (0.4, 0.2, 0.3)]
    # The rectangle's outline is a step, which no derivative knows of: a thousandth of what the gains do. With three of six seeds a texel
    # crosses it.
    assert torch.autograd.gradcheck(errors, gains, eps=1e-5, rtol=1e-2, atol=1e-3)


@pytest.mark.parametrize(
    ("changes", "keys", "said"),
    [
        (["functions.symbol.controller.name=open"], [], "for controller.name = thesis_pid, not open"),
        ([], ["functions.symbol.controller.position.kq"], "has no gradient; did you mean 'functions.symbol.controller.position.kp'"),
        (["camera.drop_probability=0.5"], [], "no frame is lost"),
        (["functions.symbol.controller.warp.takes_over=0.3"], [], "leave out controller.warp"),
        (["functions.symbol.controller.supervisor.grace_steps=8"], [], "leave out controller.supervisor"),
        (["disturbances.oncoming=[{ position_m=[40, 2, 0.65] }]"], [], r"do not support disturbances\.oncoming"),
        (["disturbances.drops=[{}]"], [], "no frame is lost"),
    ],
)
def test_what_cannot_be_rolled_out_is_said_so(changes, keys, said, simulation):
    given = scenario(*changes)
    changed_simulation = replace(simulation, scenario=given, controlled={"symbol": replace(simulation.symbol, function=given.symbol)})
    with pytest.raises(LuxloopError, match=said):
        check(changed_simulation, keys)
