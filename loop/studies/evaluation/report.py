"""Report of an evaluation as Markdown: tables beside the thesis' own, and figures (T 8.4, 8.5, B.4)."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.table import Table

from luxloop.loop.report import terminal as tables
from luxloop.loop.report.style import DEFAULTS, write
from luxloop.loop.report.terminal import number
from luxloop.loop.studies.evaluation.evaluate import FIXED_A_M, LAMPS, ROWS, Evaluation, Row, evaluate, headlight, light_of, summary
from luxloop.loop.studies.jobs import local
from luxloop.world.files import atomic_write, writing
from luxloop.world.lamps.patterns import SETPOINT_CD, Rectangle

MARKERS = ("o", "^", "s", "D", "v", "P", "X", "*")
ERRORS = {"mae": "MAE", "rmse": "RMSE", "dssim": "DSSIM"}
SHOWN = [Rectangle(0, 0, 3.75, height) for height in (1, 2, 3)]  # of T figures 8.9 and 8.10


@rc_context(DEFAULTS)
def draw(evaluation: Evaluation, folder: Path, prefix: str = "") -> list[Path]:
    """Draw all figures of all lamps as PNG files; returns the files. prefix: of their names."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name in evaluation.lamps:
        for kind, figure in _figures(evaluation.of(name), name):
            files.append(folder / f"{prefix}{kind}-{name}.png")
            write(figure, files[-1])
            plt.close(figure)
    return files


def _figures(one: Evaluation, name: str) -> Iterator[tuple[str, Figure]]:
    rows = [{**row, "ratio": row["mrpc_mae"] / row["jpo_mae"]} for row in one.setpoints]
    yield "errors", over_setpoints(rows, {"jpo_mae": "MAE of joint optimisation", "ratio": "MAE of MRPC / joint"})
    yield "parameters", over_setpoints(rows, {key: f"best ${key}$" for key in ("a_m", "a_x", "a_r")})
    yield "difference", differences(rows, name)
    yield "profiles", profiles(rows, name)
    if one.sensitivity:
        yield "sensitivity", sensitivities(one.sensitivity, FIXED_A_M.get(name, 1.0))


