"""How fast the light of a lamp is computed, beside SciPy: `python benchmarks/spmv.py [--json FILE] [--quick]`.

The lamps of the thesis' tables A.1 and A.2, lamps with long rows and the shipped ones, in every format that can pay; incremental updates
as in its fig. 6.1; memory as in its 6.2. On the CPU in process time of one thread, all in turn; on CUDA as captured graphs, in clock time
with synchronisation. Prints the tables of docs/results/spmv.md.
"""

import sys
from argparse import Namespace
from functools import partial
from typing import Any

import torch
from bench import Goal, Step, interleaved, on_gpu, run, show
from lamps import adaptive_side, disjoint, long_rows, thesis_lamp
from sparse.formats import FORMATS, SparseFormat, build, candidates, lit_rows, lit_window
from sparse.incremental import Bands, ChangedPixels

from luxloop.world.headlight import Headlight
from luxloop.world.lamps import presets
from luxloop.world.spmv import Csr, zeros

ROUNDS, COPY_MB = 15, 256
SIZES = ((45, 90), (125, 250), (390, 780), (670, 1340), (870, 1740))  # rows x columns of pixels
THESIS_US = {"A.1": (429.7, 432.9, 480.3, 454.9, 454.9), "A.2": (98.7, 135.1, 397.8, 845.9, 1646.3)}  # medians, Nvidia 2080 Ti
FIXED_SIDE = 2048
LONG_ROWS, ENTRIES = ((64, 256, 512, 1024), (195, 390, 1024, 1024)), 24  # pixels and texels of the lamps with 24 entries a row
PRESETS = ("hd84", "ssl-hd-lores", "idealised-332x1024", "dmd-1m3")
FIGURE_TEXELS, FIGURE_PIXELS = (128, 256, 512, 1024), (32, 64, 128, 256, 512, 1024, 2048)  # rows of a texture of 4:1, columns of pixels
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


def compare(lamp: Headlight, quick: bool, names: list[str] | None = None, thesis_us: float | None = None) -> dict[str, Any]:
    """Every format beside SciPy, and the fastest that can pay; each product is checked."""
    csr, matrix = lamp.matrix.streamable(), lamp.matrix.to_scipy()
    u = utilisation(csr.n_cols)
    expected = torch.from_numpy(matrix @ u.numpy())
    copy, copy_bytes = copy_step(16 if quick else COPY_MB)
    steps = {"copy": copy, "SciPy": lambda: matrix @ u.numpy()}
    can_pay = names or candidates(csr)
    forms = {name: FORMATS[name](csr) for name in names or [*can_pay, "coo", "lgc"]}
    out = zeros((csr.n_rows,), u.dtype, u.device)  # of all formats: where it lies in memory shall not decide between them
    for name, form in forms.items():
        check(f"{name} at {lamp.name}", form.multiply(u, out.fill_(torch.nan)), expected)
        steps[name] = partial(form.refresh, u, out)
    ms = interleaved(steps, 3 if quick else ROUNDS)
    found = best({name: forms[name] for name in can_pay}, ms, copy_bytes)
    return {
        "texels": [lamp.rows, lamp.cols],
        "entries": len(csr.values) / len(lit_rows(csr)),
        **found,
        "to SciPy": found["ms"] / ms["SciPy"],
        "thesis, µs": thesis_us,
        "gpu": gpu(lamp, u, expected, [name for name in forms if name != "scipy"]) if torch.cuda.is_available() else None,
        "formats, ms": ms,
    }


def gpu(lamp: Headlight, u: torch.Tensor, expected: torch.Tensor, names: list[str]) -> dict[str, Any]:
    """Captured products. A copy larger than the GPU's caches runs before each, so that all of the matrix comes from memory."""
    copy, copy_bytes = copy_step(COPY_MB, "cuda")
    there, steps = u.cuda(), {"copy": copy}
    forms = {name: build(lamp.matrix.to(torch.device("cuda")), name) for name in names}
    for name, form in forms.items():
        out = form.multiply(there)
        check(f"{name} on the GPU at {lamp.name}", out, expected)
        steps[name] = partial(form.refresh, there, out)
    return best(forms, on_gpu(steps, flush=copy), copy_bytes)


def flatness(lamps: list[Headlight], name: str, rounds: int) -> dict[str, float]:
    """Median ms of all lamps in turn in one format: whether time depends on the number of pixels."""
    steps = {}
    for lamp in lamps:
        form, u = build(lamp.matrix, name), utilisation(lamp.n_pixels)
        steps[lamp.name] = partial(form.refresh, u, form.multiply(u))
    return interleaved(steps, 3 * rounds)


