"""The rig: all its parts in one process."""

import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from types import TracebackType
from typing import Any, Final, Self

import cv2
import numpy as np
import torch

from luxloop.loop.rig.simulated.board import readings
from luxloop.loop.rig.simulated.camera import BenchCamera, End, Exposed
from luxloop.loop.rig.simulated.faults import FaultParams
from luxloop.loop.rig.simulated.light_input import DdpInput
from luxloop.loop.rig.simulated.scene import LitBench
from luxloop.loop.rig.simulated.screen_input import ScreenInput
from luxloop.loop.rig.simulated.sensors import SensorSender
from luxloop.loop.rig.simulated.timeline import Timeline
from luxloop.loop.rig.simulated.truth import TruthServer
from luxloop.loop.rig.wire.ddp import LightFrame
from luxloop.loop.rig.wire.mjpeg import Part, PictureServer
from luxloop.loop.scenario.model import Scenario
from luxloop.perception.sensors import Sensors
from luxloop.world.scene.vehicle import STANDING

SWITCH_S: Final = 0.0005  # after which a thread that waits for Python gets it, so that no packet is late


@dataclass(frozen=True)
class Ports:
    """Where a rig listens, 0 for a free port, and the address to which it sends the sensors' samples.

    truth: None for no truth. screen: address of a loop's page, from which light comes in place of the network.
    """

    host: str = "127.0.0.1"
    light: int = 4048
    camera: int = 8080
    truth: int | None = 8081
    ego: tuple[str, int] = ("127.0.0.1", 4049)
    screen: tuple[str, int] | None = None


class Rig:
    """A rig that runs in real time; `run` exposes frames in the thread that calls it, which owns the renderer."""

    def __init__(self, scenario: Scenario, faults: FaultParams, ports: Ports) -> None:
        """Build the scene and listen. Raises LuxloopError where something of the scenario or a port cannot be had."""
        self.scenario, self.faults, self.ports = scenario, faults, ports
        self.bench = LitBench(scenario, faults)
        self.timeline = Timeline(faults.light.timeout_ms / 1000, faults.light.latency_s)
        with ExitStack() as opened:

            def open_(part: Any) -> Any:
                opened.callback(part.close)
                return part

            self.pictures: PictureServer = open_(PictureServer(ports.host, ports.camera))
            self.camera: BenchCamera = open_(BenchCamera(self.bench, self.timeline, faults, self._send))
            self.light: DdpInput | ScreenInput = open_(self._input())
            self.truth: TruthServer | None = None
            if ports.truth is not None:
                self.truth = open_(TruthServer(ports.host, ports.truth, self._state, self.description()))
            motion = self.bench.world.motion
            if motion is not STANDING:
                sensors = Sensors(motion, scenario.sensors, 1 / scenario.rate_hz, scenario.seed)
                open_(SensorSender(sensors, self.timeline, ports.ego))
            self._opened = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Stop to listen and to send."""
        self._opened.close()

    def run(self, end: End, ready: Callable[[], None] = lambda: None) -> None:
        """Expose and send frames until the end. ready: called when the first light could come."""
        torch.set_num_threads(1)
        cv2.setNumThreads(1)
        sys.setswitchinterval(SWITCH_S)
        self.bench.light(LightFrame(np.zeros(self.bench.pixels, np.uint8), (0,)), 0.0)  # so that the first light waits for nothing
        ready()
        self.camera.run(end)

    def addresses(self) -> list[str]:
        """A line for each of its addresses."""
        host, lens, modules = self.ports.host, self.bench.lens, self.bench.modules
        shown = ", ".join(f"{each.name} {each.headlight.pixel_rows} x {each.headlight.pixel_cols}" for each in modules)
        camera = f"{lens.width} x {lens.height} px, {self.bench.camera.bits} bits"
        lines = [f"light:  {self.light.where}, {self.bench.pixels:,} pixels: {shown}"]
        lines += [f"camera: http://{host}:{self.pictures.port}{self.pictures.path} ({camera})"]
        if self.bench.world.motion is not STANDING:
            lines += [f"ego:    samples go to udp://{self.ports.ego[0]}:{self.ports.ego[1]} from the first light on"]
        if self.camera.board is not None:
            read = " ".join(f"{lux:.5g}@{u:.1f},{v:.1f}" for lux, u, v in readings(self.bench))
            lines += [f"luxmeter: {read} (lx at px of the camera, all pixels on)"]
        if self.truth is not None:
            lines += [f"truth:  http://{host}:{self.truth.port}/truth (for tests)"]
        return lines

    def description(self) -> dict[str, Any]:
        """What the rig truly is, as plain data."""
        bench, lens = self.bench, self.bench.lens
        T_world_camera = bench.world.view.T_world_view.tolist()
        camera = {"width_px": lens.width, "height_px": lens.height, "matrix": lens.matrix.tolist(), "T_world_camera": T_world_camera}
        modules = [
            {
                "name": each.name,
                "pixel_rows": each.headlight.pixel_rows,
                "pixel_cols": each.headlight.pixel_cols,
                "T_world_headlight": each.T_world_headlight.tolist(),
            }
            for each in bench.modules
        ]
        return {"scenario": self.scenario.name, "camera": camera, "modules": modules, "faults": self.faults.model_dump(mode="json")}

    def _input(self) -> DdpInput | ScreenInput:
        if self.ports.screen is None:
            address = self.ports.host, self.ports.light
            return DdpInput(self.timeline, self.bench.pixels, self.faults.light, address, self.faults.seed)
        grids = [(each.headlight.pixel_rows, each.headlight.pixel_cols) for each in self.bench.modules]
        return ScreenInput(self.timeline, grids, self.ports.screen)

    def summary(self) -> str:
        """What it has done, in a line."""
        camera, light = self.camera, self.light.counts()
        lost = f"{camera.lost} lost, {camera.skipped} skipped"
        return f"{camera.exposures} frames exposed ({lost}), {light.frames} frames of light ({light.incomplete} incomplete)"

    def _send(self, part: Part, exposed: Exposed) -> None:
        if self.truth is not None:
            self.truth.add(exposed)
        self.pictures.publish(part)

    def _state(self) -> dict[str, Any]:
        counts, camera = self.light.counts()._asdict(), self.camera
        return {**asdict(self.timeline.state()), "light": counts, "skipped": camera.skipped, "lost": camera.lost}
