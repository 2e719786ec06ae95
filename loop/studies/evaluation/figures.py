"""Figures of an evaluation: errors over setpoints, differences of both controls, effect of parameters (T 8.4, 8.5, B.4)."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from luxloop.loop.report.style import DEFAULTS, write
from luxloop.loop.studies.evaluation.evaluate import FIXED_A_M, Evaluation, Row, headlight, light_of
from luxloop.world.lamps.patterns import SETPOINT_CD, Rectangle

MARKERS = ("o", "^", "s", "D", "v", "P", "X", "*")
ERRORS = {"mae": "MAE", "rmse": "RMSE", "dssim": "DSSIM"}
SHOWN = [Rectangle(0, 0, 3.75, height) for height in (1, 2, 3)]  # of T figures 8.9 and 8.10


@rc_context(DEFAULTS)
def draw(evaluation: Evaluation, folder: Path, prefix: str = "") -> list[Path]:
    """Draw all figures of all lamps as PNG files whose names begin with the prefix; returns the files."""
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
            for number, turn in enumerate(turns):
                some = [row for row in rows if row["v"] == v and row["turn"] == turn]
                shown = axes.scatter(
                    [row["h"] + 0.5 * (number - (len(turns) - 1) / 2) for row in some],
                    [row[column] for row in some],
                    c=[row["width"] * row["height"] for row in some],
                    vmin=min(areas),
                    vmax=max(areas),
                    cmap="viridis",
                    marker=MARKERS[number % len(MARKERS)],
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
    """Light of MRPC less that of the joint optimum, as a share of the setpoint, with the wanted rectangle (T figures 8.9, 8.10)."""
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
    """Difference of MRPC and joint optimum, summed over either axis, relative to the most light there (T figure 8.11)."""
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
    """An image of an error, its minimum marked; rows without mapping lie below the others."""
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
    """Angles of columns and rows of the light texture."""
    y, z = headlight(name).tangents(torch.float64, torch.device("cpu"))
    return torch.rad2deg(y.atan()).numpy(), torch.rad2deg(z.atan()).numpy()


def _outline(row: Row) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    angle = np.radians(row["turn"])
    x = np.array([-1, 1, 1, -1, -1]) * row["width"] / 2
    y = np.array([-1, -1, 1, 1, -1]) * row["height"] / 2
    return row["h"] + x * np.cos(angle) - y * np.sin(angle), row["v"] + x * np.sin(angle) + y * np.cos(angle)
