"""Registration from above, the warp that is made of it, and the supervisor who keeps the open loop where nothing is better."""

import pickle

import pytest
import torch

from luxloop import Simulation, load
from luxloop.controllers.symbol.alignment import Alignment, Placement
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of

SMALL = [
    f"headlight.model={SMALL_LAMP}",
    "camera={ width_px=640, height_px=360, oversampling=2 }",
    "functions.symbol.image=snowflake",
]
ROUGH = ["road.kind=bumps", "road.seed=3"]
BOX = 'objects=[{kind="box", name="box", size_m=[0.4, 0.5, 0.3], albedo=0.2, track=[{position_m=[15.5, 0.2, 0.0]}]}]'


def simulation(*changes: str) -> Simulation:
    return simulation_of(load("flat", [*SMALL, *changes]))


def ious(steps: int, controller: str, *changes: str) -> list[float]:
    sim = simulation(f"functions.symbol.controller={controller}", f"steps={steps}", *changes)
    return [float(result.symbol.metrics.iou) for result in sim.evaluations()]


@pytest.fixture(scope="module")
def alignment() -> Alignment:
    return Alignment.prepare(simulation("functions.symbol.controller={name='open'}").symbol.sensor)


def moved(alignment: Alignment, placement: Placement) -> torch.Tensor:
    """The target as it looks where the placement, which is small, puts it: its inverse to second order."""
    points = alignment.points
    back = 2 * points - placement.of(points)
    return alignment.still.at(alignment.target[None], points + back - placement.of(back))[0]


TURNED = torch.tensor([[0.97, 0.04, 0.05], [-0.02, 1.04, 0.08], [0.01, 0.02, 1.0]])


@pytest.mark.parametrize("kind", ["homography", "homography+mesh"])
def test_a_homography_is_found_and_undone(alignment, kind):
    image = moved(alignment, Placement(TURNED, alignment.still.heights, alignment.still.per_m, alignment.still.extent))
    found = alignment.register(image, kind)  # type: ignore[arg-type]
    assert alignment.residual(image) > 0.3
    # interpolating twice between cells of 4 cm blurs the edges of strokes that are 10 cm wide
    assert alignment.residual(alignment.undo(image, found)) < 0.12


def test_heights_of_a_mesh_are_found_and_undone(alignment):
    rows, _ = alignment.still.heights.shape
    hill = 0.02 * torch.sin(torch.linspace(0, 6.28, rows))[:, None].expand_as(alignment.still.heights)
    image = moved(alignment, Placement(torch.eye(3), hill, alignment.still.per_m, alignment.still.extent))
    before = alignment.residual(image)
    assert alignment.residual(alignment.undo(image, alignment.register(image, "mesh"))) < before / 2


def test_where_nothing_has_moved_nothing_is_moved(alignment):
    found = alignment.register(alignment.target, "homography+mesh")
    torch.testing.assert_close(found.of(alignment.points), alignment.points, rtol=0, atol=1e-5)  # single precision


def test_the_supervisor_lets_control_begin_from_the_open_loop_and_keeps_it_behind_a_box():
    controlled, opened = (ious(14, controller, *ROUGH) for controller in ("{name='gauss_newton', supervisor={}}", "{name='open'}"))
    assert controlled[0] == opened[0] and controlled[-1] > opened[-1]
    kept, opened = (ious(6, controller, BOX) for controller in ("{name='gauss_newton', supervisor={}}", "{name='open'}"))
    assert kept == opened


def test_a_controller_that_makes_things_worse_loses_the_charge():
    """With the errors' sign turned round the open loop is back after the grace."""
    sim = simulation("functions.symbol.controller={name='gauss_newton', supervisor={grace_steps=2}}", "steps=6", *ROUGH)
    sim.symbol.controller.inner.inner.inverse.neg_()  # type: ignore[attr-defined]
    drawn = [result.lights[0] for result in sim.evaluations()]
    flat = sim.symbol.projector.light(sim.symbol.projector.target)[0].u
    assert [bool(u.equal(flat)) for u in drawn] == [True, False, False, False, True, True]


@pytest.mark.parametrize("stage", ["warp", pytest.param("supervisor", marks=pytest.mark.slow)])
def test_a_run_goes_on_from_a_stored_state(stage):
    prepared = simulation(f"functions.symbol.controller={{name='gauss_newton', {stage}={{}}}}", *ROUGH, "camera.latency_steps=1")
    kept, stored, found = prepared.start(), prepared.start(), []
    for _ in range(10):
        kept, result = prepared.step(kept)
        stored, again = prepared.step(pickle.loads(pickle.dumps(stored)))
        iou, other = (float(prepared.evaluate(each).symbol.metrics.iou) for each in (result, again))
        assert iou == other
        found.append(iou)
    assert len(set(found[-6:])) > 1, "the stage has begun to act"
