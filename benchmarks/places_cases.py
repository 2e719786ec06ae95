"""The worlds of benchmarks/places.py, drawn from a seed, and the job that runs all controllers and the bound in one of them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from places_bound import bound
from symbol_control_cases import SMALL, finite, shared, side_by_side, uncontrolled

from luxloop.loop.recording.summary import AXES, column
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario, load

FEEDFORWARD = "feedforward, true road"
CONTROLLERS = ("open", "thesis_pid", "gauss_newton", "model_reference", FEEDFORWARD, "luxloop")
HOLD_PLACES = ("open", FEEDFORWARD, "luxloop")  # the others compare with what a flat road looks like
SEED = 4
STEPS = 25  # and as many more as frames are late; the thesis' controller needs 20 to settle

KINDS = ("grade from 3 m", "grade", "crest or sag", "cross-fall", "step", "roughness", "scan", "place, grade from 3 m", "place")
GRADES_PERCENT = (-3, -2, -1, 1, 2, 3, 4)  # from 3 m on, seen at once from the target's pose
ON_THE_ROAD = 6  # every sixth world is also run with target = "place"
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

Road = dict[str, Any]


@dataclass(frozen=True)
class Place:
    """One world: its kind and name, and the scenario of which each controller gets its turn."""

    kind: str
    name: str
    scenario: Scenario

    @property
    def key(self) -> str:
        s = self.scenario
        target = f"{s.symbol.x_m:g} m" + (f", {s.symbol.y_m:+g} m aside" if s.symbol.y_m else "")
        place = " on the road" if s.symbol.target == "place" else ""
        return f"{self.name}; {s.symbol.image} at {target}{place}, {s.camera.latency_steps} late"

    @property
    def parameters(self) -> dict[str, Any]:
        """Of the job."""
        road = self.scenario.road.model_dump(mode="json")
        if "file" in road:
            road["file"] = str(data.locate(road["file"]))
        names = CONTROLLERS if self.scenario.symbol.target == "appearance" else HOLD_PLACES
        tables = {name: {"name": name} for name in names} | {FEEDFORWARD: {"name": "feedforward", "road": road}}
        return {"scenario": uncontrolled(self.scenario), "controllers": tables}


def places(quick: bool) -> Iterator[Place]:
    """All worlds, every eighth of them where it shall be quick, but those whose scan is not here."""
    for kind, target, grades in (
        ("grade from 3 m", "appearance", GRADES_PERCENT),
        ("place, grade from 3 m", "place", (-4, *GRADES_PERCENT)),
    ):
        for percent in grades[:: 3 if quick else 1]:
            road = _grade(percent, 0.0, BEGINS_M[0])
            yield Place(kind, f"{percent:+} % from 3 m on", _scenario(road, "snowflake", (17.0, 0.0), AT_TARGET, 0, target))
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
        yield Place(kind, name, _scenario(road, symbol, (x, y), start, latency))
        if k % ON_THE_ROAD == 0:
            yield Place("place", name, _scenario(road, symbol, (x, y), start, latency, "place"))


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


def _scenario(
    road: Road, symbol: str, at: tuple[float, float], start: dict[str, float], latency: int, target: str = "appearance"
) -> Scenario:
    drawn = {"image": symbol, "x_m": at[0], "y_m": at[1], "target": target, "start": start, "controller": {"name": "luxloop"}}
    changes = {"road": road, "functions": {"symbol": drawn}, "camera": {"latency_steps": latency}}
    return load("flat", (SMALL, changes), steps=STEPS + latency)


def run_place(scenario: Mapping[str, Any], controllers: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """A job: what the judge says of each controller at each step, at which it was lost, and the bound."""
    torch.set_num_threads(1)  # wherever the job runs
    simulation, own = shared(scenario, controllers)
    limit = bound(simulation)
    found = {}
    for name, table in side_by_side(simulation, own).items():
        judged = {column_name: [finite(value) for value in column(table, column_name)] for column_name in (*AXES, "iou")}
        found[name] = judged | {"lost": [loss != "" for loss in table["loss"].to_pylist()]}
    return {"judged": found, "iou_bound": limit.iou, "visible": limit.visible}