def updates(lamp: Headlight, share: float, rounds: int) -> dict[str, float]:
    """Median ms of a full product, a dirty band of pixel rows, a dirty patch of the same area, and flags for as many pixels."""
    csr = lamp.matrix
    form, bands, u = build(csr, "window"), Bands(csr), utilisation(csr.n_cols)
    out, pixels = form.multiply(u), torch.arange(csr.n_cols)

    def place(of_rows: float) -> slice:
        count = max(round(lamp.pixel_rows * of_rows), 1)
        first = (lamp.pixel_rows - count) // 2
        return slice(first * lamp.pixel_cols, (first + count) * lamp.pixel_cols)

    def flags(changed: torch.Tensor) -> Step:
        """Updates by flags that change these pixels there and back."""
        other = u.clone()
        other[changed] = 1 - other[changed]
        changes, both = ChangedPixels(csr, u), [u, other]
        return lambda: (both.reverse(), changes.refresh(both[0]))

    band, square = place(share), place(share**0.5)
    scattered = torch.randperm(csr.n_cols, generator=torch.Generator().manual_seed(2))[: int(share * csr.n_cols)]
    steps = {
        "full": partial(form.refresh, u, out),
        "band": partial(bands.refresh, u, out, bands.rows_of(band)),
        "square": partial(bands.refresh, u, out, bands.rows_of(square)),
        "band, rows looked up": lambda: bands.refresh(u, out, bands.rows_of(band)),
        "flags, band": flags(pixels[band]),
        "flags, scattered": flags(scattered),
    }
    return interleaved(steps, rounds)


def memory(csr: Csr) -> dict[str, Any]:
    """MB by format, and the share of lit texels that decides between them (T 6.2)."""
    sizes = {name: 1e-6 * each.count(csr).bytes() for name, each in FORMATS.items() if name not in ("scipy", "tiles64")}
    return {"lit share": len(lit_rows(csr)) / csr.n_rows, **sizes}


def measure(given: Namespace) -> dict[str, Any]:
    quick, rounds = given.quick, 3 if given.quick else ROUNDS
    sizes = SIZES[:2] if quick else SIZES
    tabled = [thesis_lamp(*size, 256 if quick else FIXED_SIDE) for size in sizes]
    adaptive = [thesis_lamp(*size, adaptive_side(size[1])) for size in sizes]
    long = [long_rows(*(n // 8 if quick else n for n in each), ENTRIES) for each in LONG_ROWS]
    shipped = {name: presets.lamp(name).modules[0].headlight for name in (PRESETS[:1] if quick else PRESETS)}
    products = {
        **{f"{lamp.name}, A.1": compare(lamp, quick, None, us) for lamp, us in zip(tabled, THESIS_US["A.1"], strict=False)},
        **{
            f"{lamp.name}, A.2": compare(lamp, quick, ["csr", "window", "scipy"], us)
            for lamp, us in zip(adaptive, THESIS_US["A.2"], strict=False)
        },
        **{f"{lamp.name}, long": compare(lamp, quick) for lamp in long},
        **{name: compare(lamp, quick) for name, lamp in shipped.items()},
    }
    show("Products", products)
    short = [products[f"{lamp.name}, A.1"] for lamp in tabled]
    flat = flatness(tabled, short[-1]["fastest"], rounds)
    changes = updates(tabled[-1], DIRTY, rounds)
    show(f"{tabled[-1].name} pixels, {DIRTY:.0%} changed, ms", {"update": changes})
    figure = {
        f"{4 * texels**2} texels, {n**2 // 4} pixels": updates(disjoint(n, texels), CHANGE, 3 if quick else 9)
        for texels in FIGURE_TEXELS[: 2 if quick else None]
        for n in FIGURE_PIXELS[: 3 if quick else None]
        if n <= 4 * texels
    }
    ratios = {name: {way: ms[way] / ms["full"] for way in ("band", "flags, scattered")} for name, ms in figure.items()}
    show("T fig. 6.1: a tenth of the pixels changed, times a full update", ratios)
    csr = tabled[-1].matrix
    parts = {"square texture": csr, "its lit rows": csr.band(*lit_window(csr)), **{name: each.matrix for name, each in shipped.items()}}
    sizes_mb = {name: memory(each) for name, each in parts.items()}
    show("MB", sizes_mb)
    on_device = short[-1]["gpu"]
    goals = [
        Goal("short rows, times SciPy's CSR (worst of table A.1)", max(each["to SciPy"] for each in short), 1.0),
        Goal(f"{ENTRIES} entries a row, times SciPy's CSR", products[f"{long[0].name}, long"]["to SciPy"], 0.6),
        Goal("share of the copy bandwidth (worst of table A.1)", min(each["of copy"] for each in short), 0.45, True),
        Goal("longest over shortest time over the pixel numbers of table A.1", max(flat.values()) / min(flat.values()), 1.2),
        Goal(f"dirty band of {DIRTY:.0%}, times a full update", changes["band"] / changes["full"], 0.25),
        Goal("µs on a GPU, largest lamp of table A.1", on_device and 1e3 * on_device["ms"], 60.0),
    ]
    return {"products": products, "flatness": flat, "updates": changes, "figure": figure, "memory": sizes_mb, "goals": goals}


if __name__ == "__main__":
    run(measure, __doc__)
