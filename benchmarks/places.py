"""How well symbols lie on hard roads: `python benchmarks/places.py [--quick] [--out FOLDER] [--json FILE]`.

Worlds drawn from a seed, and in each of them all controllers side by side, beside what lamp and camera allow there. Goes on where an
earlier run in the same folder was. `--quick`: about an eighth of the worlds. Prints the tables of docs/results/places.md.
"""

from argparse import Namespace
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from bench import Goal, run, show, study_options
from side_by_side import DARK, SMALL, World, compare_in, road_of, series, table

from luxloop.loop.recording.summary import AXES
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario, load

FEEDFORWARD = "feedforward, true road"
CONTROLLERS = ("open", "thesis_pid", "gauss_newton", "model_reference", FEEDFORWARD, "luxloop")
ON_THE_ROAD_CONTROLLERS = ("open", FEEDFORWARD, "luxloop")  # the others compare with what a flat road looks like
SEED = 4
STEPS = 25  # and as many more as frames are late; the thesis' controller needs 20 to settle

FROM_3_M, ON_ROAD, ROAD_FROM_3_M = "grade from 3 m", "place", "place, grade from 3 m"
KINDS = (FROM_3_M, "grade", "crest or sag", "cross-fall", "step", "roughness", "scan", ROAD_FROM_3_M, ON_ROAD)
GRADES_PERCENT = (-3, -2, -1, 1, 2, 3, 4)  # from 3 m on, seen at once from the target's pose
EVERY_ON_ROAD = 6  # every sixth world is also run with target = "place"
BEGINS_M = (3.0, 8.0, 13.0)
CURVED_M = 60.0  # length of a crest or sag, unless it gets too steep before
PLACES = 16  # of each scan
# Where on a scan: along it from and to, and how far to its sides, in m. Long ones begin and end with level stretches, which are left out.
SCANS = {
    "belgian_block": ((732.0, 738.0), 0.7),
    "halfround_4in": ((44.0, 56.0), 2.0),
    "Horstwalde": ((85.0, 165.0), 1.2),
    "detrended_rms_course_1in": ((100.0, 415.0), 2.0),
}
HEADING_DEG = 5.0  # to either side, in either direction of the scan
SYMBOLS = ("snowflake", "chevrons", "warning_triangle", "distance_warning")
# The lamp's field ends 3.5 degrees down, which is 12.3 m ahead on a flat road: at 14.5 m the whole symbol of 4 m is in it.
TARGETS_M = ((14.5, 0.0), (17.0, 0.0), (25.0, 0.0), (17.0, 1.5), (17.0, -1.5))
AT_TARGET = {"x_m": 17.0, "y_m": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0}
PERIPHERIES = ((13.8 / 17, -1.4), (20.5 / 17, -2.0), (14.2 / 17, 1.6), (21.0 / 17, 2.6))  # x as a multiple of the target's, y from it in m
LATENCIES = (0, 1, 2, 3)

END = 5  # steps of which the mean is the end
VISIBLE = 0.8  # share of the target's cells that lamp and camera allow at least where goals hold
LOOKS = 3  # after the first frame, within which a symbol is found
NOTHING = 0.05  # IoU of a symbol that nobody recognises
BINS = (0.0, 0.2, 0.5, VISIBLE)  # of the visible share, where less can be seen
Road = dict[str, Any]
Row = dict[str, Any]


