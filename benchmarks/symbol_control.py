"""How well symbols lie on roads by luxloop's controllers: `python benchmarks/symbol_control.py [--quick] [--out FOLDER] [--json FILE]`.

Standing roads, late frames, drives and disturbances, and in each of these worlds all controllers side by side. Goes on where an
earlier run in the same folder was. `--quick`: one seed, two latencies. Prints the tables of docs/results/symbol_control.md.
"""

from argparse import Namespace
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from bench import Goal, run, show, study_options
from side_by_side import DARK, SMALL, World, compare_in, road_of, series, table

from luxloop.loop.recording.summary import AXES
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario, load

OFFSET_M = 0.03  # by which the feed-forward's road is too high, and the one that luxloop believes in at a wrong start
FEEDFORWARD = "feedforward, 3 cm off"
CONTROLLERS = ("open", "thesis_pid", "gauss_newton", "model_reference", FEEDFORWARD, "luxloop")

STANDING = {  # by kind, a shipped scenario and what changes in it
    "flat": ("flat", ()),
    "bumps": ("snowflake", ("road={kind='bumps'}",)),
    "grade + cross-fall": ("snowflake", ("road={kind='grade'}",)),
    "mixed": ("snowflake", ()),
    "speed bump": ("speed_bump", ()),
    "curb": ("curb", ()),
    "Belgian block": ("belgian_block", ()),
    "half-round bar": ("half_round_bar", ()),
    "torsion track": ("torsion_track", ("road.u_m=98",)),
    "rough course": ("rough_course", ("road.u_m=117",)),
    "box, standing": ("black_box_static", ()),
    "box, comes and goes": ("black_box_dynamic", ()),
    "two lamps": ("snowflake", ("headlight.lamps=['left', 'right']", "functions.symbol.modules=['left', 'right']")),
}
LATENCIES = (0, 1, 2, 3)
ROUGH = (15, 2, 10, 21, 18)  # seeds with which a class D road is 2.3 to 2.7 cm rough (RMS) from 8 to 70 m ahead
BELIEVED = "20 m/s, from 3 cm off"
ASIDE_M = 17.28  # where the symbol for 17 m lies when it is drawn for a road that is 3 cm higher, as both lamp and camera are over it
NODDING = "vehicle={{course=[{{speed_m_s=0}}], oscillation={{pitch_deg={}, rate_hz=1.2}}}}"
LATE = "sensors={wheels={delay_s=0.03}, gyro={delay_s=0.03}, attitude={delay_s=0.03}}"
DRIVING = {
    "5 m/s": ("driving", ("vehicle.course=[{speed_m_s=5}]",)),
    "10 m/s": ("driving", ("vehicle.course=[{speed_m_s=10}]",)),
    "20 m/s": ("driving", ()),
    BELIEVED: ("driving", (f"functions.symbol.start.x_m={ASIDE_M}",)),
    "nods by 0.2°": ("flat", (NODDING.format(0.2), LATE)),
    "nods by 1°": ("flat", (NODDING.format(1.0), LATE)),
}
FROM, UNTIL = 20, 30  # steps of a disturbance; the thesis' controller needs 20 to settle
SPELL = f"from_step={FROM}, until_step={UNTIL}"
UNDISTURBED = "undisturbed"
DISTURBED = {
    UNDISTURBED: ("snowflake", ()),
    **{
        name: ("snowflake", (f"disturbances.{table}, {SPELL}}}]",))
        for name, table in {
            "glare in on frames": "oncoming=[{position_m=[40, 2, 0.65], intensity_cd=500, frames='on'",
            "ambient light x 4 in on frames": "ambient=[{factor=4, frames='on'",
            "ambient light x 4 in off frames": "ambient=[{factor=4, frames='off'",
            "half of the frames lost": "drops=[{probability=0.5",
            "noise x 10": "noise=[{factor=10",
        }.items()
    },
}
STEPS, DISTURBED_STEPS, SEEDS = 30, 50, 5

