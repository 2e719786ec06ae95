"""docs/results/spmv.md and its pictures from the results of benchmarks/spmv.py; the words are in spmv_page.md beside this file."""

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from bench import goals_page

from luxloop.loop.report.terminal import markdown

TEMPLATE = Path(__file__).with_suffix(".md")


def write(results: dict[str, Any], folder: Path) -> None:
    """Write `spmv.md` and `images/spmv-*.png` into a folder."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    draw_updates(results["figure"], folder / "images" / "spmv-incremental.png")
    draw_memory(results["memory"], folder / "images" / "spmv-memory.png")
    (folder / "spmv.md").write_text(page(results), "utf-8")


def page(results: dict[str, Any]) -> str:
    fixed, dense, updates, memory = (results[key] for key in ("fixed", "dense", "updates", "memory"))
    full = updates["ms"]["full"]["median"]
    flags, bands = ([point["ms"][kind] / point["ms"]["full"] for point in results["figure"]] for kind in ("flags", "band"))
    large = [point["ms"]["band"] / point["ms"]["full"] for point in results["figure"] if point["texels"] >= 2**20] or bands
    lamp_a, lamp_b = results["long"][:2]
    changed = ((name, f"{ms['median']:.2f}", f"{ms['median'] / full:.2f}") for name, ms in updates["ms"].items())
    return TEMPLATE.read_text("utf-8").format(
        **results["machine"],
        minutes=max(round(results["seconds"] / 60), 1),
        copy=fixed[-1]["copy_gb_s"],
        goals=goals_page(results["goals"]),
        side=fixed[0]["texels"][0],
        entries=fixed[-1]["entries"],
        times=times({"A.1": fixed, "A.2": results["adaptive"], "long": results["long"], "shipped": results["shipped"]}),
        slower=slower({"A.1": fixed, "long": results["long"]}),
        flatness=", ".join(f"{ms:.2f}" for ms in results["flatness"].values()),
        texels_a=lamp_a["texels"][0] * lamp_a["texels"][1] / lamp_a["pixels"],
        texels_b=lamp_b["texels"][0] * lamp_b["texels"][1] / lamp_b["pixels"],
        dense_name=dense["name"],
        dense_side=dense["side"],
        dense_mb=dense["bytes"] / 1e6,
        dense_ms=dense["ms"]["dense"]["median"],
        dense_ratio=dense["ms"]["dense"]["median"] / dense["ms"]["window"]["median"],
        dense_gb=4e-9 * fixed[0]["pixels"] * fixed[0]["texels"][0] ** 2,
        update_name=updates["name"],
        update_side=updates["texels"],
        dirty=updates["share"],
        square=updates["share"] ** 0.5,
        updates=markdown(("update", "ms", "times full"), changed),
        flags_verdict=(
            f"never pay here, at {min(flags):.1f} to {max(flags):.0f} times a full update."
            if min(flags) >= 1
            else f"between {min(flags):.2f} and {max(flags):.0f} times a full update."
        ),
        bands_verdict=f"takes {min(large):.2f} to {max(large):.2f} of a full update from a million texels on, {max(bands):.2f} at worst.",
        memory=bytes_of(memory),
    )


def times(sets: dict[str, list[dict[str, Any]]]) -> str:
    """A row a lamp: SciPy and the chosen format in ms, then the GPU where there is one, and the thesis in µs."""
    with_gpu = any(lamp["gpu"] for lamps in sets.values() for lamp in lamps)
    header = [
        "lamp",
        "texels",
        "entries",
        "SciPy",
        "fastest",
        "ms",
        "/ SciPy",
        "of copy",
        *(["GPU µs"] if with_gpu else []),
        "thesis µs",
        "set",
    ]
    rows = []
    for name, lamp in ((name, lamp) for name, lamps in sets.items() for lamp in lamps):
        cells = [lamp["name"].split(",")[0], " x ".join(map(str, lamp["texels"])), f"{lamp['entries']:.2f}"]
        scipy, chosen = (f"{lamp['ms'][each]['median']:.2f}" for each in ("SciPy", lamp["chosen"]))
        cells += [scipy, f"`{lamp['chosen']}`", chosen, f"{lamp['ratio']:.2f}", f"{lamp['copy_share']:.0%}"]
        cells += [gpu(lamp["gpu"])] if with_gpu else []
        rows.append([*cells, f"{lamp['thesis_us']:.1f}" if lamp["thesis_us"] else "", name])
    return markdown(header, rows, "lrrrlr")


def slower(sets: dict[str, list[dict[str, Any]]]) -> str:
    """A row a format: its time over the chosen format's, in each set of lamps."""
    ratios: dict[str, dict[str, list[float]]] = {}
    for name, lamp in ((name, lamp) for name, lamps in sets.items() for lamp in lamps):
        chosen = lamp["ms"][lamp["chosen"]]["median"]
        for form in lamp["ms"].keys() - {"SciPy"}:
            ratios.setdefault(form, {}).setdefault(name, []).append(lamp["ms"][form]["median"] / chosen)
    cells = (
        (form, [each.get(name, []) for name in sets])
        for form, each in sorted(ratios.items(), key=lambda item: min(map(min, item[1].values())))
    )
    rows = (
        (f"`{form}`", *("–".join(dict.fromkeys(f"{each(found):.1f}" for each in (min, max))) if found else "" for found in own))
        for form, own in cells
    )
    return markdown(("times the chosen", *sets), rows)


