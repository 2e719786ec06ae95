"""docs/results/symbol_control.md and its picture from the results of benchmarks/symbol_control.py; the words are in the .md beside this."""

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from symbol_control_cases import CONTROLLERS, DISTURBED, DRIVING, FROM, STANDING, UNTIL, Case
from symbol_control_goals import BEGUN, DISTURBANCES, GOALS, Judged, Row

from luxloop.loop.report.terminal import markdown, number

TEMPLATE = Path(__file__).with_suffix(".md")
PICTURE = "symbol-control.png"
MEASURES = {"iou": 2, "iou_least": 2, "settle": 0, "overshoot": 0, "centroid": 1, "gap": 2, "recovery": 0}  # and their digits
COLOURS = dict(zip(CONTROLLERS, ("0.5", "tab:orange", "tab:green", "tab:purple", "tab:brown", "tab:blue"), strict=True))
PANELS = (("mixed", 0), ("mixed", 2), ("curb", 0), ("box, comes and goes", 0), ("20 m/s", 0), ("noise x 10", 0))  # scene, latency


def write(
    rows: Sequence[Row],
    judged: Sequence[tuple[Case, Judged]],
    about: dict[str, Any],
    folder: Path,
    failed: Collection[str] = (),
    absent: Collection[str] = (),
) -> None:
    """Write `symbol_control.md` and its picture into a folder. about: what the template says of the run.

    failed, absent: scenes of which a world failed, or which are not here.
    """
    (folder / "images").mkdir(parents=True, exist_ok=True)
    draw(judged, folder / "images" / PICTURE)
    (folder / "symbol_control.md").write_text(page(rows, about, failed, absent), "utf-8")


def page(rows: Sequence[Row], about: dict[str, Any], failed: Collection[str], absent: Collection[str]) -> str:
    standing = [row for row in rows if row["part"] == "standing"]
    on_time = [row for row in rows if row["latency"] == 0]
    return TEMPLATE.read_text("utf-8").format(
        **about,
        goals=goals(rows, failed, absent),
        standing_iou=table(on_time, "scene", STANDING, "iou"),
        standing=extremes([row for row in standing if row["latency"] == 0]),
        driving_iou=table(on_time, "scene", DRIVING, "iou"),
        disturbed_iou_least=table(on_time, "scene", DISTURBANCES, "iou_least"),
        late=table(standing, "latency", dict.fromkeys(row["latency"] for row in standing), "iou"),
    )


def goals(rows: Sequence[Row], failed: Collection[str] = (), absent: Collection[str] = ()) -> str:
    """A row a goal: what was measured, and what limits it where it was missed. A scene of which a world failed is missed."""
    lines = []
    for goal in GOALS:
        if broken := [scene for scene in goal.scenes if scene in failed]:
            lines.append((goal.what, "–", "**missed**", f"failed: {', '.join(broken)}"))
            continue
        worst = goal.worst(rows)
        if worst is None:
            lines.append((goal.what, "–", "not measured", ""))
            continue
        value, where = worst
        reached = goal.reached(value)
        place = f" ({where})" if len(goal.scenes) > 1 and where else ""
        verdict, limited = ("reached", "") if reached else ("**missed**", goal.limited)
        if without := [scene for scene in goal.scenes if scene in absent]:
            verdict += f", without {', '.join(without)}"
        lines.append((goal.what, f"{value:.{MEASURES[goal.measure] + 1}f}{place}", verdict, limited))
    return markdown(("goal", "measured", "", "what limits it"), lines, "lrl")


def table(rows: Sequence[Row], field: str, values: Iterable[Any], measure: str) -> str:
    """A row for each value of the field and a column a controller: the mean of a measure, its worst case in brackets."""
    by_value = {value: [row for row in rows if row[field] == value] for value in values}
    return markdown(
        (field, *CONTROLLERS),
        (
            (value, *(_cell([row for row in found if row["controller"] == name], measure) for name in CONTROLLERS))
            for value, found in by_value.items()
            if found
        ),
    )


def extremes(rows: Sequence[Row]) -> str:
    """A row for each controller: the median step of settling, and the worst of the other measures."""
    lines = []
    for name in CONTROLLERS:
        own = [row for row in rows if row["controller"] == name]
        worst = (max((row[key] for row in own if row[key] is not None), default=np.nan) for key in ("overshoot", "centroid", "gap"))
        settled = np.median([row["settle"] for row in own]) if own else np.nan
        lines.append((name, *(number(value, form) for value, form in zip((settled, *worst), (".0f", ".0f", ".1f", ".2f"), strict=True))))
    return markdown(("controller", "settled, median", "overshoot %, worst", "centroid %, worst", "below open loop, worst"), lines)


def _cell(rows: Sequence[Row], measure: str) -> str:
    values = [row[measure] for row in rows if row[measure] is not None]
    if not values:
        return "–"
    worst = (min if measure.startswith("iou") else max)(values)
    mean, worst = (f"{value:.{MEASURES[measure]}f}" for value in (np.mean(values), worst))
    return mean if worst == mean else f"{mean} ({worst})"


def draw(judged: Sequence[tuple[Case, Judged]], file: Path) -> None:
    """IoU over the steps, first seed, of each controller in a few worlds."""
    figure, grid = plt.subplots(2, 3, figsize=(12, 6.4), sharey=True, layout="constrained")
    for axes, (scene, latency) in zip(grid.flat, PANELS, strict=True):
        axes.set_title(scene + (f", frames {latency} steps late" if latency else ""), fontsize=10)
        for case, each in judged:
            if (case.scene, case.latency, case.seed) == (scene, latency, 0):
                for name, series in each.items():
                    own = name == "luxloop"
                    values = [np.nan if value is None else value for value in series["iou"]]
                    axes.plot(values, color=COLOURS[name], label=name, lw=2.2 if own else 1.2, zorder=3 if own else 2)
        if scene in DISTURBED:
            axes.axvspan(FROM, UNTIL, color="0.9", zorder=0)
        axes.axvline(BEGUN, color="0.8", lw=0.8, zorder=0)
        axes.set(ylim=(0, 1), xlim=(0, None))
        axes.grid(alpha=0.3)
    for axes in grid[:, 0]:
        axes.set_ylabel("IoU")
    for axes in grid[-1]:
        axes.set_xlabel("step")
    handles, labels = next((h for axes in grid.flat if (h := axes.get_legend_handles_labels())[0]), ([], []))
    figure.legend(handles, labels, loc="outside lower center", ncols=len(CONTROLLERS), frameon=False)
    figure.savefig(file, dpi=110)
    plt.close(figure)
