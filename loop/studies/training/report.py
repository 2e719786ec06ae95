"""Report of a trained detector: a page of Markdown, and confidence against illuminance as a picture."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.table import Table

from luxloop.loop.report import terminal as tables
from luxloop.loop.report.style import FOUR, drawing
from luxloop.loop.report.terminal import number
from luxloop.loop.studies.training.evaluate import AGREE, ALONE_LX, AROUND_LX, FOUND_IOU, HEIGHT_PX, REFERENCE_LX, VISIBLE
from luxloop.loop.studies.training.scenes import CLASSES
from luxloop.world.files import atomic_write

PAGE, PICTURE = "report.md", "confidence.jpg"
Report = Mapping[str, Any]


def goals(report: Report) -> list[tuple[str, str, float | None, bool]]:
    """Goal, limit in words, value reached (None if no object counts), and whether the goal is reached."""
    found, all_ = report["well_lit"], report["confidence"]["all"]["median"]
    at = dict(zip(report["confidence"]["lx"], all_, strict=True))
    change = None if at[40.0] is None else round(abs(at[40.0] - at[20.0]), 3)
    asked: list[tuple[str, Literal["≥", "≤"], float, float | None]] = [
        (f"recall at {REFERENCE_LX:g} lx", "≥", 0.9, found["recall"]),
        (f"false positives a frame at {REFERENCE_LX:g} lx", "≤", 0.3, found["false_a_frame"]),
        ("median confidence at 0.1 lx, without other light", "≤", 0.1, at[0.1]),
        (f"median confidence at {REFERENCE_LX:g} lx", "≥", 0.5, at[REFERENCE_LX]),
        ("its change from 20 to 40 lx", "≤", 0.05, change),
        (f"objects as sure in object-based light, within {AGREE:g}", "≥", 0.8, report["alone"]["kept"]),
    ]
    return [
        (name, f"{sign} {limit:g}", value, value is not None and (value >= limit if sign == "≥" else value <= limit))
        for name, sign, limit, value in asked
    ]


def overview(report: Report) -> Table:
    """The goals for the terminal."""
    rows = ((name, limit, number(value), "yes" if reached else "[bold]no[/]") for name, limit, value, reached in goals(report))
    return tables.plain((f"{report['scenes']} scenes held out", "goal", "reached", ""), rows)


def page(report: Report) -> str:
    """The report as Markdown."""
    training, found, alone = report["training"], report["well_lit"], report["alone"]
    kept = ", ".join(f"{name} {number(value)}" for name, value in alone["kept_by_class"].items())
    by_class = ", ".join(f"{name} {number(value)}" for name, value in found["recall_by_class"].items())
    rows = ((name, limit, number(value), "yes" if reached else "no") for name, limit, value, reached in goals(report))
    others = "; ".join(f"{number(each['recall'])} at {each['false_a_frame']:g} ({each['score']:g})" for each in report["by_score"])
    right = ", ".join(f"{number(each['right'])} of {each['boxes']} ({each['from']:g} to {each['to']:g})" for each in report["right"])
    learnt = training["scenes"] - training["calibrated_on"]
    asked = f"{training['calibrated_on']} more" if learnt else "the same, since so few leave none for that"
    minutes = ", ".join(f"{name} {number(value)} min" for name, value in training.get("minutes", {}).items())
    lx = report["confidence"]["lx"]
    curves = {"all": report["confidence"]["all"], "all, at night": report["confidence_at_night"]["all"]}
    curves |= {name: report["confidence"][name] for name in CLASSES}
    medians = ((name, *(number(each, ".2f") for each in of["median"])) for name, of in curves.items())
    return f"""Trained on {report["date"]} on {learnt or training["scenes"]} scenes, {training["epochs"]} epochs \
({training["examples"]} examples), seed {training["seed"]}{f" ({minutes})" if minutes else ""}; calibrated on {asked}; \
evaluated on {report["scenes"]} other scenes with {found["objects"]} objects, none of which occurs in the training scenes.

{tables.markdown_table(("", "goal", "measured", "reached"), rows, "llrl")}

Objects count if they are at least {HEIGHT_PX} px tall and {VISIBLE:.0%} visible. An object is found by a box with a score of at least \
{report["sure"]:g} and an IoU of {FOUND_IOU:g} or more. A box on a smaller or more occluded object counts neither way. \
Precision is {found["precision"]:g}; {number(found["class_accuracy"], ".1%")} of the found objects have the right class. \
Recall by class: {by_class}. A frame takes {report["ms_a_frame"]:g} ms of processor time.

Recall at false positives a frame, for other thresholds of the score (in brackets): {others}.

Scores estimate the probability that a box is right (slope {training["slope"]:g} and shift {training["shift"]:g} of the logits). \
Share of right boxes at {REFERENCE_LX:g} lx, by score: {right}.

*x lx* means that every surface that faces the lamps gets x lx at any distance. The curves of confidence, except those *at night*, \
are for scenes without other light: no sky, street lamps and other cars' lamps, which show many objects without the headlamps. \
An object's confidence is the best score of its class among the boxes on it, or 0.

Object-based light is {ALONE_LX:g} lx on objects amid {AROUND_LX:g} lx, with dark heads and windscreens. \
Of {alone["objects"]} objects that are found in {ALONE_LX:g} lx everywhere, \
{number(alone["kept"], ".0%")} lose no more than {AGREE:g} of confidence ({kept}); \
the median change is {number(alone["median_change"], "+g")}.

{tables.markdown_table(("median confidence at lx", *(f"{each:g}" for each in lx)), medians)}
"""


def write_report(report: Report, out: Path) -> None:
    """Write page and picture into a folder: median confidence over illuminance of each class, and quartiles of all objects.

    Raises LuxloopError on a write error.
    """
    with drawing(out / PICTURE, (7.2, 3.6)) as figure:
        axes, curves = figure.subplots(), report["confidence"]
        lower, upper = (np.array(curves["all"][key], float) for key in ("lower", "upper"))
        axes.fill_between(curves["lx"], lower, upper, color="0.85", label="middle half of all")
        for name, colour in zip(CLASSES, FOUR, strict=True):
            median = np.array(curves[name]["median"], float)
            axes.plot(curves["lx"], median, color=colour, marker="o", markersize=3, label=f"{name}, median")
        axes.set(xscale="log", xlabel="illuminance of surfaces that face the lamps in lx", ylabel="confidence", ylim=(0, 1))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="lower right")
    atomic_write(out / PAGE, f"# Detector\n\n{page(report)}\n![Confidence against illuminance]({PICTURE})\n")
