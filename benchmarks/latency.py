"""How well controllers settle with late frames: `python benchmarks/latency.py [--quick] [--out FOLDER] [--json FILE]`.

Worlds drawn as in benchmarks/places.py from another seed, those in which lamp and camera can show the symbol; each with every latency, and
in each of them all controllers side by side. Goes on where an earlier run in the same folder was. Prints the tables of
docs/results/latency.md.
"""

from argparse import Namespace
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import places
from bench import Goal, cases, run, show
from side_by_side import World, bound, compare_in, series

from luxloop import prepare

END = 5  # steps of which the mean is the end
TUNED, JUDGED = "thesis_pid, tuned", 2  # controller and latency of the goal


def worlds(given: Namespace) -> Iterator[World]:
    """Every world in which enough of the symbol can be seen, with every latency."""
    drawn = places.places(cases(places.measure, seed=given.seed, every=given.every, from_3_m={}))
    on_camera = [each for each in drawn if each.facts["kind"] != places.ON_ROAD]
    shown = [each for each in on_camera if bound(prepare(each.scenario, "cpu"))[1]["visible"] >= places.VISIBLE]
    for latency in given.latencies:
        for world in shown:
            camera = world.scenario.camera.model_copy(update={"latency_steps": latency})
            scenario = world.scenario.model_copy(update={"camera": camera, "steps": given.steps + latency})
            name = world.key.rpartition(", ")[0]
            yield World(f"{name}, {latency} late", {**world.facts, "latency": latency}, scenario, given.controllers)


def summary(rows: pd.DataFrame) -> dict[str, Any]:
    """A controller at a latency: a run that does not settle counts as later than all others."""
    return {
        "settled": f"{rows['settle_step'].notna().sum()} of {len(rows)}",
        "settle step, median": float(rows["settle_step"].fillna(np.inf).median()),
        "IoU, mean": f"{rows['iou'].mean():.2f} ({rows['iou'].min():.2f})",
    }


def measure(given: Namespace) -> dict[str, Any]:
    found, failures = compare_in(worlds(given), given)
    rows = [
        {
            **world.facts,
            "controller": controller,
            "settle_step": each["settle_step"],
            "iou": float(series(each, "iou", 0.0)[-END:].mean()),
        }
        for world, result in found
        for controller, each in result["metrics"].items()
    ]
    frame = pd.DataFrame(rows).astype({"settle_step": float})
    for latency, late in frame.groupby("latency"):
        show(f"{latency} late", {name: summary(each) for name, each in late.groupby("controller", sort=False)})
    judged = frame.query("controller == @TUNED and latency == @JUDGED")["settle_step"].notna()
    goal = Goal(f"share of worlds in which {TUNED} settles, {JUDGED} late", float(judged.mean()), given.least_settled, True)
    return {"rows": rows, "goals": [goal], "failures": failures}


if __name__ == "__main__":
    run(measure, __doc__, "seed", "every", "only", "out", "jobs")
