"""How fast the light of a lamp is computed, beside SciPy: `python benchmarks/spmv.py [--json FILE] [--quick] [--page [FOLDER]]`.

The lamps of the thesis' tables A.1 and A.2, lamps with long rows and the shipped ones, in every format that can pay; incremental updates
as in its fig. 6.1; memory as in its 6.2. On the CPU in one process with one thread, in process time, all in turn; on CUDA as captured
graphs, in clock time with synchronisation. `--page` writes docs/results/spmv.md and its pictures.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import spmv_page
import torch
from bench import judged, machine, on_one_thread, show_goals
from rich.table import Table
from sparse.formats import FORMATS, build, candidates
from sparse.graph import CapturedProduct
from sparse.protocol import SparseFormat, lit_rows
from spmv_lamps import FIXED_SIDE, SIZES, THESIS_ADAPTIVE_US, THESIS_FIXED_US, Lamp, adaptive_side, of_the_thesis, with_long_rows
from spmv_timing import Copy, Step, interleaved, statistics
from spmv_updates import FIGURE_PIXELS, FIGURE_TEXELS, measure_figure, measure_updates

from luxloop.loop.report import terminal as tables
from luxloop.world.lamps import presets
from luxloop.world.spmv import Csr, zeros

ROOT = Path(__file__).parents[1]
ROUNDS = 15
GPU_ROUNDS = 500  # as in the thesis
LONG_ROWS = ((64, 256, 512, 1024), (195, 390, 1024, 1024))  # pixels and texels of the lamps with 24 entries a row
DENSE = (12, 24, 256)
PRESETS = ("hd84", "ssl-hd-lores", "idealised-332x1024", "dmd-1m3")
FLOAT_TOLERANCE = 1e-4  # float32 sums of up to 50 products in another order
GOAL_SHORT, GOAL_LONG, GOAL_COPY, GOAL_FLAT, GOAL_BAND, GOAL_GPU_US = 1.0, 0.6, 0.45, 1.2, 0.25, 60.0


def moved_bytes(form: SparseFormat) -> int:
    """What one product must move: the format, the utilisation, the rows written; each once."""
    return form.storage.bytes(form.dtype) + form.dtype.itemsize * (form.n_cols + form.written_rows)


def check(name: str, lamp: Lamp, product: torch.Tensor, expected: torch.Tensor) -> None:
    """End with a sentence where a format gives another light texture."""
    if not (product.cpu() - expected).abs().max() <= FLOAT_TOLERANCE * expected.max():
        sys.exit(f"not the same work: {name} differs from SciPy at {lamp.name}")


def measure_lamp(lamp: Lamp, copy: Copy, rounds: int, names: list[str] | None = None) -> dict[str, Any]:
    """Every format beside SciPy, and the fastest that can pay; each product is checked."""
    csr = Csr.from_scipy(lamp.matrix).streamable()
    u = torch.rand(csr.n_cols, generator=torch.Generator().manual_seed(1))
    vector = u.numpy()
    expected = torch.from_numpy(lamp.matrix @ vector)
    steps: dict[str, Step] = {"copy": copy, "SciPy": lambda: lamp.matrix @ vector}
    forms = {name: FORMATS[name].from_csr(csr) for name in names or [*candidates(csr), "coo", "lgc"]}
    out = zeros((csr.n_rows,), u.dtype, u.device)  # of all formats: where it lies in memory shall not decide between them
    for name, form in forms.items():
        check(name, lamp, form.multiply(u, out.fill_(torch.nan)), expected)
        steps[name] = partial(form.refresh, u, out)
    ms = interleaved(steps, rounds)
    chosen = min(names or candidates(csr), key=lambda name: ms[name]["median"])
    copied = ms.pop("copy")["median"]
    best = forms[chosen]
    lit = len(lit_rows(csr))
    return {
        "name": lamp.name,
        "pixels": csr.n_cols,
        "texels": [lamp.grid.rows, lamp.grid.cols],
        "entries": len(csr.values) / lit,
        "thesis_us": lamp.thesis_us,
        "ms": ms,
        "chosen": chosen,
        "ratio": ms[chosen]["median"] / ms["SciPy"]["median"],
        "bytes": moved_bytes(best),
        "copy_share": moved_bytes(best) / ms[chosen]["median"] / (copy.bytes / copied),
        "copy_gb_s": 1e-6 * copy.bytes / copied,
        "gpu": measure_gpu(lamp, csr, u, expected, [name for name in forms if name != "scipy"]) if torch.cuda.is_available() else None,
    }


def measure_flatness(lamps: list[Lamp], name: str, rounds: int) -> dict[str, float]:
    """Median ms of all lamps in turn in one format: whether time depends on the number of pixels.

    Where the system puts the arrays decides on a tenth of the time, so that they are made anew three times.
    """
    medians: dict[str, list[float]] = {lamp.name: [] for lamp in lamps}
    for _ in range(3):
        steps: dict[str, Step] = {}
        for lamp in lamps:
            form = build(Csr.from_scipy(lamp.matrix), name)
            u = torch.rand(form.n_cols, generator=torch.Generator().manual_seed(1))
            steps[lamp.name] = partial(form.refresh, u, form.multiply(u))
        for lamp_name, times in interleaved(steps, rounds).items():
            medians[lamp_name].append(times["median"])
    return {lamp_name: median(each) for lamp_name, each in medians.items()}


def measure_gpu(lamp: Lamp, csr: Csr, u: torch.Tensor, expected: torch.Tensor, names: list[str]) -> dict[str, Any]:
    """Captured products in µs, synchronised before and after each.

    A copy that is larger than the GPU's caches runs before each, so that all of the matrix comes from memory. Each product is checked.
    """
    device = torch.device("cuda")
    csr = csr.to(device)
    copy = Copy(device, quick=False)
    captured = {name: CapturedProduct(build(csr, name)) for name in names}
    for name, each in captured.items():
        check(f"{name} on the GPU", lamp, each(u.to(device)), expected)
    steps: dict[str, Step] = {"copy": copy, **{name: each.replay for name, each in captured.items()}}
    taken: dict[str, list[float]] = {name: [] for name in steps}
    for number in range(GPU_ROUNDS + 10):
        for name, step in steps.items():
            copy()
            torch.cuda.synchronize()
            before = time.perf_counter_ns()
            step()
            torch.cuda.synchronize()
            if number >= 10:
                taken[name].append(1e-3 * (time.perf_counter_ns() - before))
    us = {name: statistics(times) for name, times in taken.items()}
    copied = us.pop("copy")["median"]
    best = min(us, key=lambda name: us[name]["median"])
    moved = moved_bytes(captured[best].form)
    share = moved / us[best]["median"] / (copy.bytes / copied)
    return {"device": torch.cuda.get_device_name(), "us": us, "best": best, "bytes": moved, "copy_share": share}


def measure_dense(rows: int, cols: int, side: int, rounds: int) -> dict[str, Any]:
    """The dense superposition, where it fits into memory at all."""
    lamp = of_the_thesis(rows, cols, side)
    form = build(Csr.from_scipy(lamp.matrix), "window")
    dense, u = torch.from_numpy(lamp.matrix.toarray()), torch.rand(rows * cols)
    out, product = form.multiply(u), torch.empty(side**2)
    steps = {"dense": lambda: torch.mv(dense, u, out=product), "window": lambda: form.refresh(u, out)}
    return {"name": lamp.name, "side": side, "bytes": dense.nbytes, "ms": interleaved(steps, rounds)}


def count_memory(lamps: dict[str, Csr]) -> list[dict[str, Any]]:
    """Indices and bytes of each format, and the share of lit texels that decides between them (T 6.2)."""
    return [
        {
            "name": name,
            "texels": csr.n_rows,
            "lit_share": len(lit_rows(csr)) / csr.n_rows,
            "entries": len(csr.values) / len(lit_rows(csr)),
            "formats": {
                each: vars(form.count(csr)) | {"bytes": form.count(csr).bytes()}
                for each, form in FORMATS.items()
                if each not in ("scipy", "tiles64")
            },
        }
        for name, csr in lamps.items()
    ]


def goals(results: dict[str, Any]) -> list[dict[str, Any]]:
    """What the figures are measured by; on a GPU None where there is none."""
    fixed, updates = results["fixed"], results["updates"]["ms"]
    flat = results["flatness"].values()
    gpu = fixed[-1]["gpu"]
    found = [
        ("short rows, times SciPy's CSR (worst of table A.1)", max(lamp["ratio"] for lamp in fixed), GOAL_SHORT, False),
        ("24 entries a row, times SciPy's CSR", results["long"][0]["ratio"], GOAL_LONG, False),
        ("share of the copy bandwidth (worst of table A.1)", min(lamp["copy_share"] for lamp in fixed), GOAL_COPY, True),
        ("longest over shortest time over the pixel numbers of table A.1", max(flat) / min(flat), GOAL_FLAT, False),
        ("dirty band of 5 %, times a full update", updates["band"]["median"] / updates["full"]["median"], GOAL_BAND, False),
        ("µs synchronised on a GPU, largest lamp of table A.1", gpu and gpu["us"][gpu["best"]]["median"], GOAL_GPU_US, False),
    ]
    return judged(found)


def run(quick: bool, note: Callable[[str], None]) -> dict[str, Any]:
    """Measure everything."""
    sizes = SIZES[:2] if quick else SIZES
    rounds = 3 if quick else ROUNDS
    side = 256 if quick else FIXED_SIDE
    copy = Copy(torch.device("cpu"), quick)
    note("table A.1")
    tabled = [of_the_thesis(*size, side, us) for size, us in zip(sizes, THESIS_FIXED_US, strict=False)]
    fixed = [measure_lamp(lamp, copy, rounds) for lamp in tabled]
    flatness = measure_flatness(tabled, fixed[-1]["chosen"], rounds)
    note("table A.2")
    adaptive = [
        measure_lamp(of_the_thesis(*size, adaptive_side(size[1]), us), copy, rounds, ["csr", "window", "scipy"])
        for size, us in zip(sizes, THESIS_ADAPTIVE_US, strict=False)
    ]
    note("long rows")
    long = [measure_lamp(with_long_rows(*(n // 8 if quick else n for n in lamp), 24), copy, rounds) for lamp in LONG_ROWS]
    note("shipped lamps")
    shipped = {name: presets.lamp(name).modules[0].headlight for name in (PRESETS[:1] if quick else PRESETS)}
    lamps = [
        measure_lamp(Lamp(name, light.pixel_rows, light.pixel_cols, light, light.matrix.to_scipy()), copy, rounds)
        for name, light in shipped.items()
    ]
    note("incremental updates")
    thesis = tabled[-1]
    updates = measure_updates(thesis, rounds)
    figure = measure_figure(FIGURE_PIXELS[:3] if quick else FIGURE_PIXELS, FIGURE_TEXELS[:2] if quick else FIGURE_TEXELS, 3 if quick else 9)
    note("memory")
    matrix = Csr.from_scipy(thesis.matrix)
    lit = lit_rows(matrix)
    counted = {
        f"{thesis.name}, square texture": matrix,
        f"{thesis.name}, its lit rows": matrix.band(int(lit[0]), int(lit[-1]) + 1),
        **{name: light.matrix for name, light in shipped.items()},
    }
    results: dict[str, Any] = {
        "machine": machine("torch", "numpy", "scipy"),
        "fixed": fixed,
        "flatness": flatness,
        "adaptive": adaptive,
        "long": long,
        "shipped": lamps,
        "dense": measure_dense(*(DENSE[:2]), 64 if quick else DENSE[2], rounds),
        "updates": updates,
        "figure": figure,
        "memory": count_memory(counted),
    }
    return {**results, "goals": goals(results)}


def shown(title: str, lamps: list[dict[str, Any]]) -> Table:
    """Median ms of every format of every lamp."""
    names = list(dict.fromkeys(name for lamp in lamps for name in lamp["ms"]))
    rows = [(name, *(f"{lamp['ms'][name]['median']:.3f}" if name in lamp["ms"] else "" for lamp in lamps)) for name in names]
    rows.append(("chosen", *(lamp["chosen"] for lamp in lamps)))
    rows.append(("times SciPy", *(f"{lamp['ratio']:.2f}" for lamp in lamps)))
    rows.append(("of copy bandwidth", *(f"{lamp['copy_share']:.0%}" for lamp in lamps)))
    return tables.plain(("ms", *(lamp["name"] for lamp in lamps)), rows, "lr", title=title)


def main() -> None:
    """Measure, show, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the results here")
    parser.add_argument("--quick", action="store_true", help="small lamps and few rounds, to see that it works")
    parser.add_argument(
        "--page",
        type=Path,
        nargs="?",
        const=ROOT / "docs" / "results",
        metavar="FOLDER",
        help="also write spmv.md and its pictures (docs/results)",
    )
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    console = tables.console()
    start = time.monotonic()
    results = run(arguments.quick, lambda what: console.print(f"measuring {what}", markup=False))
    results["seconds"] = time.monotonic() - start
    for title in ("fixed", "adaptive", "long", "shipped"):
        console.print(shown(title, results[title]))
    console.print({name: round(times["median"], 3) for name, times in results["updates"]["ms"].items()})
    show_goals(console, results["goals"])
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=1) + "\n")
    if arguments.page:
        spmv_page.write(results, arguments.page)


if __name__ == "__main__":
    on_one_thread("OMP_NUM_THREADS")
    main()
