"""Poses at once: what each single run sees of them, and what its evaluator says."""

from dataclasses import replace

import pytest
import torch

from luxloop import ProjectionCommand, Simulation, load
from luxloop.controllers.pixels.ssc import WindowedSsc
from luxloop.loop.studies.batch.copies import Conditions, Copies, _paint, _plain, _sample, rays_at
from tests.loop.conftest import simulation_of
from tests.refusal import refusal

SMALL = [
    *("functions.symbol.controller.name=thesis_pid", "headlight.model=ssl-hd-lores", "functions.symbol={ width_m=3.0, length_m=8.0 }"),
    *("camera={ width_px=240, height_px=135, oversampling=1 }", "renderer=raycast", "seed=3", "steps=4"),
]


@pytest.fixture(
    scope="module",
    params=[
        (),
        ("headlight={ model='ssl-hd', lamps=['left', 'right'] }", "lighting.base.beam=low"),
        ("camera.noise=false",),
        ("functions.symbol.features.view=birdseye", "functions.symbol.extraction.edges=binary"),
        ("disturbances.ambient=[{ factor=3.0, from_step=1 }]", "disturbances.noise=[{ factor=1.5, until_step=3 }]"),
    ],
)
def simulation(request: pytest.FixtureRequest) -> Simulation:
    return simulation_of(load("snowflake", [*SMALL, *request.param]))


def test_each_copy_is_a_single_run(simulation):
    copies, results = Copies(simulation), list(simulation.evaluations())
    assert copies.windowed == (simulation.scenario.lighting.base.beam == "off")
    poses = torch.stack([each.symbol.pose for each in results])
    light, seed = copies.show(poses), simulation.scenario.seed
    frames = [Conditions(seed, step, simulation.scenario.disturbances) for step in range(len(results))]
    seen, metrics = copies.measure(light, frames), copies.evaluate(light)
    for k, each in enumerate(results):
        expected, single = each.symbol.measurement, each.symbol.metrics
        assert seen[k].code == expected.code == 0 and single is not None and seen[k].crop == expected.crop
        # Sums of single precision in another order, which turn a digital number by one at times.
        torch.testing.assert_close(seen[k].pose_error, expected.pose_error, rtol=0, atol=1e-4)
        torch.testing.assert_close(seen[k].area_ratio, expected.area_ratio, rtol=0, atol=1e-4)
        # One cell of ten thousand lies on the threshold.
        assert metrics.iou[k].item() == pytest.approx(single.iou.item(), abs=1e-3)
        assert metrics.ssim[k].item() == pytest.approx(single.ssim.item(), abs=1e-3)
        assert metrics.centroid_percent[k].tolist() == pytest.approx(single.centroid_percent.tolist(), abs=0.05)


def test_bands_of_rays_are_the_rays(simulation):
    """The quick form of drawing gives the setpoints of the readable one, bit for bit, where an outline slants or leaves the field, too."""
    copies = Copies(simulation)
    if not copies.windowed:
        return
    poses = torch.tensor([[17.0, 0.0, 0.0, 0.0], [15.0, -1.4, 0.09, -0.03], [25.0, 8.0, -0.1, 0.02], [17.0, 60.0, 0.0, 0.0]])
    for module, primitives in zip(copies.projector.modules, copies.projector.primitives(ProjectionCommand(poses)), strict=True):
        rays = rays_at(module.pixel_controller, primitives, module.T_body_headlight)
        drawn = WindowedSsc.of(module.pixel_controller, rays.window)
        assert _plain(drawn, rays)
        for quick, readable in zip(_sample(drawn, rays), _paint(drawn, rays), strict=True):
            assert torch.equal(quick, readable)


def test_products_are_kept_until_poses_leave_them(simulation):
    """And what they give does not depend on what was kept."""
    near, far = torch.tensor([[17.0, 0.0, 0.0, 0.0], [17.1, 0.0, 0.0, 0.0]]), torch.tensor([[22.0, 0.3, 0.0, 0.0]] * 2)
    copies, fresh = Copies(simulation), Copies(simulation)
    copies.show(near)
    for poses in (far, near):
        found, expected = copies.show(poses), fresh.show(poses)
        for a, b in zip(copies.measure(found, [Conditions(0, 0)] * 2), fresh.measure(expected, [Conditions(0, 0)] * 2), strict=False):
            torch.testing.assert_close(a.pose_error, b.pose_error, rtol=0, atol=1e-4)
        torch.testing.assert_close(found.sums, expected.sums)


def test_a_symbol_that_nobody_sees_is_lost_and_nothing_on_the_road(simulation):
    copies = Copies(simulation)
    light = copies.show(torch.tensor([[17.0, 200.0, 0.0, 0.0]] * 2))
    assert [each.code.item() for each in copies.measure(light, [Conditions(0, 0)] * 2)] == [2, 2]
    metrics = copies.evaluate(light)
    assert metrics.iou.tolist() == [0, 0] and metrics.centroid_percent.isnan().all()


def test_noise_is_that_of_each_copys_seed_and_step(simulation):
    copies = Copies(simulation)
    light = copies.show(torch.tensor([[17.0, 0.0, 0.0, 0.0]] * 3))
    first, second, third = (each.errors for each in copies.measure(light, [Conditions(0, 5), Conditions(0, 5), Conditions(1, 5)]))
    assert torch.equal(first, second)
    assert torch.equal(first, third) != simulation.scenario.camera.noise


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["functions.symbol.start_s=0.1"], r"functions\.symbol\.start_s: batches show the symbol in all steps"),
        (["disturbances.oncoming=[{ position_m=[40, 2, 0.65] }]"], r"disturbances\.oncoming; leave it out, or run it one by one"),
        (["headlight.droop=1"], r"headlight\.droop: batches sum the flux"),
        (["lighting.power_limit=0.5"], r"lighting\.power_limit: batches have no limit"),
        (["vehicle.course=[{ speed_m_s=10.0 }]"], "in which nothing moves"),
    ],
)
def test_what_is_no_batch_is_said_so(changes, said):
    with refusal(said):
        Copies(simulation_of(load("snowflake", [*SMALL, *changes])))


def test_one_that_stands_beside_what_it_was_prepared_for_is_refused(simulation):
    given = load("snowflake", [*SMALL, "disturbances.oncoming=[{ position_m=[40, 2, 0.65] }]"])
    with refusal(r"disturbances\.oncoming"):
        Copies(replace(simulation, scenario=given))
