"""A simulator for tests: `python simulator.py ADDRESS [how=value ...]` is luxloop's simulated world behind docs/programs.md.

It plays one run. after=N: dies without a word when exposure N is shown. objects=S: it tells of a pedestrian, who is there for S s.
"""

import os
import sys
import time

import numpy as np
import torch
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import validate
from luxloop.loop.simulation.protocol import Arrivals, Exposure
from luxloop.world.headlight.lamp import ModuleCommand
from tests.loop.studio.clients import message, unpacked

WALKER = {"name": "walker", "category": "pedestrian", "size_m": [0.5, 0.5, 1.8]}


def told(number: int | None, arrivals: Arrivals, there_s: float | None) -> bytes:
    """An answer."""
    frames, arrays = [], {}
    for each in arrivals.frames:
        times = {"taken_s": each.taken_s, "arrived_s": each.arrived_s, "lost": each.image is None}
        frames.append({"number": each.number, **times})
        if each.image is not None:
            arrays[f"frame.{each.number}"] = each.image[:, :].numpy().astype(np.uint16)
    samples = [
        {"sensor": each.sensor, "measured_s": each.measured_s, "arrived_s": each.arrived_s, "values": each.values.tolist()}
        for each in arrivals.samples
    ]
    foot = np.eye(4)
    foot[:2, 3] = 30 - 10 * arrivals.time_s, -2.0
    objects = None
    if there_s is not None:
        objects = [WALKER | {"T_ground_object": foot.ravel().tolist()}] if arrivals.time_s < there_s else []
    head = {"type": "arrivals", "number": number, "time_s": arrivals.time_s, "frames": frames, "samples": samples}
    return message(arrays, "raw", **head, objects=objects)


def main(address: str, *given: str) -> None:
    """Play one run."""
    how = dict(each.split("=") for each in given)
    while True:
        try:
            socket = connect(address, max_size=None, compression=None, proxy=None)
            break
        except OSError:
            time.sleep(0.05)
    with socket:
        socket.send(message(type="hello", protocol=1, name="test simulator"))
        welcome, _ = unpacked(socket.recv())
        simulation = prepare(validate(welcome["model"] | {"plant": {"kind": "simulated"}}, "simulator"), "cpu")
        state, sizes = None, [(each["pixel_rows"], each["pixel_cols"]) for each in welcome["modules"]]
        try:
            for data in socket:
                head, arrays = unpacked(data)
                if head["type"] == "start":
                    state, arrivals = simulation.plant.start()
                elif head["type"] == "show":
                    if head["number"] == int(how.get("after", -1)):
                        os._exit(1)
                    lights = []
                    for k, (size, (top, bottom, left, right)) in enumerate(zip(sizes, head["windows"], strict=True)):
                        u = torch.zeros(size)
                        u[top:bottom, left:right] = torch.from_numpy(arrays[f"light.{k}"].copy())
                        lights.append(Utilisation(u.flatten()))
                    commands = tuple(ModuleCommand(**each) for each in head["commands"])
                    exposure = Exposure(head["number"], head["start_s"], head["duration_s"], tuple(lights), commands=commands)
                    state, arrivals = simulation.plant.show(state, exposure)
                else:
                    print(head, flush=True)
                    continue
                socket.send(told(head["number"], arrivals, float(how["objects"]) if "objects" in how else None))
        except ConnectionClosed:
            pass


if __name__ == "__main__":
    main(*sys.argv[1:])