def places(quick: bool) -> Iterator[World]:
    """All worlds, every eighth of them where it shall be quick, but those whose scan is not here."""
    for kind, grades in ((FROM_3_M, GRADES_PERCENT), (ROAD_FROM_3_M, (-4, *GRADES_PERCENT))):
        for percent in grades[:: 3 if quick else 1]:
            road = _grade(percent, 0.0, BEGINS_M[0])
            yield _world(kind, f"{percent:+} % from 3 m on", road, "snowflake", (17.0, 0.0), AT_TARGET, 0)
    for k, (kind, name, road) in list(enumerate(_roads(np.random.default_rng(SEED))))[:: 8 if quick else 1]:
        generator = np.random.default_rng([SEED, k])  # so that a world is the same in both runs
        x, y = TARGETS_M[generator.integers(len(TARGETS_M))]
        x_share, beside = PERIPHERIES[generator.integers(len(PERIPHERIES))]
        start = {"x_m": x_share * x, "y_m": y + beside, "roll_deg": 5.0, "pitch_deg": -2.0}
        symbol, latency = str(generator.choice(SYMBOLS)), int(generator.choice(LATENCIES))
        if "file" in road:
            if data.present(road["file"]) is None:
                continue
            road |= {"at_x_m": x, "at_y_m": y}
        yield _world(kind, name, road, symbol, (x, y), start, latency)
        if k % EVERY_ON_ROAD == 0:
            yield _world(ON_ROAD, name, road, symbol, (x, y), start, latency)


def _roads(generator: np.random.Generator) -> Iterator[tuple[str, str, Road]]:
    """Kind, name and road of each world that is drawn."""
    for start in BEGINS_M:
        for percent in (*range(-6, 0), *range(1, 7)):
            yield "grade", f"grade {percent:+} % from {start:g} m on", _grade(percent, 0.0, start)
    for k in range(32):
        radius = round(float(np.exp(generator.uniform(np.log(150), np.log(2000)))), -1)
        start, sign = BEGINS_M[k % len(BEGINS_M)], float(generator.choice([-1, 1]))
        percent = sign * min(20.0, 100 * CURVED_M / radius)
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
    for file, (along, beside) in SCANS.items():
        for _ in range(PLACES):
            u, v = round(generator.uniform(*along), 1), round(generator.uniform(-beside, beside), 1)
            heading = round(180 * int(generator.integers(2)) + generator.uniform(-HEADING_DEG, HEADING_DEG), 1)
            road = {"kind": "opencrg", "file": file, "u_m": u, "v_m": v, "heading_deg": heading}
            yield "scan", f"{file} at {u:g} m, {v:+g} m aside, {heading:g}°", road


def _grade(grade_percent: float, crossfall_percent: float, start_x_m: float) -> Road:
    return {"kind": "grade", "grade_percent": grade_percent, "crossfall_percent": crossfall_percent, "start_x_m": start_x_m}


def _world(kind: str, name: str, road: Road, symbol: str, at: tuple[float, float], start: dict[str, float], late: int) -> World:
    target = "place" if kind.startswith(ON_ROAD) else "appearance"
    function = {"image": symbol, "x_m": at[0], "y_m": at[1], "target": target, "start": start, "controller": {"name": "luxloop"}}
    changes = {"road": road, "functions": {"symbol": function}, "camera": {"latency_steps": late}}
    return world(kind, name, load("flat", (SMALL, changes), steps=STEPS + late))


def world(kind: str, name: str, scenario: Scenario) -> World:
    symbol, late, on_road = scenario.symbol, scenario.camera.latency_steps, scenario.symbol.target == "place"
    target = f"{symbol.x_m:g} m" + (f", {symbol.y_m:+g} m aside" if symbol.y_m else "") + (" on the road" if on_road else "")
    tables = {each: {"name": each} for each in (ON_THE_ROAD_CONTROLLERS if on_road else CONTROLLERS)}
    tables[FEEDFORWARD] = {"name": "feedforward", "road": road_of(scenario)}
    return World(f"{name}; {symbol.image} at {target}, {late} late", {"kind": kind, "latency": late}, scenario, tables, bounded=True)


def measures(place: World, found: Mapping[str, Any]) -> list[Row]:
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


