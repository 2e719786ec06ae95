"""How well symbols lie on roads by luxloop's controllers: `python benchmarks/symbol_control.py [--quick] [--out FOLDER] [--json FILE]`.

Standing roads, late frames, drives and disturbances, and in each of these worlds all controllers side by side. Goes on where an
earlier run in the same folder was. `--quick`: one seed, two latencies. Prints the tables of docs/results/symbol_control.md.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from bench import Goal, run, show
from side_by_side import DARK, SMALL, World, compare_in, road_of, series, table

from luxloop import Scenario, load
from luxloop.loop.recording.summary import AXES
from luxloop.loop.scenario import data

OFFSET_M = 0.03  # by which the feed-forward's road is too high, and the one that luxloop believes in at a wrong start
FEEDFORWARD, BELIEVED, UNDISTURBED = "feedforward, 3 cm off", "20 m/s, from 3 cm off", "undisturbed"
UNTIL = 30  # step of the end of a disturbance
BEGIN = 11  # from this step on the symbol is compared with the open loop, and evaluated while the car moves
END = 5  # steps of which the mean is the end, as in summaries
NEAR = 0.02  # of the undisturbed run's IoU: recovered
SymbolMetrics = Mapping[str, Mapping[str, Any]]  # by controller


def worlds(given: Namespace) -> Iterator[World]:
    """All worlds but those whose road was measured and is not here."""
    if given.seeds > len(given.rough):
        sys.exit(f"--seeds: at most {len(given.rough)}")
    for seed in range(given.seeds):
        for kind, (name, *changes) in given.standing.items():
            steps = {"steps": given.steps} if load(name).steps == 40 else {}  # boxes need the time that they are given
            for latency in given.latencies:
                scenario = load(name, (SMALL, *changes, f"camera.latency_steps={latency}"), seed=seed, **steps)
                if scenario.road.kind != "opencrg" or data.present(scenario.road.file) is not None:
                    yield world(given, "standing", kind, scenario)
        for kind, (name, *changes) in given.driving.items():
            rough = (f"road={{roughness_class='D', seed={given.rough[seed]}}}",) if name == "driving" else ()
            yield world(given, "driving", kind, load(name, (SMALL, *rough, *changes), seed=seed, steps=given.steps))
        for kind, (name, *changes) in given.disturbed.items():
            yield world(given, "disturbed", kind, load(name, (SMALL, *changes), seed=seed, steps=given.disturbed_steps))


def world(given: Namespace, part: str, kind: str, scenario: Scenario) -> World:
    tables = {name: dict(table) for name, table in given.controllers.items()}
    road = road_of(scenario) if scenario.vehicle is None else {"kind": "flat"}
    tables[FEEDFORWARD] = {"name": "feedforward", "road": road, "offset_m": OFFSET_M}
    if kind == BELIEVED:
        tables["luxloop"]["start_height_m"] = OFFSET_M
    latency, seed = scenario.camera.latency_steps, scenario.seed
    late = f", {latency} late" if latency else ""
    facts = {"part": part, "kind": kind, "latency": latency, "late": late, "seed": seed}
    return World(f"{kind}{late}, seed {seed}", facts, scenario, tables)


def measures(world: World, metrics: SymbolMetrics, undisturbed: SymbolMetrics | None = None) -> list[dict[str, Any]]:
    """A row a controller. undisturbed: the same without its disturbance, where it has one."""
    open_loop, drives, rows = series(metrics["open"], "iou", 0.0), world.facts["part"] == "driving", []
    for controller, each in metrics.items():
        iou = series(each, "iou", 0.0)
        offset = np.stack([series(each, axis, DARK) for axis in AXES])
        centroid = np.abs(offset[:, BEGIN:]).max(0).mean() if drives else np.abs(offset[:, -END:].mean(1)).max()
        row = {
            **world.facts,
            "world": world.key,
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


def goals(given: Namespace, rows: pd.DataFrame) -> list[Goal]:
    """The worst mean of luxloop's measures, and where it is so."""
    found, own = [], rows[rows["controller"] == "luxloop"]
    for what, (measure, of, way, limit, *facts) in given.goals.items():
        means = own.reindex(columns=own.columns.union([measure])).query(of, local_dict=given.kinds).groupby(facts)[measure].mean().dropna()
        least = way == ">="
        worst = means.sort_values(ascending=least)[:1]
        value, where = (float(worst.iloc[0]), "".join(worst.index[0])) if len(worst) else (None, "")
        found.append(Goal(what, value, limit, least, where))
    return found


def measure(given: Namespace) -> dict[str, Any]:
    found, failures = compare_in(worlds(given), given)
    undisturbed = {world.facts["seed"]: each["metrics"] for world, each in found if world.facts["kind"] == UNDISTURBED}
    rows = []
    for world, each in found:
        disturbed = world.facts["part"] == "disturbed" and world.facts["kind"] != UNDISTURBED
        rows += measures(world, each["metrics"], undisturbed.get(world.facts["seed"]) if disturbed else None)
    frame = pd.DataFrame(rows)
    standing, on_time = (frame.query(each) for each in ("part == 'standing'", "latency == 0"))
    if absent := {} if given.only else given.standing.keys() - set(standing["kind"]):
        print(f"\nMeasured roads that are not here: {', '.join(absent)}")
    table("IoU, frames on time", on_time.query("part != 'disturbed'"))
    worst = {"settle": "median", "overshoot": "max", "centroid": "max", "gap": "max"}
    extremes = standing.query("latency == 0").groupby("controller", sort=False).agg(worst)
    show("Standing, frames on time: median step of settling, worst of the others", extremes.to_dict("index"))
    table("Least IoU from a disturbance on", frame.query(f"part == 'disturbed' and kind != '{UNDISTURBED}'"), measure="iou_least")
    table("IoU of late frames", standing, "latency")
    return {"rows": rows, "goals": goals(given, frame), "failures": failures}


if __name__ == "__main__":
    run(measure, __doc__, "seeds", "only", "out", "jobs")
