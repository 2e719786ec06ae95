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
from lamps import Lamp, adaptive_side, disjoint, long_rows, thesis_lamp
from sparse.formats import FORMATS, CapturedProduct, build, candidates
from sparse.incremental import Bands, ChangedPixels
from sparse.protocol import SparseFormat, lit_rows

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


def copy_step(quick: bool, device: str = "cpu") -> tuple[Step, int]:
    """A large copy, which shows the memory's bandwidth, and the bytes that it moves."""
    source = torch.rand(2**18 * (16 if quick else COPY_MB), device=device)
    target = torch.empty_like(source)
    return lambda: target.copy_(source), 2 * source.nbytes


def moved_bytes(form: SparseFormat) -> int:
    """What one product must move: the format, the utilisation, the rows written; each once."""
    return form.storage.bytes(form.dtype) + form.dtype.itemsize * (form.n_cols + form.written_rows)


def utilisation(n: int) -> torch.Tensor:
    return torch.rand(n, generator=torch.Generator().manual_seed(1))


def check(name: str, lamp: Lamp, product: torch.Tensor, expected: torch.Tensor) -> None:
    """End with a sentence where a format gives another light texture."""
    if not (product.cpu() - expected).abs().max() <= FLOAT_TOLERANCE * expected.max():
        sys.exit(f"not the same work: {name} differs from SciPy at {lamp.name}")


def compare(lamp: Lamp, quick: bool, names: list[str] | None = None, thesis_us: float | None = None) -> dict[str, Any]:
    """Every format beside SciPy, and the fastest that can pay; each product is checked."""
    csr = Csr.from_scipy(lamp.matrix).streamable()
    u = utilisation(csr.n_cols)
    expected = torch.from_numpy(lamp.matrix @ u.numpy())
    copy, copy_bytes = copy_step(quick)
    steps: dict[str, Step] = {"copy": copy, "SciPy": lambda: lamp.matrix @ u.numpy()}
    forms = {name: FORMATS[name](csr) for name in names or [*candidates(csr), "coo", "lgc"]}
    out = zeros((csr.n_rows,), u.dtype, u.device)  # of all formats: where it lies in memory shall not decide between them
    for name, form in forms.items():
        check(name, lamp, form.multiply(u, out.fill_(torch.nan)), expected)
        steps[name] = partial(form.refresh, u, out)
    ms = interleaved(steps, 3 if quick else ROUNDS)
    copy_ms = ms.pop("copy")["median"]
    chosen = min(names or candidates(csr), key=lambda name: ms[name]["median"])
    moved, best_ms = moved_bytes(forms[chosen]), ms[chosen]["median"]
    return {
        "name": lamp.name,
        "pixels": csr.n_cols,
        "texels": [lamp.grid.rows, lamp.grid.cols],
        "entries": len(csr.values) / len(lit_rows(csr)),
        "thesis_us": thesis_us,
        "ms": ms,
        "chosen": chosen,
        "ratio": best_ms / ms["SciPy"]["median"],
        "bytes": moved,
        "copy_share": moved / best_ms / (copy_bytes / copy_ms),
        "copy_gb_s": 1e-6 * copy_bytes / copy_ms,
        "gpu": gpu(lamp, csr, u, expected, [name for name in forms if name != "scipy"]) if torch.cuda.is_available() else None,
    }


def gpu(lamp: Lamp, csr: Csr, u: torch.Tensor, expected: torch.Tensor, names: list[str]) -> dict[str, Any]:
    """Captured products. A copy larger than the GPU's caches runs before each, so that all of the matrix comes from memory."""
    copy, copy_bytes = copy_step(False, "cuda")
    products = {name: CapturedProduct(build(csr.to(torch.device("cuda")), name)) for name in names}
    for name, each in products.items():
        check(f"{name} on the GPU", lamp, each(u.cuda()), expected)
    ms = on_gpu({"copy": copy, **{name: each.replay for name, each in products.items()}}, flush=copy)
    copy_ms = ms.pop("copy")["median"]
    best = min(ms, key=lambda name: ms[name]["median"])
    moved = moved_bytes(products[best].form)
    return {"ms": ms, "best": best, "bytes": moved, "copy_share": moved / ms[best]["median"] / (copy_bytes / copy_ms)}


