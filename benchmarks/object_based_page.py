"""docs/results/object_based.md and its picture, from results of benchmarks/object_based.py; the words are in the .md beside it."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from object_based_cases import BEAMS, COMES, END, LOW, OURS, VARIANTS
from object_based_goals import FOUND, GOALS, NEAR, RATE_HZ, Measured, Row, median_saved, newcomers, quantile, share, share_kept

from luxloop.loop.report.terminal import markdown, number

TEMPLATE = Path(__file__).with_suffix(".md")
NAME, PICTURE = "object_based.md", "object-based-results.png"
GREEN, GREY = (90, 220, 120), (110, 130, 160)
Pictures = Mapping[str, tuple[Any, Sequence[Sequence[float]], Sequence[float]]]  # by title: frame 0..1, boxes, scores


def write(
    measured: Measured,
    runs: Sequence[Mapping[str, Any]],
    pairs: Sequence[Mapping[str, Any]],
    pictures: Pictures,
    about: Mapping[str, Any],
    folder: Path,
) -> None:
    """Write page and picture into a folder. runs: the default's; pairs: of renderings; about: what the template says of the run."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    draw(measured, runs, pictures, folder / "images" / PICTURE)
    (folder / NAME).write_text(page(measured, pairs, about), "utf-8")


def page(measured: Measured, pairs: Sequence[Mapping[str, Any]], about: Mapping[str, Any]) -> str:
    return TEMPLATE.read_text("utf-8").format(
        **about,
        end=f"frames from {END.start / RATE_HZ:.1f} to {END.stop / RATE_HZ:.1f} s",
        found=FOUND,
        goals=goals(measured),
        light=light([row | {"variant": name} for row in measured.light for name in _names(row)]),
        zones=zones(measured.zones),
        tracks=tracks(measured.tracks),
        agreement=agreement(pairs),
    )


def goals(measured: Measured) -> str:
    """A row a goal: what was measured, and what limits it where it was missed."""
    rows = []
    for goal in GOALS:
        value = goal.value(measured)
        if value is None:
            rows.append((goal.what, "–", "not measured", ""))
        else:
            verdict, limited = ("reached", "") if goal.reached(value) else ("**missed**", goal.limited)
            rows.append((goal.what, goal.form.format(value) if math.isfinite(value) else "never", verdict, limited))
    return markdown(("goal", "measured", "", "what limits it"), rows, "lrl")


def _names(row: Row) -> tuple[str, ...]:
    """The lines of the table that a row counts in: the default also by the kind of its scene."""
    own = row["variant"] == OURS
    return (row["variant"], f"{OURS}, {'moving' if row['moving'] else 'static'}") if own else (row["variant"],)


def light(rows: Sequence[Row]) -> str:
    """A row for each variant: what is saved beside what is kept."""
    order = (OURS, *(f"{OURS}, {kind}" for kind in ("static", "moving")), *(name for name in VARIANTS if name != OURS), *BEAMS)
    by_name = {name: [row for row in rows if row["variant"] == name] for name in order}
    return markdown(("", *COLUMNS), ((name, *(cell(found) for cell in COLUMNS.values())) for name, found in by_name.items() if found))


def _dazzled(rows: Sequence[Row]) -> str:
    found = [row for row in rows if "dazzled" in row]
    return f"{np.mean([row['dazzled'] for row in found]):.1%} ({np.mean([row['dazzled_tracked'] for row in found]):.1%})" if found else "–"


def _newcomer(rows: Sequence[Row]) -> str:
    times = newcomers(rows)
    return f"{np.median(times):.2f} s ({np.mean(np.array(times) <= 0.5):.0%})" if times else "–"


COLUMNS: dict[str, Callable[[Sequence[Row]], str]] = {
    "runs": lambda rows: str(len(rows)),
    "flux saved, median (10 % quantile)": lambda rows: f"{_percent(median_saved(rows))} ({_percent(quantile(rows, 'saved_low', 0.1))})",
    "every object kept": lambda rows: _percent(share_kept(rows)),
    "greatest loss, median (90 % quantile)": lambda rows: "{} ({})".format(*(number(quantile(rows, "gap", q), ".2f") for q in (0.5, 0.9))),
    "runs with one lost": lambda rows: _percent(share(row["lost"] > 0 if "lost" in row else None for row in rows)),
    "heads above 1 lx, frames (of tracked objects)": _dazzled,
    "newcomer lit, median (within 0.5 s)": _newcomer,
}


def _percent(value: float | None) -> str:
    return number(None if value is None else 100 * value, ".0f", " %")


def zones(rows: Sequence[Row]) -> str:
    lines = []
    for saturation_e in dict.fromkeys(row["saturation_e"] for row in rows):
        found = [row for row in rows if row["saturation_e"] == saturation_e]
        steps, error = [row["steps"] for row in found], max(row["error"] for row in found)
        lines.append((f"{saturation_e:g} e", f"{np.mean(steps):.1f}", max(steps), f"{error:.1%}"))
    return markdown(("full well", "steps, mean", "steps, worst", "error, worst"), lines, "r")


