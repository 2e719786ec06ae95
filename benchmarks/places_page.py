"""docs/results/places.md and its picture, from the results of benchmarks/places.py; the words are in the .md beside this file."""

from collections.abc import Iterable, Sequence
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from places_bound import bound
from places_cases import CONTROLLERS, KINDS, Place
from places_goals import GOALS, OUTCOMES, VISIBLE, Row, outcome
from symbol_control_cases import shared

from luxloop.loop.report.terminal import markdown

TEMPLATE = Path(__file__).with_suffix(".md")
PICTURE = "places.png"
BINS = (0.0, 0.2, 0.5, VISIBLE)  # of the visible share, where less can be seen
SHOWN = 5  # places with less to be seen in the picture
AROUND = (0.35, 1.0)  # of the target's picture, by which more of the camera's image is shown beside it, and above and below


def write(rows: Sequence[Row], places: Sequence[Place], about: dict[str, Any], folder: Path) -> None:
    """Write `places.md` and its picture into a folder. about: what the template says of the run."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    own = [row for row in rows if row["controller"] == "luxloop"]
    hard = sorted((row for row in own if row["visible"] < VISIBLE), key=lambda row: row["visible"])
    chosen = [hard[k] for k in np.unique(np.linspace(0, len(hard) - 1, SHOWN).round().astype(int))] if hard else []
    draw([(place, row) for row in chosen for place in places if place.key == row["world"]], folder / "images" / PICTURE)
    (folder / "places.md").write_text(page(rows, about), "utf-8")


def page(rows: Sequence[Row], about: dict[str, Any]) -> str:
    seen = [row for row in rows if row["visible"] >= VISIBLE]
    own = [row for row in rows if row["controller"] == "luxloop"]
    return TEMPLATE.read_text("utf-8").format(
        **about,
        worlds=len(own),
        seen=sum(row["visible"] >= VISIBLE for row in own),
        share=f"{VISIBLE:g}",
        goals=goals(rows),
        kinds=table(seen, "kind", [kind for kind in KINDS if any(row["kind"] == kind for row in seen)]),
        grades=by_grade([row for row in own if row["kind"].endswith(KINDS[0])]),
        outcomes=outcomes([row for row in own if row["visible"] < VISIBLE]),
    )


def goals(rows: Sequence[Row]) -> str:
    """A row a goal: in how many worlds it holds, and in how many it has to."""
    lines = []
    for goal in GOALS:
        held, total = goal.of(rows)
        verdict = "not measured" if not total else "reached" if held >= goal.share * total else "**missed**"
        lines.append((goal.what, f"{held} of {total}", f"{goal.share:.0%}", verdict))
    return markdown(("goal", "worlds", "to hold in", ""), lines, "lrrl")


def table(rows: Sequence[Row], field: str, values: Iterable[Any]) -> str:
    """A row for each value of the field and a column a controller and the bound: mean IoU, luxloop's worst in brackets."""
    lines = []
    for value in values:
        found = [row for row in rows if row[field] == value]
        own = [row for row in found if row["controller"] == "luxloop"]
        cells = [_cell([r["iou"] for r in _of(found, name)], name == "luxloop") for name in CONTROLLERS]
        cells.append(_cell([r["iou_bound"] for r in own]))
        lines.append((value, len(own), *cells))
    return markdown((field, "worlds", *CONTROLLERS, "bound"), lines)


def by_grade(own: Sequence[Row]) -> str:
    """A row for each target and measure, and a column a grade, of luxloop's rows on grades."""
    found = {(row["kind"], row["world"].split(" %")[0]): row for row in own}
    grades = sorted({grade for _, grade in found}, key=float)
    lines = [
        (
            "on the road" if kind.startswith("place") else "appearance",
            name,
            *(_cell([found[kind, each][key]] if (kind, each) in found else []) for each in grades),
        )
        for kind in dict.fromkeys(kind for kind, _ in found)
        for name, key in (("luxloop", "iou"), ("bound", "iou_bound"))
    ]
    return markdown(("target", "IoU", *(f"{each} %" for each in grades)), lines, "llr")


def outcomes(rows: Sequence[Row]) -> str:
    """What becomes of luxloop's symbol where less of it can be seen, counted by visible share."""
    lines = []
    for low, high in pairwise(BINS):
        found = [row for row in rows if low <= row["visible"] < high]
        ends = [outcome(row) for row in found]
        lost = sum(row["lost"] > row["steps"] / 2 for row in found)
        lines.append((f"{low:g} to {high:g}", len(found), *(ends.count(name) for name in OUTCOMES), lost))
    return markdown(("visible share", "worlds", *OUTCOMES, "lost at more than half of the steps"), lines)


def _of(rows: Sequence[Row], controller: str) -> list[Row]:
    return [row for row in rows if row["controller"] == controller]


def _cell(values: Sequence[float], worst: bool = False) -> str:
    if not values:
        return "–"
    return f"{np.mean(values):.2f}" + (f" ({min(values):.2f})" if worst and len(values) > 1 else "")


def draw(chosen: Sequence[tuple[Place, Row]], file: Path) -> None:
    """What the camera sees of the symbol at some places, without noise: as it should look, open loop, luxloop at the end, the bound."""
    figure, grid = plt.subplots(max(len(chosen), 1), 4, figsize=(12, 1.9 * max(len(chosen), 1)), squeeze=False, layout="constrained")
    for line, (place, row) in zip(grid, chosen, strict=False):
        for axes, (title, picture, white) in zip(line, _pictures(place), strict=True):
            axes.imshow((picture.clamp(0, white) ** 0.5).numpy(), cmap="gray", vmin=0, vmax=white**0.5, aspect="auto")
            axes.set_title(title, fontsize=9)
        line[0].set_ylabel(f"visible: {row['visible']:.2f}", fontsize=9)
        line[0].set_xlabel(place.name, fontsize=9, loc="left")
    for axes in grid.flat:
        axes.set(xticks=[], yticks=[])
    figure.savefig(file, dpi=90)
    plt.close(figure)


def _pictures(place: Place) -> list[tuple[str, torch.Tensor, float]]:
    """Title, camera picture around the target and its white, in cd/m^2, of the columns of the figure."""
    simulation, own = shared(**{**place.parameters, "controllers": {"luxloop": {"name": "luxloop"}}})
    *_, last = islice(simulation.run(), own["luxloop"].steps)
    view, symbol = simulation.world.lit(0.0), simulation.symbol
    target = symbol.projector.light(symbol.projector.target)
    flat = symbol.sensor.model.luminance(target)
    rows, cols = _around(flat)
    lights = {
        "open loop": simulation.of_all(symbol, target),
        "luxloop": last.showings[0].exposure.lights,
        "bound": simulation.of_all(symbol, bound(simulation).lights),
    }
    pictures = {"to be seen": flat, **{name: view.luminance(each) for name, each in lights.items()}}
    white = 2 * float(symbol.judge.goal.median)
    return [(name, (picture + view.base.median())[rows, cols], white) for name, picture in pictures.items()]


def _around(flat: torch.Tensor) -> tuple[slice, slice]:
    """Rows and columns of the camera's image around what is lit."""
    lit = flat > 0.1 * flat.max()
    ends = [torch.nonzero(lit.any(axis))[:, 0][[0, -1]].tolist() for axis in (1, 0)]
    return tuple(
        slice(max(first - round(more * (last - first)), 0), min(last + round(more * (last - first)), n))
        for (first, last), more, n in zip(ends, reversed(AROUND), flat.shape, strict=True)
    )
