"""How fast primitives become pixel utilisations: `python benchmarks/ssc.py [--json FILE] [--quick]`.

SuperSampling Control of 1.05 million pixels and 3.07 million rays beside one product with the headlight matrix and beside the same in
plain torch; and the lamps of the thesis' tables B.1 to B.4. In one process with one thread, in process time, all in turn. On CUDA also as
captured graphs, in clock time with synchronisation.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import torch
from bench import judged, machine, on_one_thread, show_goals
from rich.table import Table
from spmv_timing import Step, interleaved, statistics
from ssc_scenes import T_WORLD_LAMP, Plain, covered, lamp, many, symbol

from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.loop.report import terminal as tables
from luxloop.world.headlight import Headlight

ROUNDS = 11
GPU_ROUNDS = 500
LARGE = (725, 1450, 1238, 2480)  # pixel and texel rows and columns: 1.05 million and 3.07 million
SMALL = (22, 46, 255, 510)  # 1 k and 130 k
QUICK = (125, 250, 214, 428)
# Pixels and rays cast, as in the thesis.
SIZES = {
    "84": (3, 28, 107, 428),
    "1k": SMALL,
    "30k": (122, 246, 264, 531),
    "100k": (223, 448, 430, 864),
    "1.05M": LARGE,
}
# Medians of tables B.1 (µs), B.2 (ms), B.3 and B.4 (in %, of 185 µs) of the thesis, Nvidia 2080 Ti, in µs.
THESIS_US = {"B.1": {"84": 257, "30k": 256, "100k": 344}, "B.2, B.3": {"84": 173, "30k": 189, "100k": 308}}
THESIS_US["B.4"] = {"1k": 185, "30k": 175, "100k": 331, "1.05M": 1787}
GOALS = {
    "symbol on 5 %, times one product": (1.5, False),
    "symbol on 5 %, times faster than plain torch": (15.0, True),
    "36 primitives on 77 %, times one product": (5.0, False),
    "cost a ray of 36 primitives, 1.05 M pixels to 1 k": (1.2, False),
    "ms as a graph on a GPU, symbol on 5 %": (0.15, False),
}


def product(light: Headlight) -> Step:
    """One product with the headlight matrix, the measure of all."""
    u, out = torch.rand(light.n_pixels, generator=torch.Generator().manual_seed(1)), torch.empty(light.n_texels)
    return lambda: torch.mv(light.matrix.torch_csr, u, out=out)


def measure_large(size: tuple[int, int, int, int], rounds: int) -> dict[str, Any]:
    """The symbol and the many primitives beside one product; the symbol in plain torch as well, after a look at its result."""
    light, drawn, boards = lamp(*size), symbol(), many()
    ssc, plain = Ssc.prepare(light), Plain(light)
    apart = (ssc.utilisation(drawn, T_WORLD_LAMP).u - plain(drawn)).abs()
    if not (apart > 1e-3).double().mean() < 1e-4:  # rays at the outline may fall either way
        sys.exit(f"not the same work: plain torch differs by {apart.max():.3g}")
    steps: dict[str, Step] = {
        "product": product(light),
        "symbol": lambda: ssc.utilisation(drawn, T_WORLD_LAMP),
        "many": lambda: ssc.utilisation(boards, T_WORLD_LAMP),
    }
    ms = interleaved(steps, rounds)
    ms["plain"] = interleaved({"plain": lambda: plain(drawn)}, max(rounds // 4, 1))["plain"]
    areas = {"symbol": covered(drawn, light), "many": covered(boards, light)}
    shape = {"pixels": light.n_pixels, "rays": light.n_texels, "entries": len(light.matrix.values)}
    return {**shape, "ms": ms, "covered": areas, "gpu": measure_gpu(light, {"symbol": drawn, "many": boards})}


def measure_gpu(light: Headlight, scenes: dict[str, Primitives]) -> dict[str, Any] | None:
    """Captured control steps in ms, synchronised before and after each; None without CUDA."""
    if not torch.cuda.is_available():
        return None
    device = torch.device("cuda")
    ssc, T = Ssc.prepare(light.to(device)), T_WORLD_LAMP.to(device, torch.float32)
    ms = {}
    for name, scene in scenes.items():
        scene, graph, side = scene.to(device), torch.cuda.CUDAGraph(), torch.cuda.Stream()
        with torch.cuda.stream(side):
            for _ in range(3):
                ssc.utilisation(scene, T)
        torch.cuda.synchronize()
        with torch.cuda.graph(graph):
            ssc.utilisation(scene, T)
        taken = []
        for number in range(GPU_ROUNDS + 10):
            torch.cuda.synchronize()
            before = time.perf_counter_ns()
            graph.replay()
            torch.cuda.synchronize()
            if number >= 10:
                taken.append(1e-6 * (time.perf_counter_ns() - before))
        ms[name] = statistics(taken)
    return {"device": torch.cuda.get_device_name(), "ms": ms}


def measure_sizes(sizes: dict[str, tuple[int, int, int, int]], rounds: int) -> dict[str, Any]:
    """The many primitives with every lamp of the tables, in turn."""
    lights, boards = {name: lamp(*size) for name, size in sizes.items()}, many()
    controllers = {name: Ssc.prepare(light) for name, light in lights.items()}
    steps: dict[str, Step] = {name: lambda ssc=ssc: ssc.utilisation(boards, T_WORLD_LAMP) for name, ssc in controllers.items()}
    ms = interleaved(steps, rounds)
    return {
        name: {"pixels": light.n_pixels, "rays": light.n_texels, "ms": ms[name], "gpu": measure_gpu(light, {"many": boards})}
        for name, light in lights.items()
    }


def found(large: dict[str, Any], sizes: dict[str, Any]) -> list[dict[str, Any]]:
    """What the goals ask, None where it was not measured."""
    ms = {name: times["median"] for name, times in large["ms"].items()}
    ray = {name: each["ms"]["median"] / each["rays"] for name, each in sizes.items()}
    first, last = "1k", list(sizes)[-1]
    values = (
        ms["symbol"] / ms["product"],
        ms["plain"] / ms["symbol"],
        ms["many"] / ms["product"],
        ray[last] / ray[first],
        large["gpu"] and large["gpu"]["ms"]["symbol"]["median"],
    )
    return judged((goal, value, *limit) for (goal, limit), value in zip(GOALS.items(), values, strict=True))


def tables_of(sizes: dict[str, Any]) -> Table:
    """The thesis' tables B.1 to B.4 beside ours."""
    titles = ("pixels", "rays", "ms, median", "5 %", "95 %", "ns a ray", *(f"thesis {name}, ms" for name in THESIS_US), "GPU, ms")
    rows = []
    for name, each in sizes.items():
        ms = each["ms"]
        thesis = (f"{THESIS_US[table_name][name] / 1000:.3f}" if name in THESIS_US[table_name] else "" for table_name in THESIS_US)
        ours = (f"{ms['median']:.2f}", f"{ms['q05']:.2f}", f"{ms['q95']:.2f}", f"{1e6 * ms['median'] / each['rays']:.1f}")
        gpu = f"{each['gpu']['ms']['many']['median']:.3f}" if each["gpu"] else "not measured"
        rows.append((f"{each['pixels']:,}", f"{each['rays']:,}", *ours, *thesis, gpu))
    return tables.plain(titles, rows, "r", title="36 primitives on 77 % of the field")


def main() -> None:
    """Measure, show, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the results here")
    parser.add_argument("--quick", action="store_true", help="a small lamp and few rounds, to see that it works")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    console, rounds = tables.console(), 3 if arguments.quick else ROUNDS
    sizes = {"1k": SMALL, "30k": SIZES["30k"]} if arguments.quick else SIZES
    where = machine("torch")
    console.print(", ".join(f"{key} {value}" for key, value in where.items()), markup=False)
    large = measure_large(QUICK if arguments.quick else LARGE, rounds)
    measured = measure_sizes(sizes, rounds)
    goals = found(large, measured)
    console.print(f"{large['pixels']:,} pixels, {large['rays']:,} rays, {large['entries']:,} entries; covered: {large['covered']}")
    console.print({name: round(times["median"], 3) for name, times in large["ms"].items()})
    console.print(tables_of(measured))
    show_goals(console, goals)
    if arguments.json:
        arguments.json.write_text(json.dumps({"machine": where, "large": large, "sizes": measured, "goals": goals}, indent=1) + "\n")


if __name__ == "__main__":
    on_one_thread("OMP_NUM_THREADS")
    main()