BEGIN = 11  # from this step on the symbol is compared with the open loop, and evaluated while the car moves
END = 5  # steps of which the mean is the end, as in summaries
NEAR = 0.02  # of the undisturbed run's IoU: recovered
Row = dict[str, Any]
SymbolMetrics = Mapping[str, Mapping[str, Any]]  # by controller


def worlds(seeds: int, quick: bool) -> Iterator[World]:
    """All worlds but those whose road was measured and is not here."""
    for seed in range(seeds):
        for kind, (name, changes) in STANDING.items():
            steps = {"steps": STEPS} if load(name).steps == 40 else {}  # boxes need the time that they are given
            for latency in (0, 2) if quick else LATENCIES:
                scenario = load(name, (SMALL, *changes, f"camera.latency_steps={latency}"), seed=seed, **steps)
                if scenario.road.kind != "opencrg" or data.present(scenario.road.file) is not None:
                    yield world("standing", kind, scenario)
        for kind, (name, changes) in DRIVING.items():
            rough = ("road.roughness_class='D'", f"road.seed={ROUGH[seed]}") if name == "driving" else ()
            yield world("driving", kind, load(name, (SMALL, *rough, *changes), seed=seed, steps=STEPS))
        for kind, (name, changes) in DISTURBED.items():
            yield world("disturbed", kind, load(name, (SMALL, *changes), seed=seed, steps=DISTURBED_STEPS))


def world(part: str, kind: str, scenario: Scenario) -> World:
    tables = {name: {"name": name} for name in CONTROLLERS}
    road = road_of(scenario) if scenario.vehicle is None else {"kind": "flat"}
    tables[FEEDFORWARD] = {"name": "feedforward", "road": road, "offset_m": OFFSET_M}
    if kind == BELIEVED:
        tables["luxloop"]["start_height_m"] = OFFSET_M
    latency, seed = scenario.camera.latency_steps, scenario.seed
    late = f", {latency} late" if latency else ""
    return World(
        f"{kind}{late}, seed {seed}", {"part": part, "kind": kind, "latency": latency, "late": late, "seed": seed}, scenario, tables
    )


def measures(facts: Row, metrics: SymbolMetrics, undisturbed: SymbolMetrics | None = None) -> list[Row]:
    """A row a controller. undisturbed: the same without its disturbance, where it has one."""
    open_loop, drives, rows = series(metrics["open"], "iou", 0.0), facts["part"] == "driving", []
    for controller, each in metrics.items():
        iou = series(each, "iou", 0.0)
        offset = np.stack([series(each, axis, DARK) for axis in AXES])
        centroid = np.abs(offset[:, BEGIN:]).max(0).mean() if drives else np.abs(offset[:, -END:].mean(1)).max()
        row = facts | {
            "controller": controller,
            "iou": float((iou[BEGIN:] if drives else iou[-END:]).mean()),
            "iou_least": float(iou[BEGIN:].min()),
            "settle": len(iou) if each["settle_step"] is None else each["settle_step"],
            "overshoot": DARK if (offset == DARK).all() else each["overshoot_percent"],
            "centroid": float(centroid),
            "gap": float((open_loop - iou)[BEGIN:].max()),
        }
        if undisturbed is not None:
            worse = np.flatnonzero(iou[UNTIL:] < series(undisturbed[controller], "iou", 0.0)[UNTIL:] - NEAR)
            row["recovery"] = int(worse[-1]) + 1 if len(worse) else 0
        rows.append(row)
    return rows


ALL, KIND = "", "{kind}{late}"  # of which the mean counts: everything together, or each kind of world with a latency
RUN = KIND + ", seed {seed}"


def goal(rows: Iterable[Row], what: str, measure: str, limit: float, kinds: Collection[str], least: bool = False, each: str = KIND) -> Goal:
    """The worst mean of luxloop's measure, and where it is so."""
    groups = {}
    for row in rows:
        if row["controller"] == "luxloop" and row["kind"] in kinds and row.get(measure) is not None:
            groups.setdefault(each.format(**row), []).append(row[measure])
    means = [(float(np.mean(values)), name) for name, values in groups.items()]
    value, where = (min if least else max)(means, default=(None, ""))
    return Goal(what, value, limit, least, where)


