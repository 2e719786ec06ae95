"""The rig over real sockets: what is lit comes back in pictures, and the truth says which light it was."""

import json
import socket
import threading
import time
import urllib.request
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.ego import SensorDatagram, decode
from luxloop.loop.rig.simulated.rig import Ports, SimulatedRig
from luxloop.loop.rig.wire import ddp
from luxloop.loop.rig.wire.mjpeg import parts
from luxloop.world.headlight.lamp import ModuleCommand
from tests.loop.rig.conftest import eventually
from tests.loop.rig.simulated.conftest import DARK, faults_of, scenario_of
from tests.refusal import refusal

FREE = Ports("127.0.0.1", 0, 0, 0)
LARGEST = 2**20


class Loop:
    """What a loop does with a rig: it lights frames, and keeps those that come."""

    def __init__(self, rig: SimulatedRig) -> None:
        self.rig, self.came = rig, list[tuple[float, np.ndarray, int]]()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", rig.light.port))
        self._answer = urllib.request.urlopen(f"http://127.0.0.1:{rig.pictures.port}/camera", timeout=10)
        threading.Thread(target=self._watch, daemon=True).start()

    def show(self, level: int, timecode: int, commands: Sequence[ModuleCommand] | None = None) -> None:
        codes = np.full(self.rig.rig_scene.pixels, level, np.uint8)
        ddp.send(self._socket, list(ddp.packets(codes, timecode, commands)))

    def hold(self, level: int, timecode: int, seconds: float) -> None:
        """Send the same again until it has been shown for so long."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self.show(level, timecode)
            time.sleep(0.02)

    def truth(self, path: str = "") -> Any:
        return json.load(urllib.request.urlopen(f"http://127.0.0.1:{self.rig.truth.server_address[1]}/truth{path}", timeout=10))

    def matched(self) -> list[tuple[float, np.ndarray, dict[str, Any]]]:
        """Frames that have come, with what was true of them."""
        told = {each["crc32"]: each for each in self.truth()["frames"]}
        return [(at_s, image, told[crc]) for at_s, image, crc in self.came if crc in told]

    def _watch(self) -> None:
        try:
            for part in parts(self._answer, LARGEST):
                image = cv2.imdecode(np.frombuffer(part.body, np.uint8), cv2.IMREAD_UNCHANGED)
                self.came.append((time.monotonic(), image, zlib.crc32(part.body)))
        except (OSError, ValueError):
            pass

    def close(self) -> None:
        self._answer.close()
        self._socket.close()


@contextmanager
def looped(scenario_keys: Sequence[str] = (), *faults: str, ports: Ports = FREE) -> Iterator[Loop]:
    ready = threading.Event()
    with SimulatedRig(scenario_of(*scenario_keys), faults_of(*faults), ports) as rig:
        thread = threading.Thread(target=rig.run, args=(ready.set,))
        thread.start()
        try:
            assert ready.wait(60)
            loop = Loop(rig)
            yield loop
            loop.close()
        finally:
            rig.end()
            thread.join()


def test_light_comes_back_as_pictures():
    with looped(("camera.exposure_s=0.01", *DARK)) as loop:
        loop.hold(200, 1, 0.3)
        loop.hold(100, 2, 0.3)
        whole = {
            code: image.astype(float) for _, image, told in loop.matched() for code in told["timecodes"] if len(told["timecodes"]) == 1
        }
        assert set(whole) >= {1, 2}
        unsaturated = (whole[1] > 1000) & (whole[1] < 4000)
        assert whole[2][unsaturated] / whole[1][unsaturated] == pytest.approx(0.5, abs=0.002), "linear, without noise"
        assert eventually(lambda: not loop.truth()["lit"])
        after = len(loop.came)
        assert eventually(lambda: len(loop.came) > after + 3) and not loop.came[-1][1].any()
        told = loop.truth("?since=999999")
        assert told["frames"] == [] and told["light"]["incomplete"] == 0 and told["light"]["refused"] == 0
        described = loop.truth("/rig")
        assert described["modules"][0]["pixel_rows"] * described["modules"][0]["pixel_cols"] == loop.rig.rig_scene.pixels
        assert described["camera"]["width_px"] == 160 and np.shape(described["camera"]["matrix"]) == (3, 3)


def test_it_is_dark_soon_after_the_loop_has_died():
    with looped((), "light.timeout_ms=100") as loop:
        loop.hold(255, 7, 0.2)
        last_s = time.monotonic()
        assert loop.truth()["lit"] and loop.truth()["light_sum"] == loop.rig.rig_scene.pixels
        assert eventually(lambda: not loop.truth()["lit"])
        assert loop.truth()["dark_since_s"] - last_s < 0.15
        loop.show(255, 0)
        assert eventually(lambda: loop.truth()["lit"]), "another loop may begin with any number"


def test_lost_packets_never_light_a_part():
    with looped(DARK, "light.packet_loss=0.2", "light.timeout_ms=1000") as loop:  # of twelve packets a frame one in fourteen comes whole
        for k in range(1, 60):
            loop.show(255 * (k % 2), k)
            time.sleep(0.01)
        light = loop.rig.light
        assert 0 < light.counts()["frames"] < 40 and light.counts()["incomplete"] > 20
        dark_or_full = {len(each["timecodes"]) for each in loop.truth()["frames"]}
        assert dark_or_full
        loop.hold(255, 60, 0.5)
        assert loop.truth()["lit"] and loop.truth()["light_sum"] == loop.rig.rig_scene.pixels, "what is sent again is repaired"


def test_commands_dim_a_module():
    with looped(DARK) as loop:
        for k in range(1, 15):
            loop.show(100, k, (ModuleCommand(intensity=0.5),))
            time.sleep(0.02)
        dimmed = loop.came[-1][1].astype(float)
        for k in range(50, 65):
            loop.show(50, k, (ModuleCommand(),))
            time.sleep(0.02)
        assert abs(loop.came[-1][1] - dimmed).max() < 0.05 * dimmed.max()  # both ways through the lamp round differently


def test_a_vehicle_drives_and_tells_of_it():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ego:
        ego.bind(("127.0.0.1", 0))
        ego.settimeout(5)
        keys = (
            "vehicle={course=[{speed_m_s=10}]}",
            "renderer=raycast",
            "sensors.gyro.rate_hz=100",
            "camera.width_px=80",
            "camera.height_px=60",
        )
        with looped(keys, ports=Ports("127.0.0.1", 0, 0, 0, ego.getsockname())) as loop:
            standing = [decode(ego.recv(4096)) for _ in range(4)]
            assert {each.sensor for each in standing} == {"wheels", "gyro", "accelerometer", "suspension"}
            loop.hold(255, 1, 0.6)
            begun_s = loop.rig.timeline.begun_s
            samples = list[SensorDatagram]()
            while not samples or samples[-1].measured_s < begun_s + 0.3:
                samples.append(decode(ego.recv(4096)))
            gyro = [each.measured_s - begun_s for each in samples if each.sensor == "gyro" and each.measured_s > begun_s]
            assert len(gyro) >= 25 and np.allclose(np.diff(gyro), 0.01, atol=1e-6)
            assert [each.values for each in samples if each.sensor == "wheels"][-1] == pytest.approx((10.0,), rel=1e-3)
            assert all(-1e-3 < each.age_s < 0.2 for each in samples if each.measured_s > begun_s)
            assert loop.rig.rig_scene._lit[False].scene.vehicle.T_world_body[0, 3] > 1, "and the camera drives along"


def test_addresses_that_are_taken_are_told(rig_scene):
    with looped() as loop:
        for name, port in (("light", loop.rig.light.port), ("camera", loop.rig.pictures.port), ("truth", loop.rig.truth.server_address[1])):
            taken = {"light": 0, "camera": 0, "truth": 0, name: port}
            with refusal(rf"--{name}-port \d+: cannot listen on 127.0.0.1"):
                SimulatedRig(scenario_of(), faults_of(), Ports("127.0.0.1", **taken))
