"""What the arrays of a step take to another program: `python benchmarks/clients.py [--json FILE] [--quick]`.

Frames, depth, instances and materials of a camera's picture go from one process to another as the studio sends them, by the socket and by
shared memory, in turn: by the clock, from the program's request until it has arrays of its own.
"""

import multiprocessing
import time
from argparse import Namespace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from bench import medians, run, show
from websockets.sync.client import connect
from websockets.sync.server import ServerConnection, serve

from luxloop.loop.studio.inbox import unpack
from luxloop.loop.studio.shared import BlockReader, Blocks
from luxloop.world.messages import pack, raw

WARM_UPS = 2


def send(port: Connection, dtypes: dict[str, str], width: int, height: int) -> None:
    """Send steps by the way that each message names, until there are no more."""
    values = np.random.default_rng(0).integers(0, 256, (height, width))
    arrays = {name: values.astype(dtype) for name, dtype in dtypes.items()}

    def answer(connection: ServerConnection) -> None:
        blocks = Blocks()
        for number, way in enumerate(connection, 1):
            if way == "memory":
                connection.send(pack({"id": number, "shared": blocks.put(0, number, arrays)}))
            else:
                connection.send(pack({"id": number}, {name: raw(each) for name, each in arrays.items()}))
        blocks.close()

    with serve(answer, "127.0.0.1", 0, compression=None) as server:
        port.send(server.socket.getsockname()[1])
        server.serve_forever()


def compare(given: Namespace, width: int, height: int) -> dict[str, Any]:
    """Median ms by each way, and the median ratio of two that follow each other."""
    rows = []
    here, there = multiprocessing.Pipe()
    sender = multiprocessing.get_context("spawn").Process(target=send, args=(there, given.dtypes, width, height))
    sender.start()
    mapped = BlockReader()
    with connect(f"ws://127.0.0.1:{here.recv()}", max_size=None, compression=None) as connection:
        for _ in range(given.rounds + WARM_UPS):
            row = {}
            for way in ("socket", "memory"):
                began_s = time.perf_counter()
                connection.send(way)
                data = connection.recv()
                head, arrays = unpack(data)
                arrays = mapped.arrays(head["shared"], head["id"]) or {} if way == "memory" else arrays
                row[way] = 1e3 * (time.perf_counter() - began_s)
            rows.append(row | {"memory to socket": row["memory"] / row["socket"]})
    size = sum(each.nbytes for each in arrays.values())
    mapped.close()
    sender.terminate()
    return {"bytes": size, "ms": medians(rows[WARM_UPS:])}


def measure(given: Namespace) -> dict[str, Any]:
    found = {f"{width} x {height}": compare(given, width, height) for width, height in given.sizes_px}
    show("Arrays of a step", found)
    return {"pictures": found}


if __name__ == "__main__":
    run(measure, __doc__)