EVEN, CURVED, STEEP = ("flat",), ("bumps", "grade + cross-fall", "mixed"), ("speed bump", "curb")
SCANS = ("Belgian block", "half-round bar", "torsion track", "rough course")
ROADS = (*EVEN, *CURVED, *SCANS, *STEEP)
DISTURBANCES = set(DISTURBED) - {UNDISTURBED}
NOWHERE = "Nowhere, at no step, below the open loop: "
GOALS = (  # arguments of `goal`
    ("Settling, mean of roads and latencies, steps", "settle", 6, ROADS, False, ALL),
    ("Overshoot, %", "overshoot", 5, ROADS),
    ("Centroid on flat, curved and measured roads, %", "centroid", 1, (*EVEN, *CURVED, *SCANS)),
    ("Centroid on speed bump and curb, %", "centroid", 2, STEEP),
    ("IoU on the flat road", "iou", 0.99, EVEN, True),
    ("IoU on bumps, grade + cross-fall and mixed", "iou", 0.95, CURVED, True),
    ("IoU on speed bump and curb", "iou", 0.85, STEEP, True),
    (NOWHERE + "standing", "gap", 0.02, STANDING, False, RUN),
    (NOWHERE + "moving", "gap", 0.02, DRIVING, False, RUN),
    (NOWHERE + "disturbed", "gap", 0.02, DISTURBED, False, RUN),
    *((f"Mean IoU, {kind}", "iou", least, (kind,), True) for kind, least in zip(DRIVING, (0.92, 0.88, 0.8, 0.8, 0.9, 0.6), strict=True)),
    ("Steps to come near the undisturbed IoU after a disturbance", "recovery", 10, DISTURBANCES, False, RUN),
)


def extremes(rows: Sequence[Row]) -> Iterator[tuple[str, dict[str, Any]]]:
    """A row for each controller: the median step of settling, and the worst of the other measures."""
    for name in dict.fromkeys(row["controller"] for row in rows):
        own = [row for row in rows if row["controller"] == name]
        worst = {
            f"{key}, worst": max((row[key] for row in own if row[key] is not None), default=None)
            for key in ("overshoot", "centroid", "gap")
        }
        yield name, {"settled, median": float(np.median([row["settle"] for row in own])), **worst}


def measure(given: Namespace) -> dict[str, Any]:
    found, failures = compare_in(worlds(1 if given.quick else given.seeds, given.quick), given)
    undisturbed = {world.facts["seed"]: each["metrics"] for world, each in found if world.facts["kind"] == UNDISTURBED}
    rows = []
    for each, result in found:
        rows += measures(each.facts, result["metrics"], undisturbed.get(each.facts["seed"]) if each.facts["kind"] in DISTURBANCES else None)
    standing, on_time = [row for row in rows if row["part"] == "standing"], [row for row in rows if row["latency"] == 0]
    if absent := {} if given.only else STANDING.keys() - {row["kind"] for row in standing}:
        print(f"\nMeasured roads that are not here: {', '.join(absent)}")
    table("IoU, frames on time", [row for row in on_time if row["part"] != "disturbed"])
    show("Standing, frames on time", dict(extremes([row for row in standing if row["latency"] == 0])))
    table("Least IoU from a disturbance on", [row for row in rows if row["kind"] in DISTURBANCES], measure="iou_least")
    table("IoU of late frames", standing, "latency")
    return {"rows": rows, "goals": [goal(rows, *each) for each in GOALS], "failures": failures}


if __name__ == "__main__":
    seeds = {"type": int, "choices": range(1, SEEDS + 1), "default": SEEDS, "help": f"by default {SEEDS}"}
    only = {"nargs": "+", "metavar": "KIND", "help": "these kinds of worlds alone"}
    run(measure, __doc__, seeds=seeds, only=only, **study_options("symbol_control"))
