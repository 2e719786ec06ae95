"""The rig process: its parts, sensors, and the truth for tests."""

import json
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from dataclasses import asdict, dataclass
from http.server import BaseHTTPRequestHandler
from typing import Any, Self
from urllib.parse import parse_qs, urlsplit

import cv2
import numpy as np
import torch

from luxloop.loop.rig.arrays import grids_of
from luxloop.loop.rig.ego import encode
from luxloop.loop.rig.simulated.board import readings
from luxloop.loop.rig.simulated.camera import FrameTruth, RigCamera
from luxloop.loop.rig.simulated.faults import FaultParams
from luxloop.loop.rig.simulated.lamp import DdpInput, ScreenInput, Timeline
from luxloop.loop.rig.simulated.scene import RigScene
from luxloop.loop.rig.wire.ddp import LightFrame
from luxloop.loop.rig.wire.mjpeg import Part, PictureServer
from luxloop.loop.rig.wire.sockets import serve_http, udp_sender
from luxloop.loop.scenario.model import Scenario
from luxloop.perception.sensors import Sensors
from luxloop.world.scene.vehicle import STANDING

PERIOD_S = 0.002  # interval of sending due samples
STANDING_S = 0.05  # interval of repeating the initial samples before the drive
MOST_FRAMES = 4096
SWITCH_S = 0.0005  # interpreter's switch interval, so that no packet is late


@dataclass(frozen=True)
class Ports:
    """Ports of a rig, 0 for a free one, and the destination of sensor samples.

    screen: address of a loop's page, from which light comes instead of the network.
    """

    host: str = "127.0.0.1"
    light: int = 4048
    camera: int = 8080
    truth: int = 8081
    ego: tuple[str, int] = ("127.0.0.1", 4049)
    screen: tuple[str, int] | None = None