def goals(rows: Sequence[Row]) -> list[Goal]:
    """Shares of the worlds in which something holds, where enough is visible, or of a kind, however much is visible."""
    own = [row for row in rows if row["controller"] == "luxloop"]
    feedforward = [row for row in rows if row["controller"] == FEEDFORWARD]

    def clear(rows: Sequence[Row], on_road: bool = False) -> list[Row]:
        return [row for row in rows if row["visible"] >= VISIBLE and row["kind"].startswith(ON_ROAD) == on_road]

    def goal(what: str, rows: Sequence[Row], holds: Callable[[Row], bool], share: float = 1.0) -> Goal:
        count = sum(map(bool, map(holds, rows)))
        return Goal(what, count / len(rows) if rows else None, share, True, f"{count} of {len(rows)}")

    looks, on_road = clear(own), clear(own, on_road=True)
    from_3_m, on_road_from_3_m = ([row for row in own if row["kind"] == kind] for kind in (FROM_3_M, ROAD_FROM_3_M))
    return [
        goal("IoU at least 0.95 x feedforward's", looks, _near_feedforward, 0.95),
        goal("IoU at least 0.85 x that", looks, lambda r: r["iou"] >= 0.85 * r["iou_feedforward"]),
        goal("Feedforward within 0.02 of the bound", clear(feedforward), lambda r: r["iou"] >= r["iou_bound"] - 0.02),
        goal("No more than 0.02 below the open loop", looks, _not_below_open),
        goal("No more than 0.02 below thesis_pid", looks, lambda r: r["below_thesis"] <= 0.02),
        goal(f"Found within latency + {LOOKS} steps", looks, lambda r: r["found"] is not None and r["found"] <= r["latency"] + LOOKS),
        goal("Never lost after that", looks, lambda r: r["lost_later"] == 0),
        goal("Grades of -3 to +4 % from 3 m on: IoU at least 0.95 x the bound", from_3_m, lambda r: r["iou"] >= 0.95 * r["iou_bound"]),
        goal("On the road itself: IoU at least 0.95 x feedforward's", on_road, _near_feedforward, 0.95),
        goal("On the road itself: no more than 0.02 below the open loop", on_road, _not_below_open),
        goal(
            "On the road itself, grades from -4 % on: IoU at least 0.85, or 0.95 x the bound",
            on_road_from_3_m,
            lambda r: r["iou"] >= min(0.85, 0.95 * r["iou_bound"]),
        ),
    ]


def _near_feedforward(row: Row) -> bool:
    return row["iou"] >= 0.95 * row["iou_feedforward"]


def _not_below_open(row: Row) -> bool:
    return row["below_open"] <= 0.02


# What becomes of the symbol where less of it can be seen; the first that is true counts.
OUTCOMES = {
    "nothing, nor has the bound": lambda r: r["iou_bound"] < NOTHING,
    "as good as for the true road": lambda r: r["iou"] >= 0.95 * max(r["iou_feedforward"], r["iou_bound"]),
    "better than the open loop": lambda r: r["below_open"] < -0.02,
    "as the open loop": _not_below_open,
    "worse than the open loop": lambda r: True,
}


def by_share(rows: Sequence[Row]) -> Iterator[tuple[str, dict[str, int]]]:
    """What becomes of luxloop's symbol where less of it can be seen, counted by visible share."""
    for low, high in pairwise(BINS):
        found = [row for row in rows if low <= row["visible"] < high]
        ends = Counter(next(name for name, holds in OUTCOMES.items() if holds(row)) for row in found)
        outcomes = {name: ends[name] for name in OUTCOMES}
        lost = sum(row["lost"] > 0.5 for row in found)
        yield f"{low:g} to {high:g}", {"worlds": len(found), **outcomes, "lost at more than half of the steps": lost}


def measure(given: Namespace) -> dict[str, Any]:
    found, failures = compare_in(places(given.quick), given)
    rows = [row for place, result in found for row in measures(place, result)]
    own = [row for row in rows if row["controller"] == "luxloop"]
    bounds = [row | {"controller": "bound", "iou": row["iou_bound"]} for row in own]
    table(f"IoU where the visible share is at least {VISIBLE:g}", [row for row in rows + bounds if row["visible"] >= VISIBLE])
    table("Grades", [row for row in own + bounds if row["kind"].endswith(FROM_3_M)], "world")
    show("By visible share", dict(by_share(own)))
    return {"rows": rows, "goals": goals(rows), "failures": failures}


if __name__ == "__main__":
    only = {"nargs": "+", "choices": KINDS, "metavar": "KIND", "help": f"these kinds of roads alone: {', '.join(KINDS)}"}
    run(measure, __doc__, only=only, **study_options("places"))