def gpu(measured: dict[str, Any] | None) -> str:
    if measured is None:
        return "not measured"
    us = measured["us"][measured["best"]]["median"]
    return f"{us:.1f} (`{measured['best']}`, {measured['bytes'] / 1e6:.0f} MB, {measured['copy_share']:.0%} of copy)"


def bytes_of(memory: list[dict[str, Any]]) -> str:
    names = list(memory[0]["formats"])
    rows = [
        [each["name"], f"{each['lit_share']:.0%}", *(f"{each['formats'][name]['bytes'] / 1e6:.1f}" for name in names)] for each in memory
    ]
    return markdown(["lamp", "lit", *(f"`{name}`" for name in names)], rows)


def draw_updates(points: list[dict[str, Any]], file: Path) -> None:
    """Time of updates over a full product, over the number of pixels, a colour a texture."""
    figure, axes = plt.subplots(figsize=(7.5, 4.2), layout="constrained")
    textures = sorted({point["texels"] for point in points})
    for texels, colour in zip(textures, plt.colormaps["viridis"](range(0, 240, 240 // len(textures))), strict=False):
        line = [point for point in points if point["texels"] == texels]
        pixels = [point["pixels"] for point in line]
        label = f"{texels / 1e6:.2f} M texels"
        axes.loglog(pixels, [p["ms"]["flags"] / p["ms"]["full"] for p in line], "o-", color=colour, label=f"flags, {label}")
        axes.loglog(pixels, [p["ms"]["band"] / p["ms"]["full"] for p in line], "s--", color=colour, label=f"band, {label}")
    axes.axhline(1, color="0.4", lw=1)
    axes.set(xlabel="pixels", ylabel="time, times a full update", title="A tenth of the pixels changed")
    axes.set_yticks([0.1, 0.2, 0.5, 1, 2, 5, 10])
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    axes.xaxis.set_minor_formatter("")
    axes.grid(alpha=0.3, which="both")
    figure.legend(loc="outside right center", fontsize=8)
    figure.savefig(file, dpi=110)
    plt.close(figure)


def draw_memory(lamps: list[dict[str, Any]], file: Path) -> None:
    """Indices of rows a texel over the share of lit texels, the lamps marked."""
    figure, axes = plt.subplots(figsize=(7.5, 3.8), layout="constrained")
    for slope, offset, label in ((0, 1, "CSR: n_t + 1"), (2, 0, "submatrix: 2 n_lit + 1"), (3, 0, "LGC: 3 n_lit")):
        axes.plot([0, 1], [offset, offset + slope], label=label)
    for lamp, marker in zip(lamps, "ovs^Dp*", strict=False):
        axes.plot(
            lamp["lit_share"], lamp["formats"]["window"]["row_indices"] / lamp["texels"], f"k{marker}", ms=5, mfc="w", label=lamp["name"]
        )
    axes.set(xlabel="share of lit texels", ylabel="indices of texels, times n_t", xlim=(0, 1.02), ylim=(0, 3.05))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", fontsize=8, title="lines; marks: window of")
    figure.savefig(file, dpi=110)
    plt.close(figure)
