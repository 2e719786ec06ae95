"""How well symbols lie on the road while the car drives: `python benchmarks/moving.py [--quick] [--out FOLDER] [--json FILE]`.

Worlds drawn from a seed, and in each of them, step by step, all columns of moving.toml side by side: controllers, and what their sensors
know. Beside them the open loop, what luxloop would draw for the true road, for the body's true pose at the time of light, and for both, and
what is left at the end of the symbol's light, drawn once or, with the same frames, at 240 Hz. Goes on where an earlier run in the same
folder was.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import torch
from bench import Goal, run, show, study

from luxloop import Scenario, Simulation, build_controller, load, prepare
from luxloop.loop.simulation.evaluator import projections_by_cause
from luxloop.loop.simulation.result import StepResult
from luxloop.perception.birdseye import rectify
from luxloop.perception.metrics import THRESHOLD

OWN, FAST, OPEN, TRUE, END = "luxloop", "luxloop, 240 Hz", "iou_open", "iou_true", "iou_end"
ABLATION = {
    "iou_true_road": "true road",
    "iou_true_pose": "true pose",
    TRUE: "both",
    END: "at the end",
    f"{FAST}, {END}": "at the end, 240 Hz",
}
Table = dict[str, Any]


def worlds(given: Namespace) -> Iterator[tuple[str, tuple[Table, Table]]]:
    """Key of each world, its facts, and the changes that make it of the scenario `given.base`."""
    for k, (roughness, speed, _) in enumerate(product(given.classes, given.speeds_m_s, range(given.each))):
        generator = np.random.default_rng([given.seed, k])  # so that a world is the same in both runs
        form, image = (str(generator.choice(each)) for each in (given.forms, given.symbols))
        latency, width = (int(generator.choice(each)) for each in (given.latencies, given.widths_px))
        radius, side = float(np.exp(generator.uniform(*np.log(given.radii_m)))), int(generator.choice([-1, 1]))
        curvature = side / max(radius, (speed**2 / given.lateral_m_s2)) if form == "bend" else 0.0
        percent = {"crest": -1, "sag": 1}.get(form, 0) * min(100 * given.curve_m / radius, given.percent)
        grades = [{"x_m": given.begins_m, "percent": percent, "curve_m": given.curve_m}]
        road = {"kind": "profile", "grades": grades, "roughness_class": roughness, "seed": int(generator.integers(1000))}
        facts = {"class": roughness, "speed": speed, "form": form, "image": image, "latency": latency, "width": width}
        yield (
            f"{roughness}, {speed:g} m/s, {form}, {image}, {latency} late, {width} px, seed {k}",
            (
                facts,
                {
                    "road": road,
                    "seed": k,
                    "steps": given.steps,
                    "judge_every": given.judge_every,
                    "camera": {"width_px": width, "height_px": 9 * width // 16, "latency_steps": latency},
                    "vehicle": {"course": [{"speed_m_s": speed, "curvature_1_m": curvature}]},
                    "functions": {"symbol": {"image": image}},
                    "sensors": given.sensors,
                },
            ),
        )


def compare(base: str, changes: Table, columns: Mapping[str, Table]) -> dict[str, Any]:
    """A job: the IoU of each column in each evaluated step, of luxloop's ablation, and the visible share of the target."""
    torch.set_num_threads(1)  # wherever the job runs
    own = {name: load(base, (changes, column)) for name, column in columns.items()}
    world = prepare(own[OWN], "cpu")
    simulations = {name: _with(world, scenario) for name, scenario in own.items()}
    rows = []
    for results in zip(*(each.evaluations() for each in simulations.values()), strict=True):
        found = dict(zip(own, results, strict=True))
        if found[OWN].symbol.metrics is not None:
            row = {name: result.symbol.metrics.iou.item() for name, result in found.items()}
            row |= {key: iou.item() for key, iou in found[OWN].symbol.causes.items() if key in (OPEN, *ABLATION)}
            if FAST in found:
                row[f"{FAST}, {END}"] = found[FAST].symbol.causes[END].item()
            rows.append(row | {"visible": visible(simulations[OWN], found[OWN])})
    return {"iou": pd.DataFrame(rows).round(4).to_dict("list")}


