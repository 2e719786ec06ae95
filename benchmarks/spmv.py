"""How fast the light of a lamp is computed, beside SciPy: `python benchmarks/spmv.py [--json FILE] [--quick]`.

The lamps of the thesis' tables A.1 and A.2, lamps with long rows and the shipped ones, in every format that can pay; incremental updates
as in its fig. 6.1; memory as in its 6.2. On the CPU in process time of one thread, all in turn; on CUDA as captured graphs, in clock time
with synchronisation. Prints the tables of docs/results/spmv.md.
"""

import sys
from argparse import Namespace
from collections.abc import Collection, Sequence
from functools import partial
from typing import Any

import torch
from bench import Goal, Step, interleaved, on_gpu, run, show
from lamps import adaptive_side, disjoint, long_rows, thesis_lamp
from sparse.formats import FORMATS, SparseFormat, build, candidates, lit_rows, lit_window
from sparse.incremental import Bands, ChangedPixels

from luxloop.world.headlight import Headlight
from luxloop.world.lamps import presets
from luxloop.world.spmv import Csr, multiply, zeros

ENTRIES = 24  # a row of lamps with long ones
CHANGE, DIRTY = 0.1, 0.05  # share of the pixels, in fig. 6.1 and at one lamp
FLOAT_TOLERANCE = 1e-4  # float32 sums of up to 50 products in another order


def copy_step(megabytes: int, device: str = "cpu") -> tuple[Step, int]:
    """A large copy, which shows the memory's bandwidth, and the bytes that it moves."""
    source = torch.rand(2**18 * megabytes, device=device)
    target = torch.empty_like(source)
    return lambda: target.copy_(source), 2 * source.nbytes


def utilisation(n: int) -> torch.Tensor:
    return torch.rand(n, generator=torch.Generator().manual_seed(1))


def check(name: str, product: torch.Tensor, expected: torch.Tensor) -> None:
    """End with a sentence where a format gives another light texture."""
    if not (product.cpu() - expected).abs().max() <= FLOAT_TOLERANCE * expected.max():
        sys.exit(f"not the same work: {name} differs from SciPy")


def best(forms: dict[str, SparseFormat], ms: dict[str, float], copy_bytes: int) -> dict[str, Any]:
    """The fastest of some formats, its ms, and its throughput as a share of that of a copy.

    A product moves at least the format, the utilisation and the rows that are written, each once.
    """
    name = min(forms, key=ms.__getitem__)
    form = forms[name]
    moved = form.storage.bytes(form.values.dtype) + form.values.itemsize * (form.n_cols + form.written_rows)
    return {"fastest": name, "ms": ms[name], "of copy": moved / ms[name] / (copy_bytes / ms["copy"])}


def compare(given: Namespace, lamp: Headlight, names: Sequence[str] = (), thesis_us: float | None = None) -> dict[str, Any]:
    """Formats beside SciPy, by default all that can pay, and the fastest; each product is checked."""
    csr, matrix = lamp.matrix.streamable(), lamp.matrix.to_scipy()
    u = utilisation(csr.n_cols)
    expected = torch.from_numpy(matrix @ u.numpy())
    copy, copy_bytes = copy_step(given.copy_mb)
    steps = {"copy": copy, "SciPy": lambda: matrix @ u.numpy()}
    forms = {name: FORMATS[name](csr) for name in names or candidates(csr)}
    out = zeros((csr.n_rows,), u.dtype, u.device)  # of all formats: where it lies in memory shall not decide between them
    for name, form in forms.items():
        check(f"{name} at {lamp.name}", form.multiply(u, out.fill_(torch.nan)), expected)
        steps[name] = partial(form.refresh, u, out)
    ms = interleaved(steps, given.rounds)
    found = best(forms, ms, copy_bytes)
    return {
        "texels": [lamp.rows, lamp.cols],
        "entries": len(csr.values) / len(lit_rows(csr)),
        **found,
        "to SciPy": found["ms"] / ms["SciPy"],
        "thesis, µs": thesis_us,
        "gpu": gpu(given, lamp, u, expected, forms.keys() - {"scipy"}) if torch.cuda.is_available() else None,
        "formats, ms": ms,
    }


def gpu(given: Namespace, lamp: Headlight, u: torch.Tensor, expected: torch.Tensor, names: Collection[str]) -> dict[str, Any]:
    """Captured products. A copy larger than the GPU's caches runs before each, so that all of the matrix comes from memory."""
    copy, copy_bytes = copy_step(given.copy_mb, "cuda")
    there, steps = u.cuda(), {"copy": copy}
    forms = {name: build(lamp.matrix.to(torch.device("cuda")), name) for name in names}
    for name, form in forms.items():
        out = form.multiply(there)
        check(f"{name} on the GPU at {lamp.name}", out, expected)
        steps[name] = partial(form.refresh, there, out)
    return best(forms, on_gpu(steps, flush=copy), copy_bytes)


