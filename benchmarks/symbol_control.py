"""How well symbols lie on roads by luxloop's controllers: `python benchmarks/symbol_control.py [--quick] [--out FOLDER] [--json FILE]`.

Standing roads, late frames, drives and disturbances, and in each of these worlds all controllers side by side. Goes on where an
earlier run in the same folder was. `--quick`: one seed, two latencies. Prints the tables of docs/results/symbol_control.md.
"""

import json
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import side_by_side
from bench import Goal, run, show, study, study_options
from side_by_side import DARK, compare, job, road_of, series

from luxloop.loop.recording.manifest import digests
from luxloop.loop.recording.summary import AXES
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.scenario.overrides import Override

OFFSET_M = 0.03  # by which the feed-forward's road is too high, and the one that luxloop believes in at a wrong start
FEEDFORWARD = "feedforward, 3 cm off"
CONTROLLERS = ("open", "thesis_pid", "gauss_newton", "model_reference", FEEDFORWARD, "luxloop")
Changes = tuple[str, tuple[Override, ...]]  # a shipped scenario and what changes in it

STANDING: dict[str, Changes] = {
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
DRIVING: dict[str, Changes] = {
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
DISTURBED: dict[str, Changes] = {
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
SMALL = "camera={width_px=640, height_px=480}"
STEPS, DISTURBED_STEPS, SEEDS = 30, 50, 5

BEGIN = 11  # from this step on the symbol is compared with the open loop, and judged while the car moves
END = 5  # steps of which the mean is the end, as in summaries
NEAR = 0.02  # of the undisturbed run's IoU: recovered
Row = dict[str, Any]
Judged = Mapping[str, Mapping[str, Any]]  # by controller


@dataclass(frozen=True)
class Case:
    """One world: part of the table, scene, frames' latency in steps, seed, and the scenario of which each controller gets its turn."""

    part: str
    scene: str
    latency: int
    seed: int
    scenario: Scenario

    @property
    def key(self) -> str:
        return f"{self.scene}, {self.latency} late, seed {self.seed}"

    @property
    def parameters(self) -> dict[str, Any]:
        """Of the job."""
        tables: dict[str, dict[str, Any]] = {name: {"name": name} for name in CONTROLLERS}
        road = road_of(self.scenario) if self.scenario.vehicle is None else {"kind": "flat"}
        tables[FEEDFORWARD] = {"name": "feedforward", "road": road, "offset_m": OFFSET_M}
        if self.scene == BELIEVED:
            tables["luxloop"]["start_height_m"] = OFFSET_M
        return job(self.scenario, tables)


def cases(seeds: int, quick: bool) -> Iterator[Case]:
    """All worlds but those whose road was measured and is not here."""
    for seed in range(seeds):
        for scene, (name, changes) in STANDING.items():
            steps = {"steps": STEPS} if load(name).steps == 40 else {}  # boxes need the time that they are given
            for latency in (0, 2) if quick else LATENCIES:
                scenario = load(name, (SMALL, *changes, f"camera.latency_steps={latency}"), seed=seed, **steps)
                if scenario.road.kind != "opencrg" or data.present(scenario.road.file) is not None:
                    yield Case("standing", scene, latency, seed, scenario)
        for scene, (name, changes) in DRIVING.items():
            rough = ("road.roughness_class='D'", f"road.seed={ROUGH[seed]}") if name == "driving" else ()
            yield Case("driving", scene, 0, seed, load(name, (SMALL, *rough, *changes), seed=seed, steps=STEPS))
        for scene, (name, changes) in DISTURBED.items():
            yield Case("disturbed", scene, 0, seed, load(name, (SMALL, *changes), seed=seed, steps=DISTURBED_STEPS))


def measures(case: Case, judged: Judged, undisturbed: Judged | None = None) -> list[Row]:
    """A row a controller. undisturbed: the same without its disturbance, where it has one."""
    world = {"part": case.part, "scene": case.scene, "latency": case.latency, "seed": case.seed}
    open_loop, rows = series(judged["open"], "iou", 0.0), []
    for controller, each in judged.items():
        iou = series(each, "iou", 0.0)
        offset = np.stack([series(each, axis, DARK) for axis in AXES])
        drives = case.part == "driving"
        centroid = np.abs(offset[:, BEGIN:]).max(0).mean() if drives else np.abs(offset[:, -END:].mean(1)).max()
        row = world | {
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


class Target(NamedTuple):
    """What luxloop shall reach in some scenes.

    each: of what the mean over seeds has to reach it; "all": that of all scenes and latencies together; "case": the worst run.
    """

    what: str
    measure: str
    limit: float
    scenes: tuple[str, ...]
    least: bool = False
    each: Literal["all", "scene", "case"] = "scene"

    def goal(self, rows: Sequence[Row]) -> Goal:
        """The value that counts, and where it is so."""
        groups: dict[str, list[float]] = {}
        for row in rows:
            if row["controller"] == "luxloop" and row["scene"] in self.scenes and row.get(self.measure) is not None:
                late = f", {row['latency']} late" if row["latency"] else ""
                name = {"all": "", "scene": row["scene"] + late, "case": f"{row['scene']}{late}, seed {row['seed']}"}[self.each]
                groups.setdefault(name, []).append(row[self.measure])
        means = [(float(np.mean(values)), name) for name, values in groups.items()]
        value, where = (min if self.least else max)(means, default=(None, ""))
        return Goal(self.what, value, self.limit, self.least, where)


EVEN, CURVED, STEEP = ("flat",), ("bumps", "grade + cross-fall", "mixed"), ("speed bump", "curb")
SCANS = ("Belgian block", "half-round bar", "torsion track", "rough course")
ROADS = (*EVEN, *CURVED, *SCANS, *STEEP)
WORST = ("overshoot", "centroid", "gap")
DISTURBANCES = tuple(scene for scene in DISTURBED if scene != UNDISTURBED)
NOWHERE = "Nowhere, at no step, below the open loop: "
TARGETS = (
    Target("Settling, mean of roads and latencies, steps", "settle", 6, ROADS, each="all"),
    Target("Overshoot, %", "overshoot", 5, ROADS),
    Target("Centroid on flat, curved and measured roads, %", "centroid", 1, (*EVEN, *CURVED, *SCANS)),
    Target("Centroid on speed bump and curb, %", "centroid", 2, STEEP),
    Target("IoU on the flat road", "iou", 0.99, EVEN, least=True),
    Target("IoU on bumps, grade + cross-fall and mixed", "iou", 0.95, CURVED, least=True),
    Target("IoU on speed bump and curb", "iou", 0.85, STEEP, least=True),
    *(
        Target(NOWHERE + name, "gap", 0.02, tuple(scenes), each="case")
        for name, scenes in {"standing": STANDING, "moving": DRIVING, "disturbed": DISTURBED}.items()
    ),
    *(
        Target(f"Mean IoU, {scene}", "iou", least, (scene,), least=True)
        for scene, least in zip(DRIVING, (0.92, 0.88, 0.80, 0.80, 0.90, 0.60), strict=True)
    ),
    Target("Steps to come near the undisturbed IoU after a disturbance", "recovery", 10, DISTURBANCES, each="case"),
)


def table(title: str, rows: Sequence[Row], field: str, values: Iterable[Any], measure: str = "iou") -> None:
    """A row for each value of the field and a column a controller: the mean of a measure, its least in brackets."""
    lines: dict[str, dict[str, str]] = {}
    for value in values:
        for name in CONTROLLERS:
            if own := [row[measure] for row in rows if row[field] == value and row["controller"] == name]:
                lines.setdefault(str(value), {})[name] = f"{np.mean(own):.2f} ({min(own):.2f})"
    show(title, lines)


def extremes(rows: Sequence[Row]) -> Iterator[tuple[str, dict[str, Any]]]:
    """A row for each controller: the median step of settling, and the worst of the other measures."""
    for name in dict.fromkeys(row["controller"] for row in rows):
        own = [row for row in rows if row["controller"] == name]
        worst = {f"{key}, worst": max((row[key] for row in own if row[key] is not None), default=None) for key in WORST}
        yield name, {"settled, median": float(np.median([row["settle"] for row in own])), **worst}


def measure(given: Namespace) -> dict[str, Any]:
    chosen = [case for case in cases(1 if given.quick else given.seeds, given.quick) if not given.only or case.scene in given.only]
    files = sorted({file for case in cases(1, quick=True) for file in digests(case.scenario).items()})  # of all worlds, roads among them
    found, failures = study(compare, {case.key: case.parameters for case in chosen}, given, [side_by_side], json.dumps(files))
    judged = [(case, found[case.key]["judged"]) for case in chosen if case.key in found]
    undisturbed = {case.seed: each for case, each in judged if case.scene == UNDISTURBED}
    rows = [
        row for case, each in judged for row in measures(case, each, undisturbed.get(case.seed) if case.scene in DISTURBANCES else None)
    ]
    if absent := [] if given.only else [scene for scene in STANDING if all(case.scene != scene for case in chosen)]:
        print(f"\nMeasured roads that are not here: {', '.join(absent)}")
    standing, on_time = [row for row in rows if row["part"] == "standing"], [row for row in rows if row["latency"] == 0]
    table("IoU", on_time, "scene", STANDING)
    show("Standing, frames on time", dict(extremes([row for row in standing if row["latency"] == 0])))
    table("IoU while driving", on_time, "scene", DRIVING)
    table("Least IoU from a disturbance on", on_time, "scene", DISTURBANCES, "iou_least")
    table("IoU of late frames", standing, "latency", LATENCIES)
    return {"rows": rows, "goals": [target.goal(rows) for target in TARGETS], "failures": failures}


if __name__ == "__main__":
    seeds = {"type": int, "choices": range(1, SEEDS + 1), "default": SEEDS, "help": f"by default {SEEDS}"}
    only = {"nargs": "+", "metavar": "SCENE", "help": "these scenes alone"}
    run(measure, __doc__, packages=("torch", "numpy"), threads=(), seeds=seeds, only=only, **study_options("symbol_control"))
