"""Poses at once: what each single run sees of them, and what its judge says."""

from dataclasses import replace

import pytest
import torch

from loop.batch.copies import Copies
from loop.lighting.simulation import Simulation
from loop.scenario.model import load
from world.errors import LuxloopError

SMALL = [
    *("functions.symbol.controller.name=thesis_pid", "headlight.model=ssl-hd-lores", "functions.symbol={ width_m=3.0, length_m=8.0 }"),
    *("camera={ width_px=240, height_px=135, oversampling=1 }", "renderer=raycast", "seed=3", "steps=4"),
]


@pytest.fixture(scope="module", params=[(), ("headlight.lamps=['left', 'right']", "lighting.base.beam=low"), ("camera.noise=false",)])
def simulation(request: pytest.FixtureRequest) -> Simulation:
    return Simulation.prepare(load("snowflake", [*SMALL, *request.param]))


def test_each_copy_is_a_single_run(simulation: Simulation) -> None:
    copies, results = Copies(simulation), list(simulation.run())
    assert copies.windowed == (simulation.scenario.lighting.base.beam == "off")
    poses = torch.stack([each.symbol.pose for each in results])
    light, seed = copies.show(poses), simulation.scenario.seed
    seen, verdict = copies.measured(light, [(seed, step) for step in range(len(results))]), copies.judged(light)
    for k, each in enumerate(results):
        expected, judged = each.symbol.measurement, each.symbol.verdict
        alone = copies.measured(copies.show(poses[k : k + 1]), [(seed, k)])
        assert seen.code[k] == alone.code[0] == expected.code == 0 and judged is not None
        # Sums of single precision in another order, which turn a digital number by one at times.
        torch.testing.assert_close(alone.pose_error[0], expected.pose_error, rtol=0, atol=1e-4)
        # Beside others it is looked for in the footprint of all, where its own cuts off some of its light.
        torch.testing.assert_close(seen.pose_error[k], expected.pose_error, rtol=0, atol=0.04)
        # One cell of ten thousand lies on the threshold.
        assert verdict.iou[k].item() == pytest.approx(judged.iou.item(), abs=1e-3)
        assert verdict.ssim[k].item() == pytest.approx(judged.ssim.item(), abs=1e-3)
        assert verdict.centroid_percent[k].tolist() == pytest.approx(judged.centroid_percent.tolist(), abs=0.05)


def test_products_are_kept_until_poses_leave_them(simulation: Simulation) -> None:
    """And what they give does not depend on what was kept."""
    near, far = torch.tensor([[17.0, 0.0, 0.0, 0.0], [17.1, 0.0, 0.0, 0.0]]), torch.tensor([[22.0, 0.3, 0.0, 0.0]])
    copies, fresh = Copies(simulation), Copies(simulation)
    copies.show(near)
    moved = copies.show(far)
    again, expected = copies.show(near), fresh.show(near)
    assert again.crop == expected.crop != moved.crop
    torch.testing.assert_close(again.lit, expected.lit, rtol=1e-6, atol=1e-7)
    torch.testing.assert_close(moved.lit, fresh.show(far).lit, rtol=1e-6, atol=1e-7)


def test_a_symbol_that_nobody_sees_is_lost_and_judged_as_nothing(simulation: Simulation) -> None:
    copies = Copies(simulation)
    light = copies.show(torch.tensor([[17.0, 200.0, 0.0, 0.0]] * 2))
    assert copies.measured(light, [(0, 0)]).code.tolist() == [2, 2]
    verdict = copies.judged(light)
    assert verdict.iou.tolist() == [0, 0] and verdict.centroid_percent.isnan().all()


def test_noise_is_that_of_each_copys_seed_and_step(simulation: Simulation) -> None:
    copies = Copies(simulation)
    light = copies.show(torch.tensor([[17.0, 0.0, 0.0, 0.0]] * 3))
    first, second, third = copies.measured(light, [(0, 5), (0, 5), (1, 5)]).errors
    assert torch.equal(first, second)
    assert torch.equal(first, third) != simulation.scenario.camera.noise


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["functions.symbol.start_s=0.1"], r"functions\.symbol\.start_s: batches show the symbol in all steps"),
        (["disturbances.drops=[{}]"], r"do not support disturbances\.drops; leave it out, or run it one by one"),
        (["vehicle.course=[{ speed_m_s=10.0 }]"], "in which nothing moves"),
    ],
)
def test_what_is_no_batch_is_said_so(changes: list[str], said: str) -> None:
    with pytest.raises(LuxloopError, match=said):
        Copies(Simulation.prepare(load("snowflake", [*SMALL, *changes])))


def test_one_that_stands_beside_what_it_was_prepared_for_is_refused(simulation: Simulation) -> None:
    given = load("snowflake", [*SMALL, "disturbances.noise=[{ factor=2.0 }]"])
    with pytest.raises(LuxloopError, match=r"disturbances\.noise"):
        Copies(replace(simulation, scenario=given))
