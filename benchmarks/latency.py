"""How well controllers settle with late frames: `python benchmarks/latency.py [--quick] [--out FOLDER] [--json FILE]`.

Worlds drawn as in benchmarks/places.py, from another seed, each with every latency; in each of them all controllers side by side. Goes on
where an earlier run in the same folder was. Prints the tables of docs/results/latency.md.
"""

from argparse import Namespace
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import places
from bench import cases, run, show
from side_by_side import World, compare_in, series

END = 5  # steps of which the mean is the end


def worlds(given: Namespace) -> Iterator[World]:
    """Every drawn world with every latency."""
    drawn = cases(places.measure, seed=given.seed, every=given.every, from_3_m={})
    for world in places.places(drawn):
        for latency in given.latencies if world.facts["kind"] != places.ON_ROAD else ():
            camera = world.scenario.camera.model_copy(update={"latency_steps": latency})
            scenario = world.scenario.model_copy(update={"camera": camera, "steps": given.steps + latency})
            name = world.key.rpartition(", ")[0]
            yield World(f"{name}, {latency} late", {**world.facts, "world": name, "latency": latency}, scenario, given.controllers, True)


def measure(given: Namespace) -> dict[str, Any]:
    found, failures = compare_in(worlds(given), given)
    rows = [
        {
            **world.facts,
            "visible": result["visible"],
            "controller": controller,
            "settle_step": each["settle_step"],
            "iou": float(series(each, "iou", 0.0)[-END:].mean()),
        }
        for world, result in found
        for controller, each in result["metrics"].items()
    ]
    frame = pd.DataFrame(rows).query(f"visible >= {places.VISIBLE}")
    frame["settled"] = frame["settle_step"].notna()
    for latency, late in frame.groupby("latency"):
        of = {name: group for name, group in late.groupby("controller", sort=False)}
        show(
            f"{latency} late, {late['world'].nunique()} worlds",
            {
                name: {
                    "settled, %": 100 * float(each["settled"].mean()),
                    "settle step, median": float(each["settle_step"].fillna(np.inf).median()),
                    "IoU, mean": float(each["iou"].mean()),
                    "least": float(each["iou"].min()),
                }
                for name, each in of.items()
            },
        )
    return {"rows": rows, "failures": failures}


if __name__ == "__main__":
    run(measure, __doc__, "seed", "every", "only", "out", "jobs")
