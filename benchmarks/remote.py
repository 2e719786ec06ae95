"""What a plant in another process costs: `python benchmarks/remote.py [--json FILE] [--quick]`.

The same exposures are shown on a plant whose frames are ready at once: in this process, and behind the socket of docs/programs.md, whose
other end is a process of its own. Processor time of the loop's process and steps a second, of two exposures each.
"""

import itertools
import multiprocessing
import socket
import time
from argparse import Namespace
from typing import Any

import numpy as np
import torch
from bench import Laps, medians, run, show
from websockets.sync.client import connect

from luxloop import Arrivals, Exposure, Frame, Utilisation, load, prepare
from luxloop.loop.simulation.clock import FromZero
from luxloop.loop.simulation.protocol import Plant
from luxloop.loop.studio.inbox import unpack
from luxloop.world.messages import pack, raw

PERIOD_S = 1 / 30


class LocalPlant:
    """Frames that are ready at once. state: none."""

    def __init__(self, image: torch.Tensor) -> None:
        self.image = image

    def start(self) -> tuple[None, Arrivals]:
        return None, Arrivals(0.0)

    def show(self, state: None, exposure: Exposure) -> tuple[None, Arrivals]:
        end_s = exposure.start_s + exposure.duration_s
        return None, Arrivals(end_s, (Frame(exposure.number, exposure.start_s, end_s, self.image.clone()),))


def answer(address: str, width: int, height: int) -> None:
    """The other process: frames that are ready at once."""
    image, came = np.full((height, width), 100, np.uint16), {"type": "arrivals", "number": None, "time_s": 0.0}
    while True:
        try:
            there = connect(address, max_size=None, compression=None, proxy=None)
            break
        except OSError:
            time.sleep(0.05)
    with there:
        there.send(pack({"type": "hello", "protocol": 1}))
        for data in there:
            head, _ = unpack(data)
            if head["type"] == "start":
                there.send(pack(came))
            elif head["type"] == "show":
                end_s = head["start_s"] + head["duration_s"]
                frame = {"number": head["number"], "taken_s": head["start_s"], "arrived_s": end_s}
                arrivals = came | {"number": head["number"], "time_s": end_s, "frames": [frame]}
                there.send(pack(arrivals, {f"frame.{head['number']}": raw(image)}))


def step_ms(plant: Plant, lights: tuple[Utilisation, ...], steps: int) -> dict[str, float]:
    """Median processor time and time by the clock of a step in ms."""
    (state, arrivals), rows = plant.start(), []
    for step in range(steps):
        laps, began_s = Laps(), time.perf_counter()
        for part in (0, 1):
            state, arrivals = plant.show(state, Exposure(2 * step + part, arrivals.time_s, PERIOD_S / 2, lights))
            assert arrivals.frames[0].image is not None
        rows.append({"cpu": laps.lap("cpu"), "clock": 1e3 * (time.perf_counter() - began_s)})
    return medians(rows)


def compare(size: tuple[int, int], sends: str, lit: str, steps: int) -> dict[str, Any]:
    """Both plants, with the light of a symbol or of all pixels."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        address = f"127.0.0.1:{listening.getsockname()[1]}"
    plant = {"kind": "remote", "address": address, "sends": sends, "timeout_s": 60.0}
    simulation = prepare(load("flat", [{"plant": plant, "camera": {"width_px": size[0], "height_px": size[1]}}]), "cpu")
    remote, projector = simulation.plant, simulation.symbol.projector
    lights = projector.light(projector.target) if lit == "symbol" else tuple(Utilisation(each.u + 1) for each in projector.resting)
    _, arrays = remote.plant.parts(Exposure(0, 0.0, 1.0, lights))
    here = FromZero(LocalPlant(lights[0].u.new_full((size[1], size[0]), 100.0)), "here", simulation.scenario.camera, lights[0].u)
    other = multiprocessing.get_context("spawn").Process(target=answer, args=(f"ws://{address}", *size), daemon=True)
    other.start()
    try:
        there = step_ms(remote, lights, steps)
    finally:
        remote.close()
        other.kill()
    megabytes = {"light": 2e-6 * sum(len(each.data) for each in arrays.values()), "frames": 4e-6 * size[0] * size[1]}
    own = step_ms(here, lights, steps)
    return {"MB a step": megabytes, "steps/s": 1e3 / there["clock"], "cpu ms a step": there["cpu"], "in this process": own["cpu"]}


def measure(given: Namespace) -> dict[str, Any]:
    found = {
        f"{size[0]} x {size[1]} px, {sends}, {lit}": compare(size, sends, lit, given.steps)
        for size, sends, lit in itertools.product(given.sizes_px, given.sends, given.lit)
    }
    show("A plant in another process", found)
    return {"cases": found}


if __name__ == "__main__":
    run(measure, __doc__)
