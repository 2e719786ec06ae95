"""What the arrays of a step take to another program: `python benchmarks/clients.py [--json FILE] [--quick]`.

Frames, depth, instances and materials of a camera's picture go from one process to another as the studio sends them, by the socket and by
shared memory, in turn: from the program's word that it is ready until it has arrays of its own, by the clock.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from bench import machine, on_one_thread
from rich.table import Table
from websockets.sync.client import connect
from websockets.sync.server import ServerConnection, serve

from luxloop.loop.report import terminal as tables
from luxloop.loop.studio.client.decoding import unpacked
from luxloop.loop.studio.client.shared import Mapped
from luxloop.loop.studio.shared import Blocks
from luxloop.world.messages import pack, raw

SIZES = ((640, 360), (1920, 1080))
ROUNDS = 40


def arrays(width: int, height: int) -> dict[str, np.ndarray]:
    """As large as those of a step with a camera of more than 8 bits."""
    values = np.random.default_rng(0).integers(0, 256, (height, width))
    dtypes = {"frames.on": "u2", "frames.off": "u2", "depth": "f4", "instances": "u2", "materials": "u1"}
    return {name: values.astype(dtype) for name, dtype in dtypes.items()}


def send(width: int, height: int) -> None:
    """Send steps by the way that each message names, until there are no more."""
    given = arrays(width, height)

    def answer(connection: ServerConnection) -> None:
        blocks = Blocks()
        for number, way in enumerate(connection, 1):
            if way == "memory":
                connection.send(pack({"id": number, "shared": blocks.put(0, number, given)}))
            else:
                connection.send(pack({"id": number}, {name: raw(each) for name, each in given.items()}))
        blocks.close()

    with serve(answer, "127.0.0.1", 0, compression=None) as server:
        print(server.socket.getsockname()[1], flush=True)
        server.serve_forever()


def measured(width: int, height: int, rounds: int) -> dict[str, Any]:
    """Median ms by each way, and median ratio of two that follow each other."""
    found = dict[str, list[float]](socket=[], memory=[])
    command = [sys.executable, __file__, "--send", str(width), str(height)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as sender:
        assert sender.stdout is not None
        mapped, port = Mapped(), sender.stdout.readline().strip()
        with connect(f"ws://127.0.0.1:{port}", max_size=None, compression=None) as connection:
            for number in range(rounds + 2):
                for way, taken in found.items():
                    began_s = time.perf_counter()
                    connection.send(way)
                    data = connection.recv()
                    assert isinstance(data, bytes)
                    head, there = unpacked(data)
                    there = mapped.arrays(head["shared"], head["id"]) or {} if way == "memory" else there
                    if number >= 2:  # both blocks are there
                        taken.append(1e3 * (time.perf_counter() - began_s))
        size = sum(each.nbytes for each in there.values())
        mapped.close()
        sender.terminate()
    ms = {way: median(taken) for way, taken in found.items()}
    ratio = median(memory / by_socket for memory, by_socket in zip(found["memory"], found["socket"], strict=True))
    return {"bytes": size, "ms": ms, "bytes_s": {way: 1e3 * size / each for way, each in ms.items()}, "memory_to_socket": ratio}


def main() -> None:
    on_one_thread("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--send", type=int, nargs=2, help="the other process")
    given = parser.parse_args()
    if given.send:
        send(*given.send)
        return
    sizes, rounds = (SIZES[:1], 4) if given.quick else (SIZES, ROUNDS)
    found = {f"{width} x {height}": measured(width, height, rounds) for width, height in sizes}
    table = Table("picture", "MB a step", "ms by socket", "ms by memory", "memory / socket", "MB/s by socket", "MB/s by memory")
    for name, each in found.items():
        ms, rates = (
            [f"{scale * value:.{digits}f}" for value in each[key].values()] for key, scale, digits in (("ms", 1, 1), ("bytes_s", 1e-6, 0))
        )
        table.add_row(name, f"{1e-6 * each['bytes']:.1f}", *ms, f"{each['memory_to_socket']:.2f}", *rates)
    tables.show(table)
    if given.json:
        given.json.write_text(json.dumps({"machine": machine("websockets", "numpy"), "pictures": found}, indent=1))


if __name__ == "__main__":
    main()