class SimulatedRig:
    """A rig in real time; `run` exposes frames in the caller's thread, which owns the renderer.

    truth: server of the truth, for tests.
    """

    def __init__(self, scenario: Scenario, faults: FaultParams, ports: Ports) -> None:
        """Build the scene and listen. Raises LuxloopError if a part of the scenario or a port is not available."""
        self.scenario, self.faults, self.ports = scenario, faults, ports
        self.rig_scene = RigScene(scenario, faults)
        self._grids = grids_of(self.rig_scene.modules)
        self.timeline = Timeline(faults.light.timeout_ms / 1000, faults.light.latency_s)
        self._frames, self._lock, self._closed = deque[FrameTruth](maxlen=MOST_FRAMES), threading.Lock(), threading.Event()
        with ExitStack() as stack:
            self.pictures = stack.enter_context(closing(PictureServer(ports.host, ports.camera)))
            self.camera = stack.enter_context(closing(RigCamera(self.rig_scene, self.timeline, faults, self._send)))
            self.light = stack.enter_context(closing(self._input()))
            self.truth = stack.enter_context(serve_http(f"--truth-port {ports.truth}", ports.host, ports.truth, self._answer))
            stack.callback(self.truth.shutdown)
            motion = self.rig_scene.world.motion
            if motion is not STANDING:
                sensors = Sensors(motion, scenario.sensors, 1 / scenario.rate_hz, scenario.seed)
                to = stack.enter_context(udp_sender("--ego", *ports.ego))
                thread = threading.Thread(target=self._send_samples, args=(sensors, to), name="sensors", daemon=True)
                thread.start()
                stack.callback(thread.join)
            stack.callback(self._closed.set)
            self._opened = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Stop listening and sending."""
        self._opened.close()

    def run(self, ready: Callable[[], None] = lambda: None) -> None:
        """Expose and send frames until `end` is called. ready: called when light can be received."""
        torch.set_num_threads(1)
        cv2.setNumThreads(1)
        sys.setswitchinterval(SWITCH_S)
        self.rig_scene.light(LightFrame(np.zeros(self.rig_scene.pixels, np.uint8), (0,)), 0.0)  # prepares the renderer
        ready()
        self.camera.run()

    def end(self) -> None:
        """End `run`, from any thread or a signal handler, which must not wait for a lock."""
        self.camera.ended = True

    def addresses(self) -> list[str]:
        """A line for each address."""
        host, lens, modules = self.ports.host, self.rig_scene.lens, self.rig_scene.modules
        shown = ", ".join(f"{each.name} {rows} x {columns}" for each, (rows, columns) in zip(modules, self._grids, strict=True))
        camera = f"{lens.width} x {lens.height} px, {self.rig_scene.camera.bits} bits"
        lines = [f"light:  {self.light.where}, {self.rig_scene.pixels:,} pixels: {shown}"]
        lines += [f"camera: http://{host}:{self.pictures.port}{self.pictures.path} ({camera})"]
        if self.rig_scene.world.motion is not STANDING:
            lines += [f"ego:    samples go to udp://{self.ports.ego[0]}:{self.ports.ego[1]} from the first light on"]
        if self.camera.board is not None:
            read = " ".join(f"{lux:.5g}@{u:.1f},{v:.1f}" for lux, u, v in readings(self.rig_scene))
            lines += [f"luxmeter: {read} (lx at px of the camera, all pixels on)"]
        return [*lines, f"truth:  http://{host}:{self.truth.server_address[1]}/truth (for tests)"]

    def description(self) -> dict[str, Any]:
        """The true rig as plain data."""
        rig_scene, lens = self.rig_scene, self.rig_scene.lens
        T_world_camera = rig_scene.world.view.T_world_view.tolist()
        camera = {"width_px": lens.width, "height_px": lens.height, "matrix": lens.matrix.tolist(), "T_world_camera": T_world_camera}
        modules = [
            {"name": each.name, "pixel_rows": rows, "pixel_cols": columns, "T_world_headlight": each.T_body_headlight.tolist()}
            for each, (rows, columns) in zip(rig_scene.modules, self._grids, strict=True)
        ]
        return {"scenario": self.scenario.name, "camera": camera, "modules": modules, "faults": self.faults.model_dump(mode="json")}

    def _input(self) -> DdpInput | ScreenInput:
        if self.ports.screen is None:
            address = self.ports.host, self.ports.light
            return DdpInput(self.timeline, self.rig_scene.pixels, self.faults.light, address, self.faults.seed)
        return ScreenInput(self.timeline, self._grids, self.ports.screen)

    def summary(self) -> str:
        """A line of statistics."""
        camera, light = self.camera, self.light.counts()
        lost = f"{camera.lost} lost, {camera.skipped} skipped"
        return f"{camera.exposures} frames exposed ({lost}), {light['frames']} frames of light ({light['incomplete']} incomplete)"

    def _send(self, part: Part, exposed: FrameTruth) -> None:
        with self._lock:
            self._frames.append(exposed)
        self.pictures.publish(part)

    def _answer(self, handler: BaseHTTPRequestHandler) -> None:
        """Answer GET requests: `/truth` gives frames in the order of sending and the lamp's state, `/truth?since=INDEX` only frames from
        that index on, `/truth/rig` the description.
        """
        asked = urlsplit(handler.path)
        if asked.path == "/truth/rig":
            found = self.description()
        elif asked.path == "/truth":
            given = parse_qs(asked.query).get("since", ["0"])[0]
            since = int(given) if given.isdecimal() and len(given) < 16 else 0
            with self._lock:
                frames = [asdict(each) for each in self._frames if each.index >= since]
            found = {"frames": frames, **self._state()}
        else:
            handler.send_error(404)
            return
        body = json.dumps(found).encode()
        with suppress(OSError):  # the client has gone
            handler.send_response(200)
            handler.send_header("Content-Type", "application/json")
            handler.send_header("Content-Length", str(len(body)))
            handler.end_headers()
            handler.wfile.write(body)

    def _send_samples(self, sensors: Sensors, to: socket.socket) -> None:
        """Send due samples of the vehicle's sensors; the drive begins with the first light."""
        like, sent_s = torch.empty(0), 0.0
        while not self._closed.wait(STANDING_S if self.timeline.begun_s is None else PERIOD_S):
            now_s, begun_s = time.monotonic(), self.timeline.begun_s
            if begun_s is None:
                samples, zero_s = sensors.newest(0.0, like), now_s
            else:
                samples, zero_s = sensors.arriving(sent_s, max(now_s - begun_s, sent_s), like), begun_s
                sent_s = max(now_s - begun_s, sent_s)
            with suppress(OSError):  # without a listener
                for each in samples:
                    to.send(encode(each.sensor, zero_s + each.measured_s, time.monotonic(), each.values.tolist()))

    def _state(self) -> dict[str, Any]:
        counts, camera = self.light.counts(), self.camera
        return {**self.timeline.state(), "light": counts, "skipped": camera.skipped, "lost": camera.lost}
