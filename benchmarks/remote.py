"""What a plant in another process costs: `python benchmarks/remote.py [--json FILE] [--quick]`.

The same exposures are shown on a plant whose frames are ready at once: in this process, and behind the socket of docs/programs.md, whose
other end is a process of its own. Processor time of the loop's process and steps a second, of two exposures each.
"""

import argparse
import json
import socket
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from bench import machine, on_one_thread
from rich.table import Table
from websockets.sync.client import connect

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.report import terminal as tables
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.clock import FromZero
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame, Plant
from luxloop.loop.simulation.remote_plant import RemotePlant
from luxloop.loop.studio.client.decoding import unpacked
from luxloop.world.messages import pack, raw

SIZES = ((640, 360), (1280, 720))
STEPS = 100
PERIOD_S = 1 / 30


class Ready:
    """Frames that are there. state: none."""

    def __init__(self, image: torch.Tensor) -> None:
        self.image = image

    def start(self) -> tuple[None, Arrivals]:
        return None, Arrivals(0.0)

    def show(self, state: None, exposure: Exposure) -> tuple[None, Arrivals]:
        end_s = exposure.start_s + exposure.duration_s
        return None, Arrivals(end_s, (Frame(exposure.number, exposure.start_s, end_s, self.image.clone()),))


def answer(address: str) -> None:
    """The other process: frames that are there."""
    while True:
        try:
            there = connect(address, max_size=None, compression=None, proxy=None)
            break
        except OSError:
            time.sleep(0.05)
    with there:
        there.send(pack({"type": "hello", "protocol": 1}))
        image, came = np.zeros((1, 1), np.uint16), {"type": "arrivals", "number": None, "time_s": 0.0}
        for data in there:
            assert isinstance(data, bytes)
            head, _ = unpacked(data)
            if head["type"] == "welcome":
                image = np.full((head["camera"]["height"], head["camera"]["width"]), 100, np.uint16)
            elif head["type"] == "start":
                there.send(pack(came))
            elif head["type"] == "show":
                end_s = head["start_s"] + head["duration_s"]
                frame = {"number": head["number"], "taken_s": head["start_s"], "arrived_s": end_s}
                told = came | {"number": head["number"], "time_s": end_s, "frames": [frame]}
                there.send(pack(told, {f"frame.{head['number']}": raw(image)}))


def measured(plant: Plant, lights: tuple[Utilisation, ...], steps: int) -> tuple[float, float]:
    """Median processor time and time of a step in ms."""
    state, arrivals = plant.start()
    cpu_ms, wall_ms = list[float](), list[float]()
    for step in range(steps):
        cpu, wall = time.process_time(), time.perf_counter()
        for part in (0, 1):
            state, arrivals = plant.show(state, Exposure(2 * step + part, arrivals.time_s, PERIOD_S / 2, lights))
            assert arrivals.frames[0].image is not None
        cpu_ms.append(1e3 * (time.process_time() - cpu))
        wall_ms.append(1e3 * (time.perf_counter() - wall))
    return median(cpu_ms), median(wall_ms)


def compared(size: tuple[int, int], sends: str, lit: str, steps: int) -> dict[str, Any]:
    """Both plants, with the light of a symbol or of all pixels."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        address = f"127.0.0.1:{listening.getsockname()[1]}"
    plant = {"kind": "remote", "address": address, "sends": sends, "timeout_s": 60.0}
    camera = {"width_px": size[0], "height_px": size[1]}
    simulation = prepare(load("flat", [{"plant": plant, "camera": camera}]), "cpu")
    remote, projector = simulation.plant, simulation.symbol.projector
    assert isinstance(remote, FromZero) and isinstance(remote.plant, RemotePlant)
    lights = projector.light(projector.target) if lit == "symbol" else tuple(Utilisation(each.u + 1) for each in projector.resting)
    _, arrays = remote.plant.parts(Exposure(0, 0.0, 1.0, lights))
    here = FromZero(Ready(lights[0].u.new_full((size[1], size[0]), 100.0)), "here", simulation.scenario.camera, lights[0].u)
    with subprocess.Popen([sys.executable, __file__, "--answer", f"ws://{address}"]) as other:
        try:
            cpu_ms, ms = measured(remote, lights, steps)
        finally:
            remote.close()
            other.kill()
    here_cpu_ms, _ = measured(here, lights, steps)
    sizes = {"light_bytes": 2 * sum(len(each.data) for each in arrays.values()), "frame_bytes": 2 * 2 * size[0] * size[1]}
    return {"camera_px": size, "sends": sends, "lit": lit, **sizes, "ms": ms, "cpu_ms": cpu_ms, "here_cpu_ms": here_cpu_ms}


def main() -> None:
    on_one_thread("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--answer", help="the other process")
    given = parser.parse_args()
    if given.answer:
        answer(given.answer)
        return
    cases = [(size, sends, lit) for size in SIZES for sends in ("utilisation", "texture") for lit in ("symbol", "all pixels")]
    found = [compared(*case, STEPS) for case in cases] if not given.quick else [compared(*cases[0], 4)]
    table = Table("camera", "sends", "lit", "MB a step, light", "MB a step, frames", "steps/s", "cpu ms a step", "in this process")
    for each in found:
        size = " x ".join(map(str, each["camera_px"]))
        bytes_ = [f"{1e-6 * each[name]:.2f}" for name in ("light_bytes", "frame_bytes")]
        rates = f"{1e3 / each['ms']:.0f}", f"{each['cpu_ms']:.1f}", f"{each['here_cpu_ms']:.1f}"
        table.add_row(size, each["sends"], each["lit"], *bytes_, *rates)
    tables.show(table)
    if given.json:
        given.json.write_text(json.dumps({"machine": machine("websockets", "numpy"), "cases": found}, indent=1))


if __name__ == "__main__":
    main()
