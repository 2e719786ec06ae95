"""How well symbols lie on hard roads: `python benchmarks/places.py [--quick] [--out FOLDER] [--json FILE]`.

Worlds drawn from a seed, and in each of them all controllers side by side, beside what lamp and camera allow there. Goes on where an
earlier run in the same folder was. `--quick`: about an eighth of the worlds. Prints the tables of docs/results/places.md.
"""

from argparse import Namespace
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from bench import Goal, run, show
from side_by_side import DARK, SMALL, World, compare_in, road_of, series, table

from luxloop import Scenario, load
from luxloop.loop.recording.summary import AXES
from luxloop.loop.scenario import data

FEEDFORWARD, ON_ROAD = "feedforward, true road", "place"
END = 5  # steps of which the mean is the end
LOOKS = 3  # after the first frame, within which a symbol is found
VISIBLE = 0.8  # share of the target's cells that lamp and camera allow at least where goals hold
Table = dict[str, Any]


def places(given: Namespace) -> Iterator[World]:
    """All worlds but those whose scan is not here."""
    for kind, grades in given.from_3_m.items():
        for percent in grades:
            symbol = {"image": "snowflake", "x_m": 17.0, "y_m": 0.0, "start": given.at_target}
            yield _world(given, kind, f"{percent:+} % from 3 m on", _grade(percent, 0.0, given.begins_m[0]), symbol, 0)
    for k, (kind, name, road) in list(enumerate(_roads(given)))[:: given.every]:
        generator = np.random.default_rng([given.seed, k])  # so that a world is the same in both runs
        x, y = given.targets_m[generator.integers(len(given.targets_m))]
        x_m, beside_m = given.peripheries_m[generator.integers(len(given.peripheries_m))]
        start = {"x_m": x_m / 17 * x, "y_m": y + beside_m, "roll_deg": 5.0, "pitch_deg": -2.0}
        symbol = {"image": str(generator.choice(given.symbols)), "x_m": x, "y_m": y, "start": start}
        latency = int(generator.choice(given.latencies))
        if "file" in road:
            if data.present(road["file"]) is None:
                continue
            road |= {"at_x_m": x, "at_y_m": y}
        for each in (kind, ON_ROAD) if k % given.every_on_road == 0 else (kind,):
            yield _world(given, each, name, road, symbol, latency)


def _roads(given: Namespace) -> Iterator[tuple[str, str, Table]]:
    """Kind, name and road of each world that is drawn."""
    generator = np.random.default_rng(given.seed)
    for start in given.begins_m:
        for percent in (*range(-6, 0), *range(1, 7)):
            yield "grade", f"grade {percent:+} % from {start:g} m on", _grade(percent, 0.0, start)
    for k in range(32):
        radius = round(float(np.exp(generator.uniform(np.log(150), np.log(2000)))), -1)
        start, sign = given.begins_m[k % len(given.begins_m)], float(generator.choice([-1, 1]))
        percent = sign * min(20.0, 100 * given.curved_m / radius)
        road = _grade(percent, 0.0, start) | {"curve_m": abs(percent) / 100 * radius}
        yield "crest or sag", f"{'sag' if sign > 0 else 'crest'} of {radius:g} m from {start:g} m on", road
    for percent in np.linspace(-6, 6, 16).round(1).tolist():
        yield "cross-fall", f"cross-fall {percent:+g} %", _grade(0.0, percent, 3.0)
    for height in np.linspace(-0.5, 0.5, 24).round(2).tolist():
        x, ramp = round(generator.uniform(6, 22), 1), round(float(np.exp(generator.uniform(np.log(0.1), np.log(3)))), 2)
        yield "step", f"step of {height:+g} m at {x:g} m", {"kind": "step", "x_m": x, "height_m": height, "ramp_m": ramp}
    for seed in range(5):
        for roughness in "ABCDE":
            yield "roughness", f"class {roughness}, seed {seed}", {"kind": "iso8608", "roughness_class": roughness, "seed": seed}
    for file, (along, beside) in given.scans.items():
        for _ in range(given.places):
            u, v = round(generator.uniform(*along), 1), round(generator.uniform(-beside, beside), 1)
            heading = round(180 * int(generator.integers(2)) + generator.uniform(-given.heading_deg, given.heading_deg), 1)
            road = {"kind": "opencrg", "file": file, "u_m": u, "v_m": v, "heading_deg": heading}
            yield "scan", f"{file} at {u:g} m, {v:+g} m aside, {heading:g}°", road


def _grade(grade_percent: float, crossfall_percent: float, start_x_m: float) -> Table:
    return {"kind": "grade", "grade_percent": grade_percent, "crossfall_percent": crossfall_percent, "start_x_m": start_x_m}


