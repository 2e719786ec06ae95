"""What a program in lockstep waits for: `python benchmarks/clients.py [--json FILE] [--quick]`.

Steps of a studio in a process of its own, by the clock of a program that asks for them: without arrays, and with frames, depth, instances
and materials by the socket and by shared memory, in turn. What the arrays take beyond a step without them is their making, which both ways
have, and their way.
"""

import argparse
import json
import time
from pathlib import Path
from statistics import median
from typing import Any

from bench import machine, on_one_thread
from rich.table import Table

from loop.client.client import connect
from loop.studio.messages import View
from loop.studio.notebook import show
from loop.terminal import tables

SCENARIO = "snowflake"
VIEWS: tuple[View, ...] = ("frames", "depth", "instances", "materials")
WAYS: dict[str, tuple[tuple[View, ...], bool]] = {"none": ((), False), "socket": (VIEWS, False), "memory": (VIEWS, True)}
SIZES = ((640, 360), (1920, 1080))
ROUNDS, STEPS = 8, 6


def taken_ms(address: str, way: str, steps: int) -> tuple[float, int]:
    """Median ms of a step, and bytes of its arrays."""
    views, shared = WAYS[way]
    with connect(address, views=views, shared=shared) as client:
        state, found = client.step(), []
        for _ in range(steps):
            began_s = time.perf_counter()
            state = client.step()
            found.append(1e3 * (time.perf_counter() - began_s))
        return median(found), sum(each.nbytes for each in state.arrays.values())


def measured(size: tuple[int, int], rounds: int, steps: int) -> dict[str, Any]:
    """A size of the camera's picture: medians over the rounds, and of what the two ways of a round have beyond a step without arrays."""
    total = rounds * len(WAYS) * (steps + 1) + 1
    with show(SCENARIO, f"camera.width_px={size[0]}", f"camera.height_px={size[1]}", "judge_every=0", f"steps={total}") as shown:
        found = [{way: taken_ms(shown.address, way, steps) for way in WAYS} for _ in range(rounds)]
    ms = {way: median(each[way][0] for each in found) for way in WAYS}
    size_bytes = found[0]["memory"][1]
    beyond = {way: median(each[way][0] - each["none"][0] for each in found) for way in ("socket", "memory")}
    rate = {f"{way}_bytes_s": size_bytes / max(1e-3 * each, 1e-6) for way, each in beyond.items()}
    ratio = median(each["memory"][0] / each["socket"][0] for each in found)
    return {"bytes": size_bytes, "ms": ms, "beyond_ms": beyond, **rate, "memory_to_socket": ratio}


def main() -> None:
    on_one_thread("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    sizes, rounds, steps = (SIZES[:1], 1, 2) if given.quick else (SIZES, ROUNDS, STEPS)
    found = {f"{width} x {height}": measured((width, height), rounds, steps) for width, height in sizes}
    table = Table("picture", "MB a step", "ms without", "by socket", "by memory", "memory / socket", "socket MB/s", "memory MB/s")
    for name, each in found.items():
        ms = [f"{value:.1f}" for value in each["ms"].values()]
        rates = [f"{1e-6 * each[f'{way}_bytes_s']:.0f}" for way in ("socket", "memory")]
        table.add_row(name, f"{1e-6 * each['bytes']:.1f}", *ms, f"{each['memory_to_socket']:.2f}", *rates)
    tables.show(table)
    if given.json:
        given.json.write_text(json.dumps({"machine": machine("websockets", "numpy"), "pictures": found}, indent=1))


if __name__ == "__main__":
    main()
