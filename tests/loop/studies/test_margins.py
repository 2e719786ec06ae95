"""Margins: those of analytic loops, those that theory bounds, and those that the simulation has."""

import math

import numpy as np
import pytest
import torch

from luxloop import Scenario, load
from luxloop.loop.studies.batch.rollouts import rollouts
from luxloop.loop.studies.gradient import near
from luxloop.loop.studies.margins import LinearLoops, identify
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of

SMALL = [
    *(f"headlight.model={SMALL_LAMP}", "functions.symbol={ width_m=3.0, length_m=8.0 }", "renderer=raycast"),
    "camera={ width_px=240, height_px=135, oversampling=1 }",
]


def flat(latency: int, kp: float, kd: float = 0.0) -> Scenario:
    loops = ", ".join(f"{kind}={{ kp={kp}, ki=0.0, kd={kd} }}" for kind in ("position", "rotation"))
    return load("flat", [*SMALL, f"functions.symbol.controller={{ name='thesis_pid', {loops} }}", f"camera.latency_steps={latency}"])


@pytest.mark.parametrize("latency", range(4))
def test_an_integrator_behind_a_delay_has_its_known_margins(latency):
    """The largest gain of `p <- p - k p[-latency]` is 2 sin(pi / (4 latency + 2))."""
    kp = 0.1
    for margins in LinearLoops.of(flat(latency, kp), np.eye(4)).margins().values():
        assert margins.gain == pytest.approx(2 * math.sin(math.pi / (4 * latency + 2)) / kp, rel=2e-3)
        if not math.isnan(margins.phase_deg):
            crossover = 2 * math.asin(kp / 2)  # |1 / (z - 1)| = 1 / kp
            assert margins.phase_deg == pytest.approx(math.degrees(math.pi / 2 - crossover * (latency + 0.5)), abs=0.1)


@pytest.mark.parametrize(("latency", "kp", "kd"), [(0, 0.5, 0.1), (1, 0.3, 0.05), (2, 0.2, 0.1), (3, 0.15, 0.1)])
def test_sensitivity_bounds_the_other_margins(latency, kp, kd):
    for name, margins in LinearLoops.of(flat(latency, kp, kd), np.diag([1.2, 1.0, 0.9, 1.1])).margins().items():
        if name != "coupled":
            assert margins.gain >= margins.sensitivity / (margins.sensitivity - 1) * (1 - 2e-3)
            assert margins.phase_deg >= math.degrees(2 * math.asin(0.5 / margins.sensitivity)) - 0.1


def test_the_plant_on_a_flat_road_is_nearly_the_pose():
    """The gain of roll depends on the size of the turn: 1.34 over 0.1 deg, 0.99 over 1 deg."""
    plant = identify(load("flat", ["functions.symbol.controller.name=thesis_pid", "camera={ width_px=640, height_px=360 }"]))
    assert plant is not None
    np.testing.assert_allclose(np.diag(plant), [1.0, 1.0, 1.15, 1.0], atol=0.1)
    responses = LinearLoops.of(flat(2, 0.2), plant).step_responses(60)
    assert responses.shape[1:] == (4, 60)
    np.testing.assert_allclose(responses[..., :3], 1.0)  # until the first frame
    np.testing.assert_allclose(responses[..., -1], 0.0, atol=0.02)


def test_an_unstable_loop_has_no_margin():
    assert LinearLoops.of(flat(2, 0.8), np.eye(4)).margins()["x"].gain == 0


SLOW, SLOWER = (
    f"position={{kp={a}, ki=0.0, kd={b}}}, rotation={{kp={c}, ki=0.0, kd={d}}}"
    for a, b, c, d in ((0.25, 0.05, 0.25, 0.05), (0.15, 0.03, 0.17, 0.12))
)


@pytest.mark.slow
@pytest.mark.parametrize(("road", "latency", "law"), [("flat", 0, "losses_to_reset=2"), ("grade", 1, SLOW), ("flat", 2, SLOWER)])
def test_the_gain_at_which_a_run_no_longer_settles_is_the_printed_one(road, latency, law):
    """Without noise, which keeps a loop moving near its margin, and from a start near the target, where rate limits do not act."""
    scenario = load(
        "flat",
        [
            f"functions.symbol.controller={{ name='thesis_pid', {law} }}",
            f"camera={{ width_px=640, height_px=360, latency_steps={latency}, noise=false }}",
            "functions.symbol.start={ x_m=16.8, y_m=0.05, roll_deg=0.2, pitch_deg=-0.1 }",
            *(f"road.kind={road}", "steps=60", "judge_every=0"),
        ],
    )
    plant = identify(scenario)
    assert plant is not None
    printed = min(each.gain for each in LinearLoops.of(scenario, plant).margins().values())
    factors, gains = printed * torch.linspace(0.8, 1.2, 9), {}
    for kind in ("position", "rotation"):
        own = getattr(scenario.symbol.controller, kind)
        gains |= {f"functions.symbol.controller.{kind}.{name}": getattr(own, name) * factors for name in ("kp", "ki", "kd")}
    simulation = simulation_of(scenario)
    ends = rollouts(simulation, gains).poses[:, -10:]
    fails = ((ends - ends.mean(1, keepdim=True)).abs() > near(simulation)).any(-1).any(-1)
    assert fails[-1]
    assert float(factors[int(fails.int().argmax())]) == pytest.approx(printed, rel=0.15)