def over_setpoints(rows: Sequence[Row], columns: dict[str, str]) -> Figure:
    """Values of all rectangles over horizontal position, one panel per vertical position; colours show area, markers rotation."""
    heights, turns = (sorted({row[key] for row in rows}) for key in ("v", "turn"))
    figure, grid = plt.subplots(
        len(columns), len(heights), figsize=(12, 0.6 + 2.7 * len(columns)), sharex=True, sharey="row", layout="constrained", squeeze=False
    )
    areas = [row["width"] * row["height"] for row in rows]
    for line, (column, label) in zip(grid, columns.items(), strict=True):
        for axes, v in zip(line, heights, strict=True):
            for place, turn in enumerate(turns):
                some = [row for row in rows if row["v"] == v and row["turn"] == turn]
                shown = axes.scatter(
                    [row["h"] + 0.5 * (place - (len(turns) - 1) / 2) for row in some],
                    [row[column] for row in some],
                    c=[row["width"] * row["height"] for row in some],
                    vmin=min(areas),
                    vmax=max(areas),
                    cmap="viridis",
                    marker=MARKERS[place % len(MARKERS)],
                    s=14,
                    lw=0,
                )
            positions = sorted({row["h"] for row in rows if row["v"] == v})
            means = [np.mean([row[column] for row in rows if (row["h"], row["v"]) == (h, v)]) for h in positions]
            axes.plot(positions, means, color="0.6", lw=1, zorder=0)
            axes.grid(alpha=0.25)
        line[0].set_ylabel(label)
    for axes, v in zip(grid[0], heights, strict=True):
        axes.set_title(f"vertical {v:g}°", fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("horizontal in °, left positive", fontsize=8)
    grid[0][0].invert_xaxis()
    handles = [
        plt.Line2D([], [], color="0.3", ls="", marker=MARKERS[k % len(MARKERS)], ms=5, label=f"turned {turn:g}°")
        for k, turn in enumerate(turns)
    ]
    handles.append(plt.Line2D([], [], color="0.6", lw=1, label="mean at a position"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8)
    figure.colorbar(shown, ax=grid, label="area in °²", fraction=0.02, pad=0.01)
    return figure


def differences(rows: Sequence[Row], name: str) -> Figure:
    """Light of MRPC minus that of the joint optimum as a share of the setpoint, with the wanted rectangle (T figures 8.9, 8.10)."""
    chosen = _nearest(rows)
    figure, grid = plt.subplots(1, len(chosen), figsize=(12, 3.4), layout="constrained", squeeze=False)
    h, v = _degrees(name)
    pairs = [(light_of(name, row["pixels"], row["mrpc_u"]), light_of(name, row["pixels"], row["jpo_u"])) for row in chosen]
    largest = max(max(float(np.abs(mrpc - joint).max()) for mrpc, joint in pairs) / SETPOINT_CD, 1e-3)
    for axes, row, (mrpc, joint) in zip(grid[0], chosen, pairs, strict=True):
        difference = (mrpc - joint) / SETPOINT_CD
        shown = axes.pcolormesh(h, v, difference, cmap="RdBu_r", vmin=-largest, vmax=largest, shading="nearest", rasterized=True)
        for light, style in ((mrpc, "-"), (joint, "--")):
            if (light > SETPOINT_CD / 2).any():
                axes.contour(h, v, light, levels=[SETPOINT_CD / 2], colors="0.35", linewidths=1, linestyles=style)
        axes.plot(*_outline(row), color="black", lw=1.2)
        half = 0.75 * max(row["width"], 1.6 * row["height"])
        axes.set(xlim=(row["h"] + half, row["h"] - half), ylim=(row["v"] - 0.62 * half, row["v"] + 0.62 * half), aspect="equal")
        axes.set_title(f"{row['width']:g} x {row['height']:g}° at {row['h']:g}, {row['v']:g}°, turned {row['turn']:g}°", fontsize=9)
        axes.set_xlabel("horizontal in °, left positive", fontsize=8)
    grid[0][0].set_ylabel("vertical in °")
    figure.colorbar(shown, ax=grid, label="share of the setpoint", fraction=0.02, pad=0.01)
    lines = {"wanted": ("black", "-"), "MRPC, half of the setpoint": ("0.35", "-"), "joint, half of the setpoint": ("0.35", "--")}
    handles = [plt.Line2D([], [], color=colour, ls=style, label=label) for label, (colour, style) in lines.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8)
    return figure


def profiles(rows: Sequence[Row], name: str) -> Figure:
    """Difference of MRPC and joint optimum summed over either axis, absolute and relative to the most light (T figure 8.11)."""
    light = headlight(name)
    apart, samples = np.zeros((2, light.rows, light.cols))
    for row in rows:
        difference = np.abs(light_of(name, row["pixels"], row["mrpc_u"]) - light_of(name, row["pixels"], row["jpo_u"]))
        apart += difference
        samples += difference > 1e-3 * SETPOINT_CD
    mean = apart / np.maximum(samples, 1)
    most = light.light_texture(torch.ones(light.n_pixels)).numpy()
    related = np.where(most > 1e-3 * most.max(), mean / np.maximum(most, 1e-9), 0)
    figure, grid = plt.subplots(1, 2, figsize=(12, 3.2), layout="constrained")
    curves = {"|MRPC - joint|, mean of samples": mean, "the same over the most light": related, "most light": most}
    for axes, angle, axis, label in zip(grid, _degrees(name), (0, 1), ("horizontal in °, left positive", "vertical in °"), strict=True):
        for text, values in curves.items():
            total = values.sum(axis)
            axes.plot(angle, total / max(float(total.max()), 1e-12), label=text, color="0.65" if values is most else None)
        axes.set(xlabel=label, ylabel="share of its maximum", ylim=(0, 1.05))
        axes.grid(alpha=0.25)
    grid[0].invert_xaxis()
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure


def sensitivities(rows: Sequence[Row], fixed: float) -> Figure:
    """Errors of the wide rectangle over a_x, left with bounding rectangles, right with free shapes (T figures 8.12 to 8.19)."""
    cases: list[tuple[str, str, list[Row]]] = [
        (f"$a_r$ = {a_r:g}", "a_m", [row for row in rows if row["a_r"] == a_r]) for a_r in (0.0, 1.0, 2.0)
    ]
    cases.append((f"$a_m$ = {fixed:g}", "a_r", [row for row in rows if row["a_m"] == fixed]))
    figure, grid = plt.subplots(len(cases), len(ERRORS), figsize=(12, 11), layout="constrained")
    for line, (title, over, some) in zip(grid, cases, strict=True):
        for axes, (error, label) in zip(line, ERRORS.items(), strict=True):
            _surface(axes, some, over, error)
            axes.set_title(f"{label}, {title}: {axes.get_title()}", fontsize=8)
        line[0].set_ylabel(f"${over}$")
    for axes in grid[-1]:
        axes.set_xlabel("$a_x$: bounding rectangles | free shapes", fontsize=8)
    return figure


def _surface(axes: Axes, rows: Sequence[Row], over: str, error: str) -> None:
    """Image of an error with its minimum marked; rows without mapping lie below the others."""
    levels = sorted({row[over] for row in rows if row[over] is not None})
    unmapped = over == "a_m" and any(row[over] is None for row in rows)
    lines: list[float | None] = [*([None] if unmapped else []), *levels]
    image = []
    for level in lines:
        by_shape = {row["shape"]: row[error] for row in rows if row[over] == level}
        image.append([*by_shape["rectangle"][::-1], *by_shape["arbitrary"]])
    values = np.array(image)
    n = values.shape[1] // 2
    row, col = np.unravel_index(np.nanargmin(values), values.shape)
    low = float(values[row, col])
    mapped = values[1:] if unmapped else values  # rows without mapping may lie far above and would hide all others
    axes.imshow(values, origin="lower", aspect="auto", cmap="viridis_r", vmin=low, vmax=float(mapped.max()), interpolation="nearest")
    axes.axvline(n - 0.5, color="white", lw=1)
    axes.plot(col, row, "r*", ms=9)
    ticks = [0, n - 1, n, 2 * n - 1]
    axes.set_xticks(ticks, ["1", "0", "0", "1"], fontsize=8)
    some = np.unique(np.linspace(1 if unmapped else 0, len(lines) - 1, 5).round().astype(int))
    labels = [f"{lines[k]:g}" for k in some]
    axes.set_yticks([*([0] if unmapped else []), *some], [*(["none"] if unmapped else []), *labels], fontsize=8)
    axes.set_title(f"{low:.3g} to {float(mapped.max()):.3g}")


def _nearest(rows: Sequence[Row]) -> list[Row]:
    """The rows nearest to the rectangles in SHOWN."""

    def distance(row: Row, wanted: Rectangle) -> float:
        return float(sum(abs(row[key] - value) for key, value in vars(wanted).items()))

    nearest = [min(rows, key=lambda row: distance(row, wanted)) for wanted in SHOWN]
    return list({row["key"]: row for row in nearest}.values())


def _degrees(name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angles in deg of the light texture's columns and rows."""
    y, z = headlight(name).tangents()
    return torch.rad2deg(y.atan()).numpy(), torch.rad2deg(z.atan()).numpy()


def _outline(row: Row) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    angle = np.radians(row["turn"])
    x = np.array([-1, 1, 1, -1, -1]) * row["width"] / 2
    y = np.array([-1, -1, 1, 1, -1]) * row["height"] / 2
    return row["h"] + x * np.cos(angle) - y * np.sin(angle), row["v"] + x * np.sin(angle) + y * np.cos(angle)


REPORT, FIGURES = "report.md", "figures"

# (mean, median) on the real lamps: T figures 8.5 to 8.8, B.2 to B.7.
THESIS: dict[str, dict[str, tuple[float, float]]] = {
    "hd84": {"jpo": (0.81, 0.82), "mrpc_ratio": (1.081, 1.045), "a_m": (0.91, 0.99), "a_x": (0.70, 0.87), "a_r": (0.65, 0.001)},
    "ssl-hd-lores": {"jpo": (0.19, 0.20), "mrpc_ratio": (1.31, 1.32), "a_m": (1.035, 1.025), "a_x": (0.97, 0.98), "a_r": (0.61, 0.001)},
}
# Changes in % against the reference of MAE, RMSE, DSSIM, MARE in the order of ROWS: T tables 8.2 and 8.3.
THESIS_ROWS = {
    "hd84": ((-9.69, -5.04, -0.52, -21.85), (-10.60, -4.02, 5.03, -34.80), (-10.74, -7.67, -5.54, 19.38), (-11.26, -7.35, -4.13, 10.20)),
    "ssl-hd-lores": (
        (-7.52, -5.04, -1.74, -56.82),
        (-97.65, -95.74, -98.49, -85.74),
        (-97.91, -95.77, -98.48, -90.98),
        (-97.93, -95.79, -98.52, -90.91),
    ),
}
MEASURES = {
    "jpo": "MAE, joint optimum",
    "mrpc": "MAE, MRPC tuned for each setpoint",
    "mrpc_ratio": "ratio MRPC / joint",
    "options_ratio": "ratio, a_ac and sharpening tuned as well",
    "corrected_ratio": "ratio, three corrections on top",
    "ours_ratio": "ratio, one set of our parameters",
    "median_ratio": "ratio, the thesis' median parameters",
    "default_ratio": "ratio, default parameters",
    "a_m": "best a_m",
    "a_x": "best a_x",
    "a_r": "best a_r",
    "options_a_ac": "best a_ac",
    "options_sharpening": "best sharpening",
}
CAPTIONS = {
    "errors": "MAE of the joint optimum, and excess of MRPC's (T figures 8.5 to 8.8)",
    "difference": "Light of MRPC minus that of the joint optimum (T figures 8.9, 8.10)",
    "profiles": "Differences between the two (T figure 8.11)",
    "sensitivity": "Errors of the wide rectangle; bright: small, star: minimum (T figures 8.12 to 8.19)",
    "parameters": "Best parameters (T figures B.2 to B.7)",
}


def run_evaluation(out: Path, lamp: str | None, quick: bool, processes: int | None) -> bool:
    """Evaluate, write the report, print its first table and failed jobs; returns whether all jobs succeeded.

    Raises as `luxloop.loop.studies.jobs.run`.
    """
    found = evaluate(out, LAMPS if lamp is None else (lamp,), quick=quick, executor=local(processes))
    for key, reason in found.failures.items():
        tables.say(f"failed: {key}: {reason}", stderr=True)
    if found.setpoints:
        write_report(found, out)
        tables.show(overview(found))
        print(f"{out / REPORT} written")
    return not found.failures


def write_report(evaluation: Evaluation, out: Path) -> None:
    """Draw the figures and write the page into a folder. Raises LuxloopError on a write error."""
    with writing(out / FIGURES):
        draw(evaluation, out / FIGURES)
    atomic_write(out / REPORT, "# Evaluation\n\n" + page(evaluation, f"{FIGURES}/"))


def overview(evaluation: Evaluation) -> Table:
    """Means of all lamps for the terminal."""
    columns = ("lamp", "setpoints", "MAE joint", "MAE MRPC", "MRPC / joint", "thesis", "with options", "corrected")
    rows = []
    for name in evaluation.lamps:
        values = summary(evaluation.of(name).setpoints)
        joint, mrpc, ratio, *others = (
            f"{values[f'{key}_mean']:.3f}" for key in ("jpo", "mrpc", "mrpc_ratio", "options_ratio", "corrected_ratio")
        )
        thesis = f"{THESIS[name]['mrpc_ratio'][0]:g}"
        rows.append([f"[bold]{name}[/]", f"{values['setpoints']:g}", joint, mrpc, ratio, thesis, *others])
    return tables.plain(columns, rows)


def page(evaluation: Evaluation, images: str) -> str:
    """Results as Markdown. images: prefix of the figures' names in links."""
    return "\n\n".join(part for name in evaluation.lamps for part in _lamp(evaluation.of(name), name, images)) + "\n"


def _lamp(one: Evaluation, name: str, images: str) -> list[str]:
    values = summary(one.setpoints)
    measured = [
        (text, _pair((values[f"{key}_mean"], values[f"{key}_median"])), _pair(THESIS[name].get(key))) for key, text in MEASURES.items()
    ]
    count = f"{values['setpoints']:g} rectangles of 10,000 cd; the joint optima are proved within {100 * values['gap']:.2g} %."
    parts = [f"## {name}", count, tables.markdown_table(["mean (median)", "luxloop", "thesis"], measured)]
    kinds = list(CAPTIONS) if one.sensitivity else [kind for kind in CAPTIONS if kind != "sensitivity"]
    for kind in kinds:
        if kind == "sensitivity":
            parts += _changes(one, name)
        parts.append(f"![{kind}]({images}{kind}-{name}.png)\n\n*{CAPTIONS[kind]}*")
    return parts


def _pair(values: tuple[float | None, float | None] | None) -> str:
    return "–" if values is None else "{} ({})".format(*(number(value, ".3f") for value in values))


def _changes(one: Evaluation, name: str) -> list[str]:
    """Effect of tuning on the wide rectangle, as in T tables 8.2 and 8.3."""
    rows = dict(zip(ROWS, one.tables, strict=False))
    if len(rows) < len(ROWS):
        return []
    errors = ("mae", "rmse", "dssim", "mare")
    reference = rows.pop("reference")
    body = []
    for (key, row), thesis in zip(rows.items(), THESIS_ROWS[name], strict=True):
        changes = [f"{100 * (row[error] / reference[error] - 1):+.1f} ({value:+.1f})" for error, value in zip(errors, thesis, strict=True)]
        body.append([key, *(number(row[f"best_{name}"], ".2f") for name in ("a_m", "a_x", "a_r")), *changes])
    text = (
        "A rectangle of 8.9° x 7.7° (T tables 8.2, 8.3): change in % (the thesis' in brackets) relative to bounding rectangles at half "
        f"of the pixels' peak, without mapping, whose MAE is {reference['mae']:.3f}."
    )
    return [text, tables.markdown_table(["tuned", "a_m", "a_x", "a_r", "MAE", "RMSE", "DSSIM", "MARE"], body)]