def refresh(lamp: Headlight, name: str) -> Step:
    """Product of a lamp in a format, into the same memory."""
    form, u = build(lamp.matrix, name), utilisation(lamp.n_pixels)
    return partial(form.refresh, u, form.multiply(u))


def updates(lamp: Headlight, share: float, rounds: int) -> dict[str, float]:
    """Median ms of a full product, a dirty band of pixel rows, a dirty patch of the same area, and flags for as many pixels."""
    csr, n = lamp.matrix, lamp.n_pixels
    bands, u = Bands(csr), utilisation(n)
    out = multiply(csr, u)

    def place(of_rows: float) -> slice:
        count = max(round(lamp.pixel_rows * of_rows), 1)
        first = (lamp.pixel_rows - count) // 2
        return slice(first * lamp.pixel_cols, (first + count) * lamp.pixel_cols)

    def flags(changed: slice | torch.Tensor) -> Step:
        """Updates by flags that change these pixels there and back."""
        other = u.clone()
        other[changed] = 1 - other[changed]
        changes, both = ChangedPixels(csr, u), [u, other]
        return lambda: (both.reverse(), changes.refresh(both[0]))

    band, square = place(share), place(share**0.5)
    steps = {
        "full": refresh(lamp, "window"),
        "band": partial(bands.refresh, u, out, bands.rows_of(band)),
        "square": partial(bands.refresh, u, out, bands.rows_of(square)),
        "band, rows looked up": lambda: bands.refresh(u, out, bands.rows_of(band)),
        "flags, band": flags(band),
        "flags, scattered": flags(torch.randperm(n, generator=torch.Generator().manual_seed(2))[: int(share * n)]),
    }
    return interleaved(steps, rounds)


def memory(csr: Csr) -> dict[str, Any]:
    """MB by format, and the share of lit texels that decides between them (T 6.2)."""
    sizes = {name: 1e-6 * each.count(csr).bytes() for name, each in FORMATS.items() if name not in ("scipy", "tiles64")}
    return {"lit share": len(lit_rows(csr)) / csr.n_rows, **sizes}


def measure(given: Namespace) -> dict[str, Any]:
    short, long = [thesis_lamp(*size, given.side) for size in given.sizes], [long_rows(*each, ENTRIES) for each in given.long]
    shipped = {name: presets.lamp(name).modules[0].headlight for name in given.presets}
    cases = {f"{lamp.name}, A.1": (lamp, (), us) for lamp, us in zip(short, given.thesis_us["A.1"], strict=False)}
    for (rows, cols), us in zip(given.sizes, given.thesis_us["A.2"], strict=False):
        cases[f"{rows} x {cols}, A.2"] = thesis_lamp(rows, cols, adaptive_side(cols)), ("csr", "window", "scipy"), us
    cases |= {f"{lamp.name}, long": (lamp,) for lamp in long} | {name: (lamp,) for name, lamp in shipped.items()}
    products = {name: compare(given, *case) for name, case in cases.items()}
    show("Products", products)
    largest, tabled = short[-1], [products[f"{lamp.name}, A.1"] for lamp in short]
    flat = interleaved({lamp.name: refresh(lamp, tabled[-1]["fastest"]) for lamp in short}, 3 * given.rounds)
    changes = updates(largest, DIRTY, given.rounds)
    show(f"{largest.name} pixels, {DIRTY:.0%} changed, ms", {"update": changes})
    figure = {
        f"{4 * texels**2} texels, {n**2 // 4} pixels": updates(disjoint(n, texels), CHANGE, min(given.rounds, 9))
        for texels in given.figure_texels
        for n in given.figure_pixels
        if n <= 4 * texels
    }
    ratios = {name: {way: ms[way] / ms["full"] for way in ("band", "flags, scattered")} for name, ms in figure.items()}
    show("T fig. 6.1: a tenth of the pixels changed, times a full update", ratios)
    square = largest.matrix
    parts = {"square texture": square, "its lit rows": square.band(*lit_window(square))}
    sizes_mb = {name: memory(each) for name, each in (parts | {name: each.matrix for name, each in shipped.items()}).items()}
    show("MB", sizes_mb)
    on_device = tabled[-1]["gpu"]
    goals = [
        Goal("short rows, times SciPy's CSR (worst of table A.1)", max(each["to SciPy"] for each in tabled), 1.0),
        Goal(f"{ENTRIES} entries a row, times SciPy's CSR", products[f"{long[0].name}, long"]["to SciPy"], 0.6),
        Goal("share of the copy bandwidth (worst of table A.1)", min(each["of copy"] for each in tabled), 0.45, True),
        Goal("longest over shortest time over the pixel numbers of table A.1", max(flat.values()) / min(flat.values()), 1.2),
        Goal(f"dirty band of {DIRTY:.0%}, times a full update", changes["band"] / changes["full"], 0.25),
        Goal("µs on a GPU, largest lamp of table A.1", on_device and 1e3 * on_device["ms"], 60.0),
    ]
    return {"products": products, "flatness": flat, "updates": changes, "figure": figure, "memory": sizes_mb, "goals": goals}


if __name__ == "__main__":
    run(measure, __doc__)
