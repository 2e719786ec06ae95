"""The loop on a simulated rig of another process: no frame is taken for a measurement of light that it does not show alone."""

import json
import os
import socket
import subprocess
import sys
import urllib.request
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from luxloop.loop.rig.ddp import DdpLight
from luxloop.loop.rig.judged import Judged
from luxloop.loop.rig.params import RigParams
from luxloop.loop.rig.plant import RigPlant, grids_of
from luxloop.loop.rig.rig import await_camera, opened
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.build_plant import from_zero
from luxloop.loop.simulation.lamps import lamp_modules
from luxloop.loop.simulation.protocol import Arrivals, Exposure
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.validation import validate_model
from tests.loop.rig.conftest import ROOT, free_port

pytestmark = pytest.mark.slow
SMALL = ("camera.width_px=640", "camera.height_px=360", "camera.oversampling=2", "renderer=raycast", "steps=40")
HARD = ("faults.light.packet_loss=0.01", "faults.camera.jitter_s=0.02", "faults.flicker.depth=0.3", "faults.camera.latency_s=0.02")
TIMING = {"latency_s": 0.065, "jitter_s": 0.04, "rolling_s": 0.04}
MARK = {"row": 300, "column": 20, "rows": 30, "columns": 240, "u_px": 88.0, "v_px": 223.0, "width_px": 92.0, "height_px": 12.0}


Taken = tuple[int, int, float]  # time code, CRC-32 of the picture, and when it arrived


class Bench:
    """The simulated rig, and what it says of frames."""

    def __init__(self, keys: tuple[str, ...]) -> None:
        self.light, self.camera, self.port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM), free_port(socket.SOCK_STREAM)
        ports = ("--light-port", str(self.light), "--camera-port", str(self.camera), "--truth-port", str(self.port))
        command = [sys.executable, "-m", "luxloop.loop.commands.cli", "rig", "simulate", "snowflake", "--set", *keys, *ports]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        assert self.process.stdout is not None
        while "End it" not in (line := self.process.stdout.readline()):
            assert line, "the rig has not started"

    def truth(self) -> dict[str, Any]:
        told: dict[str, Any] = json.load(urllib.request.urlopen(f"http://127.0.0.1:{self.port}/truth", timeout=20))
        return told

    def params(self, **tables: Any) -> RigParams:
        light = {"kind": "ddp", "timecode": True, "host": "127.0.0.1", "port": self.light, "bits": 16}
        camera = {"kind": "http", "url": f"http://127.0.0.1:{self.camera}/camera", "bits": 12}
        return validate_model(RigParams, {"light": light, "camera": camera, "timing": TIMING, **tables}, "")


class Watched:
    """A rig as a plant, and which picture it took for which light, by time code."""

    def __init__(self, plant: RigPlant) -> None:
        self.plant, self.taken = plant, list[Taken]()
        self._expose = plant.rig.expose

    def start(self) -> tuple[None, Arrivals]:
        return self.plant.start()

    def show(self, state: None, exposure: Exposure) -> tuple[None, Arrivals]:
        rig, light = self.plant.rig, self.plant.rig.light
        assert isinstance(light, DdpLight)

        def expose(*given: Any) -> Any:
            limited, taken = self._expose(*given)
            if taken.image is not None:
                self.taken.append((light.timecode, zlib.crc32(taken.data), taken.arrived_s))
            return limited, taken

        rig.expose = expose  # type: ignore[method-assign]
        return self.plant.show(state, exposure)


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    started: list[Bench] = []

    def start(*keys: str) -> Bench:
        started.append(Bench((*SMALL, *keys)))
        return started[-1]

    yield start
    for each in started:
        each.process.kill()
        each.process.wait()


def run_on(bench: Bench, rig_params: RigParams, steps: int = 40) -> tuple[Simulation, list[Taken], dict[str, Any], float]:
    """The simulated world for comparison, what was taken, the rig's statistics, and the final IoU by the light on the simulated road."""
    scenario = load("snowflake", [*SMALL, "plant.kind=rig", "checks={}", f"steps={steps}"])
    world = prepare(load("snowflake", SMALL), "cpu")
    simulation = prepare(scenario, "cpu")
    modules = lamp_modules(simulation.modules)
    with opened(rig_params, grids_of(modules), scenario.camera, armed=True) as rig:
        assert await_camera(rig, 20)
        judged = Judged(simulation.controlled, scenario.camera, rig_params.mark)
        watched = Watched(replace(RigPlant.of(rig, modules, 2 * steps), look=judged.look))
        results = list(replace(simulation, plant=from_zero(watched, scenario, modules)).evaluations())
        summary = {**rig.statistics.summary(2), "interruptions": rig.keeper.interruptions, "judged": judged.summary()}
    on, off = (each.lights for each in results[-1].exposures)
    judge = world.symbol.judge
    assert judge is not None
    verdict = judge.evaluate(world.world.added(0.0, on, off, ()), 0.0)
    return world, watched.taken, summary, float(verdict.iou)


def wrong(bench: Bench, taken: list[Taken]) -> list[Any]:
    """Frames that show something else than the light for which they were taken."""
    told, found = bench.truth()["frames"], []
    for code, crc, arrived_s in taken:
        same = [each for each in told if each["crc32"] == crc]  # dark pictures may be equal
        assert same
        sent = min(same, key=lambda each: abs(arrived_s - each["sent_s"]))
        if sent["timecodes"] != [code]:
            found.append((code, sent["timecodes"], arrived_s - sent["exposed_from_s"], arrived_s - sent["sent_s"]))
    return found


def test_on_a_good_rig_the_symbol_is_as_straight_as_in_simulation(bench: Callable[..., Bench]) -> None:
    rig = bench("faults.camera.latency_s=0.02")
    world, taken, summary, iou = run_on(rig, rig.params())
    assert not wrong(rig, taken) and len(taken) >= 70
    simulated = [float(each.symbol.verdict.iou) for each in world.evaluations()][-1]
    print(f"\nIoU {iou:.3f}, simulated {simulated:.3f}; {summary}")
    assert iou > simulated - 0.02
    assert abs(summary["judged"]["symbol"]["iou_final"] - iou) < 0.06  # with noise, and by a plane where the road is none


def test_with_jitter_lost_packets_and_flicker_no_frame_is_wrong(bench: Callable[..., Bench]) -> None:
    rig = bench(*HARD)
    light = {"kind": "ddp", "timecode": True, "host": "127.0.0.1", "port": rig.light, "bits": 16, "repeats": 3}
    _, taken, summary, iou = run_on(rig, rig.params(light=light))
    assert not wrong(rig, taken) and len(taken) >= 50
    print(f"\nIoU {iou:.3f}; {summary}")
    assert iou > 0.88


def test_light_that_comes_late_is_told_by_its_mark(bench: Callable[..., Bench]) -> None:
    rig = bench(*HARD)
    timing = {"latency_s": 0.05, "jitter_s": 0.0, "rolling_s": 0.0}  # far too short: a frame lacks packets until it is sent again
    _, taken, summary, iou = run_on(rig, rig.params(timing=timing, mark=MARK))
    assert not wrong(rig, taken) and len(taken) >= 50
    print(f"\nIoU {iou:.3f}; {summary}")
    assert summary["pictures"]["of another exposure"] > 0 and iou > 0.88
    assert abs(summary["judged"]["symbol"]["iou_final"] - iou) < 0.06
