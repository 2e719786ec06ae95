"""Messages of the studio's clients, and of a simulator that is the plant, as a test damages and reads them."""

import functools
import json
import random
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from luxloop.loop.scenario.edits import with_overrides
from luxloop.loop.simulation import remote_messages as answers
from luxloop.loop.simulation.clock import FromZero
from luxloop.loop.simulation.protocol import Exposure
from luxloop.loop.simulation.remote import Link, RemotePlant
from luxloop.loop.studio.messages import Paint, Place, Set, Wish, read
from luxloop.loop.studio.painting import paint, place, wish
from luxloop.loop.studio.runs import Run, start
from luxloop.loop.studio.sources import Source, refuse_foreign
from luxloop.perception.camera import CameraParams
from luxloop.world.messages import Arrays
from tests.fuzz import mutations
from tests.loop.studio.clients import message
from tests.loop.studio.conftest import SMALL

SIZE = (90, 160)
PICTURE = {name: np.full((20, 30), 7, np.uint8) for name in ("value", "painted")}
LUX = {"lx": np.full((8, 6), 2, np.float32), "painted": np.full((8, 6), 255, np.uint8)}
POSE = [1, 0, 0, 20, 0, 1, 0, -2, 0, 0, 1, 0, 0, 0, 0, 1]
OBJECT = {"name": "walker", "category": "pedestrian", "T_ground_object": POSE, "size_m": [0.5, 0.5, 1.8]}
SAMPLES = [{"sensor": name, "measured_s": 1.5, "arrived_s": 1.5, "values": [0.1] * n} for name, n in (("wheels", 2), ("gyro", 3))]
CAME = {"type": "arrivals", "number": 0, "time_s": 1.5, "samples": SAMPLES, "objects": [OBJECT, OBJECT | {"name": "other"}]}


def of_studio(folder: Path) -> dict[str, bytes]:
    """One of each type that has values."""
    heads: list[dict[str, Any]] = [
        {"type": "hello", "token": "t"},
        {"type": "want", "views": ["scene", "truth"], "shared": True, "ask": 1},
        {"type": "scrub", "run": 0, "step": 2},
        {"type": "beam", "rule": "r149-passing-c", "step": 0},
        {"type": "speed", "factor": 1.0},
        {"type": "open", "name": "flat", "overrides": ["steps=3"]},
        {"type": "set", "overrides": ["functions.symbol.x_m=18.0", "camera.bits=8"], "ask": 3},
        {"type": "record", "folder": "mine"},
        {"type": "drive", "throttle": 0.5, "steering": -0.5},
        {"type": "compare", "overrides": ["seed=1"]},
        {"type": "place", "point_m": [20, 0, 0], "value": 9},
    ]
    paint = [message(PICTURE, coding, type="paint", module=0, box=[0, 20, 0, 30]) for coding in ("raw", "deflate", "png")]
    boxes = {"road": [10.0, 30.0, -5.0, 5.0], "wall": [-1.0, 1.0, -3.0, 3.0]}
    wish = [message(LUX, type="wish", on=on, box_m=box) for on, box in boxes.items()]
    return {f"{k}.bin": data for k, data in enumerate((*(message(**each) for each in heads), *paint, *wish))}


def of_plant(folder: Path) -> dict[str, bytes]:
    """Answers with all that there can be."""
    frames = [{"number": 0, "taken_s": 1.5, "arrived_s": 1.5}, {"number": 1, "lost": True}]
    frame = {"frame.0": np.full(SIZE, 4, np.uint16)}
    told = [message(frame, coding, **CAME, frames=frames) for coding in ("raw", "deflate")]
    told += [message(**CAME | {"number": None}), message(type="hello", protocol=1, name="mine")]
    return {f"{k}.bin": data for k, data in enumerate(told)}


def damaged(data: bytes, rng: random.Random) -> bytes:
    """The head's values, its text, the body, or any bytes of a message."""
    (length,) = struct.unpack_from("<I", data)
    head, body = data[4 : 4 + length], data[4 + length :]
    match rng.randrange(8):
        case 0:
            return mutations.of_bytes(data, rng)
        case 1:
            head = mutations.of_text(head.decode(), rng).encode("utf-8", "replace")
        case 2:
            body = mutations.of_bytes(body, rng)
        case _:
            head = json.dumps(mutations.of_tables(json.loads(head), rng)).encode()
    return struct.pack("<I", len(head)) + head + body


@functools.cache
def _run() -> Run:
    return start([(Source("snowflake", SMALL), None)], (), frozenset(), print, anew=True)[0]


def read_studio(path: Path) -> None:
    """What the session does with it, where that is a value of its own."""
    asks, arrays = read(path.read_bytes())
    match asks:
        case Set(overrides=overrides):
            refuse_foreign(overrides)
            with_overrides(_run().simulation.scenario, overrides)
        case Paint():
            with_overrides(_run().simulation.scenario, [paint(_run().simulation, asks, arrays)])
        case Place():
            place(_run(), asks)
        case Wish():
            wish(_run(), asks, arrays)


class Told(Link):
    """A link by which answers have come."""

    def __init__(self, *came: bytes) -> None:
        super().__init__("127.0.0.1:1", 1.0, SIZE)
        self.came = [*came]

    def meet(self, welcome: Mapping[str, Any]) -> None:
        """Somebody is there."""

    def ask(self, head: Mapping[str, Any], arrays: Any = None) -> tuple[answers.Answer, Arrays]:
        """The next one, whatever is asked."""
        message, frames = answers.read(self.came.pop(0), SIZE)
        assert isinstance(message, answers.Answer | answers.Hello)
        return (message, frames) if isinstance(message, answers.Answer) else (answers.Answer(type="arrivals", number=None, time_s=2), {})


def read_plant(path: Path) -> None:
    """What the loop takes of it: finite numbers, and poses."""
    like, camera = torch.zeros(1), CameraParams(width_px=SIZE[1], height_px=SIZE[0], bits=12)
    remote = RemotePlant(Told(message(**CAME | {"time_s": 1.49, "samples": []}), path.read_bytes()), {}, (), "texture", like)
    plant = FromZero(remote, "remote", camera, like)
    _, came = plant.show(plant.start()[0], Exposure(0, 0.0, 0.01, ()))
    for each in came.objects or ():
        T = each.T_world_object
        assert (T[:3, :3] @ T[:3, :3].T - torch.eye(3)).abs().max() < 0.01 and T.abs().max() <= 10_000 and 0 < min(each.size_m) <= 1000
    assert all(each.values.abs().max() <= 10_000 and abs(each.measured_s) <= 1e10 for each in came.samples)
    assert all(each.image is None or each.image.shape == SIZE for each in came.frames)