def flatness(lamps: list[Lamp], name: str, rounds: int) -> dict[str, float]:
    """Median ms of all lamps in turn in one format: whether time depends on the number of pixels."""
    forms = {lamp.name: build(Csr.from_scipy(lamp.matrix), name) for lamp in lamps}
    inputs = {each: utilisation(form.n_cols) for each, form in forms.items()}
    steps = {each: partial(form.refresh, inputs[each], form.multiply(inputs[each])) for each, form in forms.items()}
    return {each: ms["median"] for each, ms in interleaved(steps, 3 * rounds).items()}


def updates(lamp: Lamp, share: float, rounds: int) -> dict[str, float]:
    """Median ms of a full product, a dirty band of pixel rows, a dirty patch of the same area, and flags for as many pixels."""
    csr = Csr.from_scipy(lamp.matrix)
    form, bands, u = build(csr, "window"), Bands(csr), utilisation(csr.n_cols)
    out, pixel = form.multiply(u), torch.arange(csr.n_cols).view(lamp.rows, lamp.cols)
    scattered = torch.randperm(csr.n_cols, generator=torch.Generator().manual_seed(2))[: int(share * csr.n_cols)]
    places = {}
    for name, of_rows in (("band", share), ("square", share**0.5)):
        count = max(round(lamp.rows * of_rows), 1)
        first = (lamp.rows - count) // 2
        places[name] = slice(first * lamp.cols, (first + count) * lamp.cols)
    steps: dict[str, Step] = {
        "full": lambda: form.refresh(u, out),
        **{name: partial(bands.refresh, u, out, bands.rows_of(place)) for name, place in places.items()},
        "band, rows looked up": lambda: bands.refresh(u, out, bands.rows_of(places["band"])),
        "flags, band": flags(csr, u, pixel.ravel()[places["band"]]),
        "flags, scattered": flags(csr, u, scattered),
    }
    return {name: ms["median"] for name, ms in interleaved(steps, rounds).items()}


def flags(csr: Csr, u: torch.Tensor, pixels: torch.Tensor) -> Step:
    """Updates by flags that change these pixels there and back."""
    other = u.clone()
    other[pixels] = 1 - other[pixels]
    changes, both = ChangedPixels(csr, u), [u, other]

    def step() -> None:
        both.reverse()
        changes.refresh(both[0])

    return step


def memory(csr: Csr) -> dict[str, Any]:
    """Bytes by format, and the share of lit texels that decides between them (T 6.2)."""
    lit, names = len(lit_rows(csr)), (name for name in FORMATS if name not in ("scipy", "tiles64"))
    sizes = {name: FORMATS[name].count(csr) for name in names}
    formats = {name: vars(each) | {"bytes": each.bytes()} for name, each in sizes.items()}
    return {"texels": csr.n_rows, "lit_share": lit / csr.n_rows, "entries": len(csr.values) / lit, "formats": formats}