def tracks(rows: Sequence[Row]) -> str:
    lines = []
    for situation in dict.fromkeys(row["situation"] for row in rows):
        found = [row for row in rows if row["situation"] == situation]
        switches, frames = sum(row["switches"] for row in found), sum(row["frames"] for row in found)
        with_track = sum(row["found"] - row["lost"] for row in found) / max(frames, 1)
        rate = switches / max(frames / RATE_HZ / 60, 1e-9)
        lines.append((situation, len(found), switches, f"{rate:.1f}", f"{with_track:.0%}"))
    return markdown(("situation", "runs of an object", "switches", "a minute", "frames with a track"), lines)


def agreement(pairs: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for name in pairs[0] if pairs else ():
        found = [each[name] for each in pairs]
        mae = float(np.mean([each["mae"] for each in found]))
        changes, alone = ([value for each in found for value in each[key]] for key in ("score_changes", "alone"))
        rows.append((name, f"{mae:.1e}", len(changes), len(alone), f"{np.mean(changes):.4f}"))
    return markdown(("pair", "MAE", "boxes of both", "of one alone", "change of score, mean"), rows)


def draw(measured: Measured, runs: Sequence[Mapping[str, Any]], pictures: Pictures, file: Path) -> None:
    """Frames of one scene above, charts of all runs below."""
    figure, grid = plt.subplots(2, 3, figsize=(13, 6.2), layout="constrained", height_ratios=(1, 1.15))
    for axes, (title, each) in zip(grid[0], pictures.items(), strict=True):
        axes.imshow(_boxed(*each))
        axes.set_title(title, fontsize=10)
        axes.axis("off")
    _flux(grid[1, 0], runs)
    _kept(grid[1, 1], measured)
    _newcomers(grid[1, 2], runs)
    figure.savefig(file, dpi=90)
    plt.close(figure)


def _boxed(frame: np.ndarray, boxes: Sequence[Sequence[float]], scores: Sequence[float]) -> np.ndarray:
    picture = np.repeat((255 * np.clip(frame, 0, 1) ** (1 / 2.2)).astype(np.uint8)[..., None], 3, -1)
    for (u0, v0, u1, v1), score in sorted(zip(boxes, scores, strict=True), key=lambda each: each[1]):
        colour = GREEN if score >= FOUND else GREY
        cv2.rectangle(picture, (round(u0), round(v0)), (round(u1), round(v1)), colour, 1)
        if score >= FOUND:
            cv2.putText(picture, f"{score:.2f}", (round(u0), round(v0) - 3), cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour, 1, cv2.LINE_AA)
    return picture


def _flux(axes: Axes, runs: Sequence[Mapping[str, Any]]) -> None:
    flux = 100 * np.array([np.array(run["flux_lm"]) / run["low_lm"] for run in runs])
    time_s = np.arange(flux.shape[1]) / RATE_HZ
    low, median, high = np.quantile(flux, (0.1, 0.5, 0.9), axis=0)
    axes.fill_between(time_s, low, high, color="tab:blue", alpha=0.2, lw=0)
    axes.plot(time_s, median, color="tab:blue")
    axes.axvline(COMES / RATE_HZ, color="0.7", lw=0.8)
    axes.axvspan(END.start / RATE_HZ, END.stop / RATE_HZ, color="0.93", zorder=0)
    axes.set(xlabel="time in s", ylabel="flux, % of the low beam's", ylim=(0, 110), xlim=(0, time_s[-1]))
    axes.grid(alpha=0.3)


def _kept(axes: Axes, measured: Measured) -> None:
    for variant, colour, size in (
        (OURS, "tab:blue", 10),
        ("by class", "tab:orange", 14),
        ("10 lx for all", "tab:green", 14),
        (LOW, "0.4", 10),
    ):
        rows = [row for row in measured.light if row["variant"] == variant and row["gap"] is not None]
        axes.scatter(
            [row["gap"] for row in rows], [100 * row["saved_low"] for row in rows], s=size, alpha=0.6, color=colour, label=variant, lw=0
        )
    axes.axvline(NEAR, color="0.6", lw=0.8)
    axes.set(xlabel="greatest loss of confidence against full light", ylabel="flux saved, %", ylim=(-5, 102))
    axes.legend(fontsize=8, frameon=False)
    axes.grid(alpha=0.3)


def _newcomers(axes: Axes, runs: Sequence[Mapping[str, Any]]) -> None:
    lx = np.array([[np.nan if value is None else value for value in run["newcomer_lx"]] for run in runs if run["newcomer"]])
    if len(lx):
        time_s = np.arange(lx.shape[1]) / RATE_HZ
        axes.plot(time_s, lx.T, color="tab:blue", alpha=min(1.0, 8 / len(lx)), lw=0.8)
        axes.plot(time_s, np.nanmedian(lx, 0), color="black", lw=1.6, label="median")
        axes.legend(fontsize=8, frameon=False)
    axes.axvline(0.5, color="0.7", lw=0.8)
    axes.set(xlabel="time since it came, s", ylabel="mean light on a newcomer, lx", ylim=(0, None))
    axes.grid(alpha=0.3)
