"""The loop on a simulated rig of another process: no frame is taken for a measurement of light that it does not show alone."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from luxloop.loop.rig.arrays import grids_of
from luxloop.loop.rig.params import RigParams
from luxloop.loop.rig.plant import RigEvaluator, RigPlant
from luxloop.loop.rig.rig import await_camera, open_rig
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.build import from_zero
from luxloop.loop.simulation.lamps import lamp_modules
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.validation import validate_model
from tests.loop.rig.conftest import DDP, SimulatedRigProcess, watch_frames

pytestmark = pytest.mark.slow
SMALL = ("camera.width_px=640", "camera.height_px=360", "camera.oversampling=2", "renderer=raycast", "steps=40")
HARD = ("faults.light.packet_loss=0.01", "faults.camera.jitter_s=0.02", "faults.flicker.depth=0.3", "faults.camera.latency_s=0.02")
TIMING = {"latency_s": 0.065, "jitter_s": 0.04, "rolling_s": 0.04}
MARK = {"row": 300, "column": 20, "rows": 30, "columns": 240, "u_px": 88.0, "v_px": 223.0, "width_px": 92.0, "height_px": 12.0}


class LoopRig(SimulatedRigProcess):
    """The simulated rig of a snowflake, and rig files that name it."""

    def params(self, light: Mapping[str, Any] = {}, **tables: Any) -> RigParams:
        light = {**DDP, "port": self.light, "bits": 16, **light}
        camera = {"kind": "http", "url": f"http://127.0.0.1:{self.camera}/camera", "bits": 12}
        return validate_model(RigParams, {"light": light, "camera": camera, "timing": TIMING, **tables}, "")


Start = Callable[..., LoopRig]


@pytest.fixture
def rig_of(tmp_path: Path) -> Iterator[Start]:
    with ExitStack() as stack:
        yield lambda *keys: stack.enter_context(LoopRig(["snowflake", "--set", *SMALL, *keys], tmp_path))


def run_on(rig_params: RigParams) -> tuple[Simulation, list[Any], dict[str, Any], float]:
    """The simulated world for comparison, what was taken, the rig's statistics, and the final IoU by the light on the simulated road."""
    scenario = load("snowflake", [*SMALL, "plant.kind=rig", "checks={}"])
    world = prepare(load("snowflake", SMALL), "cpu")
    simulation = prepare(scenario, "cpu")
    modules = lamp_modules(simulation.modules)
    with open_rig(rig_params, grids_of(modules), scenario.camera, armed=True) as rig:
        assert await_camera(rig, 20)
        rig_evaluator = RigEvaluator(simulation.controlled, scenario.camera, rig_params.mark)
        taken, plant = watch_frames(rig), replace(RigPlant.of(rig, modules, 2 * scenario.steps), look=rig_evaluator.look)
        results = list(replace(simulation, plant=from_zero(plant, scenario, modules)).evaluations())
        summary = {**rig.statistics.summary(2), "interruptions": rig.keeper.interruptions, "judged": rig_evaluator.summary()}
    on, off = (each.lights for each in results[-1].exposures)
    evaluator = world.symbol.evaluator
    metrics = evaluator.evaluate(on, off, 0.0)
    return world, taken, summary, float(metrics.iou)


def test_on_a_good_rig_the_symbol_is_as_straight_as_in_simulation(rig_of):
    rig = rig_of("faults.camera.latency_s=0.02")
    world, taken, summary, iou = run_on(rig.params())
    assert not rig.wrong(taken) and len(taken) >= 70
    simulated = [float(each.symbol.metrics.iou) for each in world.evaluations()][-1]
    print(f"\nIoU {iou:.3f}, simulated {simulated:.3f}; {summary}")
    assert iou > simulated - 0.02
    assert abs(summary["judged"]["symbol"]["iou_final"] - iou) < 0.06  # with noise, and by a plane where the road is none


def test_with_jitter_lost_packets_and_flicker_no_frame_is_wrong(rig_of):
    rig = rig_of(*HARD)
    _, taken, summary, iou = run_on(rig.params(light={"repeats": 3}))
    assert not rig.wrong(taken) and len(taken) >= 50
    print(f"\nIoU {iou:.3f}; {summary}")
    assert iou > 0.88


def test_light_that_comes_late_is_told_by_its_mark(rig_of):
    rig = rig_of(*HARD)
    timing = {"latency_s": 0.05, "jitter_s": 0.0, "rolling_s": 0.0}  # far too short: a frame lacks packets until it is sent again
    _, taken, summary, iou = run_on(rig.params(timing=timing, mark=MARK))
    assert not rig.wrong(taken) and len(taken) >= 50
    print(f"\nIoU {iou:.3f}; {summary}")
    assert summary["pictures"]["of another exposure"] > 0 and iou > 0.88
    assert abs(summary["judged"]["symbol"]["iou_final"] - iou) < 0.06