def _world(given: Namespace, kind: str, name: str, road: Table, symbol: Table, late: int) -> World:
    function = symbol | {"target": "place" if kind.startswith(ON_ROAD) else "appearance", "controller": {"name": "luxloop"}}
    changes = {"road": road, "functions": {"symbol": function}, "camera": {"latency_steps": late}}
    return world(given, kind, name, load("flat", (SMALL, changes), steps=given.steps + late))


def world(given: Namespace, kind: str, name: str, scenario: Scenario) -> World:
    symbol, late, on_road = scenario.symbol, scenario.camera.latency_steps, scenario.symbol.target == "place"
    target = f"{symbol.x_m:g} m" + (f", {symbol.y_m:+g} m aside" if symbol.y_m else "") + (" on the road" if on_road else "")
    tables = {name: dict(given.controllers[name]) for name in (given.on_road_controllers if on_road else given.controllers)}
    tables[FEEDFORWARD]["road"] = road_of(scenario)
    return World(f"{name}; {symbol.image} at {target}, {late} late", {"kind": kind, "latency": late}, scenario, tables, bounded=True)


def measures(place: World, found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row a controller of a world's result (`side_by_side.compare`).

    iou: mean of the last five steps; so are those of the open loop, the feedforward and the bound beside it. centroid: in % of the symbol's
    size. found: first step at which the symbol was not lost, None for never. lost, lost_later: share of the steps at which it was lost, and
    steps after the first looks. below_open, below_thesis: by how much the IoU is lower; None where the thesis' controller does not run.
    """
    metrics, late = found["metrics"], place.facts["latency"]
    end = {name: float(series(each, "iou", 0.0)[-END:].mean()) for name, each in metrics.items()}
    facts = {**place.facts, "world": place.key, "iou_bound": found["iou_bound"], "visible": found["visible"]}
    facts |= {"iou_open": end["open"], "iou_feedforward": end[FEEDFORWARD]}
    return [
        facts
        | {
            "controller": controller,
            "iou": end[controller],
            "found": next((step for step, lost in enumerate(each["lost"]) if not lost), None),
            "lost": float(np.mean(each["lost"])),
            "lost_later": sum(each["lost"][late + LOOKS :]),
            "centroid": float(max(abs(series(each, axis, DARK)[-END:].mean()) for axis in AXES)),
            "below_open": end["open"] - end[controller],
            "below_thesis": end["thesis_pid"] - end[controller] if "thesis_pid" in end else None,
        }
        for controller, each in metrics.items()
    ]


def goals(given: Namespace, rows: pd.DataFrame) -> list[Goal]:
    """Shares of the worlds in which something holds, where enough is visible, or of a kind, however much is visible."""
    rows = rows.astype({"found": float, "below_thesis": float}).assign(on_road=rows["kind"].str.startswith(ON_ROAD))
    found = []
    for what, (share, of, holds) in given.goals.items():
        held = rows.query(given.rows[of]).eval(holds)
        found.append(Goal(what, float(held.mean()) if len(held) else None, share, True, f"{held.sum()} of {len(held)}"))
    return found


def by_share(given: Namespace, rows: pd.DataFrame) -> pd.DataFrame:
    """What becomes of luxloop's symbol where less of it can be seen, counted by visible share."""
    rows = rows[rows["visible"] < given.bins[-1]]
    labels = [f"{low:g} to {high:g}" for low, high in pairwise(given.bins)]
    bins = pd.cut(rows["visible"], given.bins, right=False, labels=labels)
    outcome = np.select([rows.eval(holds) for holds in given.outcomes.values()], list(given.outcomes), default="")
    counts = pd.crosstab(bins, outcome).reindex(columns=list(given.outcomes), fill_value=0)
    counts.insert(0, "worlds", counts.sum(axis=1))
    return counts.assign(**{"lost at more than half of the steps": (rows["lost"] > 0.5).groupby(bins, observed=True).sum()})


def measure(given: Namespace) -> dict[str, Any]:
    found, failures = compare_in(places(given), given)
    rows = [row for place, result in found for row in measures(place, result)]
    frame = pd.DataFrame(rows)
    own = frame[frame["controller"] == "luxloop"]
    bounds = own.assign(controller="bound", iou=own["iou_bound"])
    shown = pd.concat([frame, bounds]).query(f"visible >= {VISIBLE}")
    table(f"IoU where the visible share is at least {VISIBLE:g}", shown)
    table("The same by latency", shown[~shown["kind"].str.startswith(ON_ROAD)].sort_values("latency", kind="stable"), "latency")
    table("Grades", pd.concat([own, bounds])[lambda each: each["kind"].isin(given.from_3_m)], "world")
    show("By visible share", by_share(given, own).to_dict("index"))
    return {"rows": rows, "goals": goals(given, frame), "failures": failures}


if __name__ == "__main__":
    run(measure, __doc__, "only", "out", "jobs")