def measure(given: Namespace) -> dict[str, Any]:
    quick, rounds = given.quick, 3 if given.quick else ROUNDS
    sizes = SIZES[:2] if quick else SIZES
    tabled = [thesis_lamp(*size, 256 if quick else FIXED_SIDE) for size in sizes]
    narrow = ["csr", "window", "scipy"]
    adaptive = zip(sizes, THESIS_US["A.2"], strict=False)
    shipped = {name: presets.lamp(name).modules[0].headlight for name in (PRESETS[:1] if quick else PRESETS)}
    long = [long_rows(*(n // 8 if quick else n for n in each), ENTRIES) for each in LONG_ROWS]
    named = [Lamp(name, each.pixel_rows, each.pixel_cols, each, each.matrix.to_scipy()) for name, each in shipped.items()]
    sets = {
        "A.1": [compare(lamp, quick, None, us) for lamp, us in zip(tabled, THESIS_US["A.1"], strict=False)],
        "A.2": [compare(thesis_lamp(*size, adaptive_side(size[1])), quick, narrow, us) for size, us in adaptive],
        "long": [compare(lamp, quick) for lamp in long],
        "shipped": [compare(lamp, quick) for lamp in named],
    }
    show_times(sets)
    flat = flatness(tabled, sets["A.1"][-1]["chosen"], rounds)
    changes = updates(tabled[-1], DIRTY, rounds)
    show(f"{tabled[-1].name} pixels, {DIRTY:.0%} changed, ms", {"update": changes})
    figure = [
        {"texels": 4 * texels**2, "pixels": n**2 // 4, "ms": updates(disjoint(n, texels), CHANGE, 3 if quick else 9)}
        for texels in FIGURE_TEXELS[: 2 if quick else None]
        for n in FIGURE_PIXELS[: 3 if quick else None]
        if n <= 4 * texels
    ]
    points = {f"{each['texels']} texels, {each['pixels']} pixels": each["ms"] for each in figure}
    ratios = {name: {way: ms[way] / ms["full"] for way in ("band", "flags, scattered")} for name, ms in points.items()}
    show("T fig. 6.1: a tenth of the pixels changed, times a full update", ratios)
    csr = Csr.from_scipy(tabled[-1].matrix)
    lit = lit_rows(csr)
    parts = {"square texture": csr, "its lit rows": csr.band(int(lit[0]), int(lit[-1]) + 1)}
    counts = {name: memory(each) for name, each in (parts | {name: each.matrix for name, each in shipped.items()}).items()}
    megabytes = {name: {form: 1e-6 * size["bytes"] for form, size in each["formats"].items()} for name, each in counts.items()}
    show("MB", {name: {"lit share": each["lit_share"], **megabytes[name]} for name, each in counts.items()})
    of_gpu = sets["A.1"][-1]["gpu"]
    goals = [
        Goal("short rows, times SciPy's CSR (worst of table A.1)", max(lamp["ratio"] for lamp in sets["A.1"]), 1.0),
        Goal(f"{ENTRIES} entries a row, times SciPy's CSR", sets["long"][0]["ratio"], 0.6),
        Goal("share of the copy bandwidth (worst of table A.1)", min(lamp["copy_share"] for lamp in sets["A.1"]), 0.45, True),
        Goal("longest over shortest time over the pixel numbers of table A.1", max(flat.values()) / min(flat.values()), 1.2),
        Goal(f"dirty band of {DIRTY:.0%}, times a full update", changes["band"] / changes["full"], 0.25),
        Goal("µs on a GPU, largest lamp of table A.1", of_gpu and 1e3 * of_gpu["ms"][of_gpu["best"]]["median"], 60.0),
    ]
    return {"sets": sets, "flatness": flat, "updates": changes, "figure": figure, "memory": counts, "goals": goals}


def show_times(sets: dict[str, list[dict[str, Any]]]) -> None:
    """Every lamp beside SciPy, the GPU and the thesis, and every format's ms."""
    rows, every = {}, {}
    for name, lamp in ((f"{lamp['name']}, {name}", lamp) for name, lamps in sets.items() for lamp in lamps):
        best = {"fastest": lamp["chosen"], "GPU ms": lamp["gpu"] and lamp["gpu"]["ms"][lamp["gpu"]["best"]]["median"]}
        rows[name] = {key: lamp[key] for key in ("texels", "entries", "ratio", "copy_share", "thesis_us")} | best
        every[name] = {form: each["median"] for form, each in lamp["ms"].items()}
    show("Products", rows)
    show("Median ms of every format", every)


if __name__ == "__main__":
    run(measure, __doc__, packages=("torch", "numpy", "scipy"))
