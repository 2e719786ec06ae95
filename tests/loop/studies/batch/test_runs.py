"""Batches of runs: each is the single run, whatever differs; what a batch cannot do is run alone or refused with the reason."""

import math
from typing import Any

import pytest
import torch

from luxloop import Scenario, load
from luxloop.controllers.symbol.feedback import LATENCY_GAINS
from luxloop.loop.studies import runs as batch
from luxloop.loop.studies.batch.copies import Copies
from luxloop.loop.studies.runs import figures_and_trace, ready, with_controllers
from tests.lamps import SMALL_LAMP
from tests.refusal import refusal

SMALL = (
    *(f"headlight.model={SMALL_LAMP}", "functions.symbol={ width_m=3.0, length_m=8.0 }", "functions.symbol.start.x_m=15.0"),
    *("camera={ width_px=240, height_px=135, oversampling=1 }", "renderer=raycast", "road.kind=flat", "steps=8"),
)
SLOW = "functions.symbol.controller={ position={ kp=0.1, ki=0.1, kd=0.0 }, rotation={ kp=0.1, ki=0.05, kd=0.0 } }"
LATE = ("camera.latency_steps=1", "camera.drop_probability=0.2")
DIFFERENT = {
    "thesis_pid": [
        (),
        ("functions.symbol.controller.position.kp=0.5", "functions.symbol.controller.losses_to_reset=1"),
        ("functions.symbol.start={ x_m=16.0, y_m=0.2, roll_deg=2.0 }", "functions.symbol.controller.x_rate_m=0.4"),
        ("disturbances.noise=[{ factor=2.0, until_step=4 }]", "disturbances.drops=[{ from_step=3, until_step=5 }]"),
        ("disturbances.ambient=[{ factor=1.5, from_step=4 }]",),
    ],
    "gauss_newton": [(), ("functions.symbol.controller.gain=0.4",), ("functions.symbol.controller.shift_range_m=[-2.0, 1.0]",)],
    "open": [(), ("disturbances.drops=[{}]",)],
}


def scenario(*changes: str, seed: int = 0) -> Scenario:
    return load("snowflake", [*SMALL, *changes, f"seed={seed}"])


def close(a: Any, b: Any) -> bool:
    """Within what digital numbers that turn by one change: figures by a hundredth of themselves, or by 0.05."""
    if isinstance(a, list):
        return all(map(close, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-2, abs_tol=0.05)
    return a == b


@pytest.mark.parametrize(
    ("law", "common"),
    [
        ("thesis_pid", ("headlight.model=ssl-hd-lores",)),
        ("thesis_pid", (SLOW, *LATE)),
        ("open", LATE),
        pytest.param("gauss_newton", (), marks=pytest.mark.slow),
    ],
)
def test_each_of_a_batch_is_the_single_run(law, common):
    changes = DIFFERENT[law]
    given = [scenario(f"functions.symbol.controller.name={law}", *each, *common, seed=k) for k, each in enumerate(changes)]
    assert len({batch.kind(each) for each in given}) == 1 and batch.kind(given[0])
    copies = Copies(ready(given[0], "cpu"))
    simulations = [with_controllers(copies.simulation, each) for each in given]
    assert len(batch._steps(copies, simulations)[1]) <= 1, "few of them lose their symbol, and are run alone"
    for each, (figures, rollout, _) in zip(given, batch.runs(given), strict=True):
        expected, alone, _ = figures_and_trace(each, "cpu")
        assert rollout is not None and alone is not None
        # Sums are rounded in another order; a digital number that this turns by one moves a pose by some 1e-4 m, and this loop, which
        # overshoots by half, swells that to some mm.
        torch.testing.assert_close(rollout.poses, alone.poses, rtol=0, atol=1e-2)
        torch.testing.assert_close(rollout.poses[:, :4], alone.poses[:, :4], rtol=0, atol=5e-4)
        torch.testing.assert_close(rollout.errors, alone.errors, rtol=0, atol=1e-2)
        assert torch.equal(rollout.seen, alone.seen)
        assert figures.keys() == expected.keys()
        # The step from which on a symbol is settled jumps where it is at the limit.
        wrong = {key: (figures[key], expected[key]) for key in expected if "_step" not in key and not close(figures[key], expected[key])}
        assert not wrong


def test_a_batch_measures_the_latency_of_its_single_runs():
    scheduled = "functions.symbol.controller.gain_schedule='latency'"
    given = [scenario(scheduled, *more, "camera.latency_steps=2") for more in ((), ("functions.symbol.controller.y_rate_m=0.3",))]
    assert batch.kind(given[0]) == batch.kind(given[1]) != batch.kind(scenario("camera.latency_steps=2"))
    for each, (_, rollout, _) in zip(given, batch.runs(given), strict=True):
        _, alone, _ = figures_and_trace(each, "cpu")
        assert rollout is not None and alone is not None
        torch.testing.assert_close(rollout.poses, alone.poses, rtol=0, atol=5e-4)
    kp, moves = LATENCY_GAINS[2][0], rollout.poses[0, 3] - rollout.poses[0, 2]
    torch.testing.assert_close(moves[0], -kp * rollout.errors[0, 2, 0], rtol=0, atol=1e-4)


def test_what_searches_for_its_symbol_is_run_alone():
    lost = ("functions.symbol.start={ x_m=15.0, y_m=-5.5 }",)
    given = [scenario(), scenario(*lost), scenario(seed=1)]
    copies = Copies(ready(given[0], "cpu"))
    assert batch._steps(copies, [with_controllers(copies.simulation, each) for each in given])[1] == {1}
    figures, rollout, _ = batch.runs(given)[1]
    expected, alone, _ = figures_and_trace(given[1], "cpu")
    assert figures == expected and rollout is not None and alone is not None and torch.equal(rollout.poses, alone.poses)


@pytest.mark.slow
def test_light_of_whole_lamps_is_run_one_by_one():
    given = [scenario("headlight.model=ssl-hd-lores", "lighting.base.beam=low", seed=k) for k in (0, 1)]
    assert [figures for figures, *_ in batch.runs(given)] == [figures_and_trace(each, "cpu")[0] for each in given]


def test_a_kind_has_one_world_and_one_law():
    kinds = [
        batch.kind(scenario(*changes))
        for changes in ((), ("road.kind=mixed",), ("steps=5",), ("functions.symbol.controller.name=gauss_newton",), ("camera.x_m=-1.5",))
    ]
    assert len(set(kinds)) == len(kinds) and None not in kinds
    assert batch.kind(scenario()) == batch.kind(scenario(seed=9)) == batch.kind(scenario("functions.symbol.controller.rotation.ki=0.3"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (("functions.symbol.controller.name=luxloop",), "batches have no controller luxloop; leave it out, or run it one by one"),
        (
            ("functions.symbol.controller.warp.takes_over=0.3",),
            "batches have no stages: controller.warp and controller.supervisor; leave it out",
        ),
        (("functions.marker={ kind='marker' }",), "batches are of a single symbol"),
        (("functions.symbol.weight=2.0",), r"functions\.symbol\.weight: batches draw with weight 1"),
        (("vehicle.course=[{ speed_m_s=10.0 }]",), "in which nothing moves"),
    ],
)
def test_what_runs_alone_is_said_so(changes, said):
    given = scenario(*changes)
    assert batch.kind(given) is None
    with refusal(said):
        batch.refuse(given)
    with refusal(said):
        batch.runs([given, given])