def _with(world: Simulation, scenario: Scenario) -> Simulation:
    """The simulation of a world with controller, sensors and drawings of a scenario; views of the world are rendered once."""
    controlled = world.with_controller(build_controller(scenario.symbol.controller, world.symbol.sensor))
    plant = replace(world.plant, sensors=scenario.sensors, shares=scenario.shares, drawings=scenario.drawings[0])
    return replace(controlled, scenario=scenario, plant=plant)


def visible(simulation: Simulation, result: StepResult) -> float:
    """Share of the target's cells that the symbol lights if drawn for the true road from the true pose."""
    ((name, symbol),) = simulation.controlled.items()
    evaluator, time_s, goal = symbol.evaluator, result.now.time_s, symbol.evaluator.goal
    drawn = projections_by_cause(symbol, None, simulation.world.motion.at(time_s), evaluator.road)[TRUE]
    light = simulation.world.added(time_s, simulation.evaluator.redraw(result, name, drawn), result.off.lights, result.now.commands)
    return float(((rectify(evaluator.plane_at(time_s), light) > THRESHOLD * goal.median) & goal.mask).sum() / goal.mask.sum())


def summary(given: Namespace, found: Mapping[str, Any]) -> dict[str, float]:
    """Means from `given.from_step` on; below_open: how far luxloop was below the open loop in the worst second."""
    series = pd.DataFrame(found["iou"])[given.from_step // given.judge_every :]
    second = round(load(given.base).rate_hz / given.judge_every)
    below = (series[OPEN] - series[OWN]).rolling(min(second, len(series))).mean().max()
    return {**series.mean().to_dict(), "below_open": float(below)}


def goals(given: Namespace, rows: pd.DataFrame) -> list[Goal]:
    """Ratios of mean IoU by speed, the mean on smooth roads with a sharp camera, and the worst second."""
    found = []
    for speed, least in given.least_ratio.items():
        there = rows[rows["speed"] == float(speed)].mean(numeric_only=True)
        ratio = float(there[OWN] / there[TRUE]) if len(there) and there.notna().all() else None
        found.append(Goal(f"IoU over the true drawing's, {speed} m/s", ratio, least, True))
    smooth = rows.query(given.smooth)
    found.append(
        Goal("IoU on classes A and B, 1280 px, least world", float(smooth[OWN].min()) if len(smooth) else None, given.least_iou, True)
    )
    worst = rows.loc[rows["below_open"].idxmax()]
    found.append(Goal("Below the open loop in any second", float(worst["below_open"]), given.most_below_open, where=worst["world"]))
    return found


def measure(given: Namespace) -> dict[str, Any]:
    if wrong := set(given.only) - given.columns.keys():
        sys.exit(f"--only: unknown {', '.join(wrong)}; known are {', '.join(given.columns)}")
    columns = {name: table for name, table in given.columns.items() if name in {OWN, *(given.only or given.columns)}}
    all_worlds = dict(worlds(given))
    jobs = {key: {"base": given.base, "changes": changes, "columns": columns} for key, (_, changes) in all_worlds.items()}
    found, failures = study(compare, jobs, given, [sys.modules[__name__]], load(given.base).digest)
    rows = pd.DataFrame([{"world": key, **all_worlds[key][0], **summary(given, each)} for key, each in found.items()])
    shown = [OPEN, *(each for each in columns if each != FAST), *(key for key in ABLATION if key in rows), "visible"]
    for field in given.fields:
        show(f"Mean IoU by {field}", rows.groupby(field)[shown].mean().rename(columns={OPEN: "open", **ABLATION}).to_dict("index"))
    return {"rows": rows.to_dict("records"), "goals": goals(given, rows), "failures": failures}


if __name__ == "__main__":
    run(measure, __doc__, "only", "out", "jobs", "seed")
