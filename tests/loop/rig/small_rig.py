"""A small rig as a process of its own, with real sockets: it takes DDP, and serves a camera whose pictures say what they show.

    python small_rig.py LIGHT_PORT CAMERA_PORT PIXELS [KEY=VALUE ...]

A picture of 64 x 48 px is as bright as the light's mean. Its first row of pixels tells the time codes plus 1 that were lit during its
exposure, the first and the last of them, as four bytes each, 0 for the dark; the loop does not look there.
"""

import random
import socket
import sys
import threading
import time
from itertools import pairwise

import cv2
import numpy as np

from luxloop.loop.rig.wire.ddp import LARGEST_PACKET, Assembler
from luxloop.loop.rig.wire.mjpeg import PNG, Part, PictureServer

DEFAULTS = {
    "period_s": 0.02,
    "exposure_s": 0.005,
    "latency_s": 0.01,
    "jitter_s": 0.0,
    "light_s": 0.0,
    "loss": 0.0,
    "dark_s": 0.1,
    "width": 64,
    "height": 48,
    "mute_after_s": 1e9,
    "mute_for_s": 0.0,
}


class Lamp:
    """What is lit since when: (time, time code plus 1 or 0 in the dark, mean share)."""

    def __init__(self, port: int, pixels: int, light_s: float, loss: float, dark_s: float) -> None:
        self.history = [(0.0, 0, 0.0)]
        self.light_s, self.loss, self.dark_s = light_s, loss, dark_s
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**22)
        self.socket.bind(("127.0.0.1", port))
        self.socket.settimeout(0.01)
        self.assembler = Assembler(pixels)
        threading.Thread(target=self.run, daemon=True).start()

    def run(self) -> None:
        drawn, last_s = random.Random(1), time.monotonic()
        while True:
            try:
                packet = self.socket.recv(LARGEST_PACKET + 1)
            except TimeoutError:
                packet = b""
            now_s = time.monotonic()
            frame = self.assembler.take(packet) if packet and drawn.random() >= self.loss else None
            if frame is not None:
                last_s = now_s
                code = frame.timecodes[0] + 1
                if self.history[-1][1] != code:
                    share = float(frame.codes.mean()) / np.iinfo(frame.codes.dtype).max
                    self.history.append((now_s + self.light_s, code if share else 0, share))
            elif now_s - last_s > self.dark_s and self.history[-1][1]:
                self.history.append((now_s, 0, 0.0))
                self.assembler.forget()

    def during(self, from_s: float, to_s: float) -> list[tuple[float, int, float]]:
        """What was lit at any time of an exposure, with the share of the exposure."""
        entries = [*self.history, (float("inf"), 0, 0.0)]
        found = []
        for (since_s, code, share), (until_s, *_) in pairwise(entries):
            lasts_s = min(until_s, to_s) - max(since_s, from_s)
            if lasts_s > 0:
                found.append((lasts_s / (to_s - from_s), code, share))
        return found


def main() -> None:
    light_port, camera_port, pixels, *given = sys.argv[1:]
    keys = DEFAULTS | {name: float(value) for name, _, value in (each.partition("=") for each in given)}
    lamp = Lamp(int(light_port), int(pixels), keys["light_s"], keys["loss"], keys["dark_s"])
    server = PictureServer("127.0.0.1", int(camera_port))
    print("ready", flush=True)
    drawn, began_s = random.Random(2), time.monotonic()
    k, ready_s = 0, 0.0
    while True:
        k += 1
        from_s = began_s + k * keys["period_s"]
        to_s = from_s + keys["exposure_s"]
        ready_s = max(ready_s, to_s + keys["latency_s"] + drawn.uniform(0, keys["jitter_s"]))
        time.sleep(max(ready_s - time.monotonic(), 0))
        if keys["mute_after_s"] < time.monotonic() - began_s < keys["mute_after_s"] + keys["mute_for_s"]:
            continue
        lit = lamp.during(from_s, to_s)
        level = sum(part * share for part, _, share in lit)
        picture = np.full((int(keys["height"]), int(keys["width"])), round(20 + 200 * level), np.uint8)
        codes = [code for _, code, _ in lit] or [0]
        picture[0, :8] = np.frombuffer(np.array([codes[0], codes[-1]], "<u4").tobytes(), np.uint8)
        server.publish(Part(cv2.imencode(".png", picture)[1].tobytes(), PNG))


if __name__ == "__main__":
    main()
