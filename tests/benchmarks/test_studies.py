"""Studies that resume: worlds that controllers share, a bound that is right where that is known, measures that follow from runs."""

import json
import sys
from typing import Any

import bench
import object_based
import pandas as pd
import places
import pytest
import side_by_side
import symbol_control
import torch
import tracking
from tracking import RATE_HZ, Identities, follow, seen, straight

from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import load, validate
from luxloop.loop.studies.training import scenes

CROSSINGS = {name: [straight(*each) for each in objects] for name, objects in bench.cases(tracking.measure).scenes.items()}
TINY = ("camera={width_px=320, height_px=240}",)
SYMBOLS, PLACES = (bench.cases(each.measure) for each in (symbol_control, places))


def metrics(iou: list[float | None], settle_step: int | None = 3, centroid: float | None = 1.0, lost: int = 0) -> dict[str, Any]:
    offsets = {"centroid_error_x_percent": [-2.0, *[centroid] * (len(iou) - 1)], "centroid_error_y_percent": [0.0] * len(iou)}
    flags = [True] * lost + [False] * (len(iou) - lost)
    return {"settle_step": settle_step, "overshoot_percent": None, "iou": iou, "lost": flags, **offsets}


def of_symbol(part: str, own: dict[str, Any], undisturbed: dict[str, Any] | None = None) -> dict[str, Any]:
    """Luxloop's row beside an open loop of 0.5."""
    open_loop = metrics([0.5] * len(own["iou"]))
    reference = None if undisturbed is None else {"open": open_loop, "luxloop": undisturbed}
    world = side_by_side.World("", {"part": part}, load("flat"), {})
    return symbol_control.measures(world, {"open": open_loop, "luxloop": own}, reference)[1]


STEPS_OF = [0.1] * 11 + [0.4] * 5 + [0.8] * 5


@pytest.mark.parametrize(
    ("part", "own", "expected"),
    [
        ("standing", metrics([0.0] * 11 + [0.9] * 8 + [0.3, 0.9]), {"gap": 0.2, "iou_least": 0.3}),
        ("standing", metrics(STEPS_OF), {"iou": 0.8}),
        ("driving", metrics(STEPS_OF), {"iou": 0.6}),
        ("standing", metrics([0.0] * 20, None, None), {"settle": 20, "centroid": 100.0, "iou": 0.0}),
    ],
)
def test_measures_of_symbols_are_of_the_end(part, own, expected):
    found = of_symbol(part, own)
    assert {name: found[name] for name in expected} == pytest.approx(expected)


@pytest.mark.parametrize(("worse", "steps"), [([], 0), ([31], 2), ([25, 33], 4), ([49], 20)])
def test_recovered_is_when_the_undisturbed_run_is_reached_for_good(worse, steps):
    own = [0.7 if step in worse else 0.9 for step in range(50)]
    assert of_symbol("disturbed", metrics(own), metrics([0.9] * 50))["recovery"] == steps


def test_goals_take_the_worst_mean_over_seeds_and_of_luxloop_alone():
    runs = pd.DataFrame(
        [("grade", 0.6, "luxloop"), ("mixed", 1.0, "luxloop"), ("mixed", 0.8, "luxloop"), ("mixed", 0.0, "open")],
        columns=["kind", "iou", "controller"],
    ).assign(part="standing", late=", 2 late", world="mixed, 2 late, seed 1", settle=3, overshoot=0.0, centroid=0.0, gap=0.0)
    found = {goal.what: goal for goal in symbol_control.goals(SYMBOLS, runs)}
    assert found["IoU on bumps, grade + cross-fall and mixed"][1:] == (pytest.approx(0.9), 0.95, True, "mixed, 2 late")
    assert found["Nowhere, at no step, below the open loop: standing"].where == "mixed, 2 late, seed 1"
    assert found["IoU on the flat road"].value is None


def place(road: str = "flat", *changes: str, steps: int = 40) -> side_by_side.World:
    return places.world(PLACES, "grade", "here", load("flat", (*TINY, f"road={{kind='{road}'}}", *changes), steps=steps))


def test_worlds_are_drawn_once_and_for_all():
    worlds, few = (list(places.places(bench.cases(places.measure, quick=quick))) for quick in (False, True))
    kinds = {each.facts["kind"] for each in worlds}
    assert len(worlds) >= 200 - PLACES.places * len(PLACES.scans) and kinds >= {"grade", "step", "roughness", "place", *PLACES.from_3_m}
    own = {each.key: each.parameters for each in worlds}
    assert len(own) == len(worlds), "results are found by key"
    assert len(few) < len(worlds) / 5 and all(own[each.key] == each.parameters for each in few)


@pytest.mark.parametrize(
    ("percent", "iou"), [(-2, 0.72), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((2, 0.90), (4, 0.85)))]
)
def test_the_bound_is_that_of_a_prototype_by_other_means(percent, iou):
    road = f"road={{kind='grade', grade_percent={percent}, crossfall_percent=0, start_x_m=3}}"
    _, found = side_by_side.bound(prepare(load("snowflake", (side_by_side.SMALL, road)), "cpu"))
    assert found["iou_bound"] == pytest.approx(iou, abs=0.006)  # printed to two digits
    assert found["visible"] == pytest.approx(iou if percent < 0 else 1.0, abs=0.006)


def test_the_bound_of_a_flat_road_is_the_open_loop():
    simulation = prepare(place().scenario, "cpu")
    lights, found = side_by_side.bound(simulation)
    open_loop = simulation.symbol.projector.light(simulation.symbol.projector.target)
    # SuperSampling Control takes the symbol at some rays a pixel and its overlap otherwise: a few of a hundred pixels at edges differ.
    assert (lights[0].u - open_loop[0].u).abs().mean() < 1e-4
    assert found["iou_bound"] > 0.97 and found["visible"] > 0.98


def test_measures_of_places_compare_with_the_same_world():
    open_loop, own = metrics([0.5] * 20), metrics([None] * 15 + [0.8] * 5, centroid=None, lost=7)
    found = {"open": open_loop, "thesis_pid": metrics([0.9] * 20), places.FEEDFORWARD: open_loop, "luxloop": own}
    *_, last = places.measures(place(), {"metrics": found, "iou_bound": 0.95, "visible": 0.9})
    expected = {"iou": 0.8, "below_open": -0.3, "below_thesis": 0.1, "found": 7, "lost": 7 / 20, "lost_later": 4, "centroid": 100.0}
    assert {name: last[name] for name in expected} == pytest.approx(expected)


GOOD = {"kind": "scan", "latency": 2, "visible": 1.0, "found": 5, "lost_later": 0, "controller": "luxloop", "iou": 0.9}
GOOD |= {"iou_open": 0.3, "iou_feedforward": 0.9, "iou_bound": 0.9, "below_open": -0.6, "below_thesis": -0.2}
FROM_3_M, ON_ROAD = {"kind": "grade from 3 m", "visible": 0.3}, {"kind": "place, grade from 3 m"}


@pytest.mark.parametrize(
    ("goal", "kept", "missed"),
    [
        (0, {}, {"iou": 0.85}),
        (1, {}, {"iou": 0.76}),
        (2, {"controller": places.FEEDFORWARD}, {"iou": 0.87}),
        (3, {}, {"below_open": 0.03}),
        (4, {}, {"below_thesis": 0.03}),
        (5, {}, {"found": 6}),
        (5, {}, {"found": None}),
        (6, {}, {"lost_later": 1}),
        (7, FROM_3_M, {"iou": 0.85}),
        (10, ON_ROAD | {"iou": 0.86, "iou_bound": 0.99}, {"iou": 0.84}),
        (10, ON_ROAD | {"iou": 0.4, "iou_bound": 0.42}, {"iou": 0.39}),
    ],
)
def test_goals_of_places_hold_where_enough_can_be_seen(goal, kept, missed):
    rows = pd.DataFrame([GOOD | kept, GOOD | kept | missed])
    assert places.goals(PLACES, rows)[goal].where == "1 of 2"
    if goal < 7:
        assert places.goals(PLACES, rows.assign(visible=0.7))[goal].value is None


@pytest.mark.slow
@pytest.mark.parametrize("study", [symbol_control, places])
def test_a_second_run_does_nothing_again(study, tmp_path, monkeypatch):
    standing = symbol_control.world(SYMBOLS, "standing", "curb", load("curb", TINY, steps=13))
    monkeypatch.setattr(symbol_control, "worlds", lambda given: iter([standing]))
    monkeypatch.setattr(places, "places", lambda given: iter([place("step", "functions.symbol.x_m=13", steps=7)]))
    arguments = ["--quick", "--jobs", "1", "--out", str(tmp_path), "--json", str(tmp_path / "rows.json")]
    monkeypatch.setattr(sys, "argv", ["study.py", *arguments])
    program = study.measure, "", "out", "jobs"
    bench.run(*program, threads=())
    kept, rows = (tmp_path / "jobs.jsonl").read_bytes(), json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert [each["controller"] for each in rows] == list(bench.cases(study.measure).controllers) and rows[0].get(
        "gap", rows[0].get("below_open")
    ) == 0
    monkeypatch.setattr(side_by_side, "prepare", None)  # a job done again would fail
    bench.run(*program, threads=())
    assert (tmp_path / "jobs.jsonl").read_bytes() == kept
    monkeypatch.setattr(side_by_side, "digests", lambda scenario: {"road.file": "of another scan"})
    with pytest.raises(SystemExit, match="failed: "):
        bench.run(*program, threads=())


@pytest.mark.slow
def test_controllers_side_by_side_run_as_each_does_alone():
    """Rendered views are shared, noise and states are not."""
    tables = {name: {"name": name} for name in ("thesis_pid", "luxloop")}
    parameters = side_by_side.World("here", {}, load("snowflake", (*TINY, "camera.latency_steps=1"), steps=5), tables).parameters
    together = side_by_side.compare(**parameters)["metrics"]
    for name, table in tables.items():
        alone = prepare(side_by_side.controlled(parameters["scenario"], table), "cpu").evaluations()
        assert together[name]["iou"] == [round(float(result.symbol.metrics.iou), 4) for result in alone]


def of_light(own: dict[str, Any], full: dict[str, float]) -> dict[str, Any]:
    """The row of a run with these values, whose objects have such scores in full light."""
    names = {"tracked": dict.fromkeys(full, 1.0), "found": dict.fromkeys(full, 2), "scores": full}
    base = {"flux_lm": [400.0] * 40 + [40.0] * 10, "eyes_lx": [None, 0.4], "newcomer_lx": [0.0] * 20, "causes": {}, "false": [False]}
    beams = {beam: [full] for beam in (object_based.LOW, object_based.FULL)}
    result = {"flux_lm": {object_based.LOW: 400.0, object_based.FULL: 6000.0}, "scores": beams}
    return next(object_based.measures({}, result | {"runs": {object_based.ALONE: [{**names, **base, **own}]}}))


DIM, UNTRACKED, UNFOUND = object_based.MISSED


@pytest.mark.parametrize(
    ("own", "full", "expected"),
    [
        ({}, {"a": 0.6}, {"saved": 0.9, "eyes_lx": 0.4, "heads": 1, "bright": 0, "kept": True, "lost": 0}),
        ({"scores": {"a": 0.56, "b": 0.25}}, {"a": 0.6, "b": 0.55}, {"kept": False, "gap": 0.3, DIM: 1, UNTRACKED: 0}),
        ({"scores": {"a": 0.56, "b": 0.25}}, {"a": 0.6, "b": 0.27}, {"kept": True, DIM: 0}),
        ({"scores": {"a": 0.56}}, {"a": 0.2}, {"kept": None, "lost": None}),
        ({"eyes_lx": [1.2, 0.3, None]}, {"a": 0.6}, {"heads": 2, "bright": 1, "eyes_lx": 1.2}),
        (
            {"tracked": {"a": 0.4, "b": 0.0}, "found": {"a": 5, "b": None}, "scores": {"a": 0.3, "b": 0.1}},
            {"a": 0.6, "b": 0.55},
            {"lost": 1, UNTRACKED: 1, UNFOUND: 1},  # what had been found is lost
        ),
    ],
)
def test_measures_of_light(own, full, expected):
    found = of_light(own, full)
    assert {name: found[name] for name in expected} == pytest.approx(expected)


LX = [0.1] * 3 + [4.0] + [9.0] * 16  # half of the light at the end is 4.5 lx
NEVER = float("inf")


@pytest.mark.parametrize(("found", "lx", "expected"), [(2, LX, 4 / 20), (6, LX, 7 / 20), (None, LX, NEVER), (2, [0.0] * 20, NEVER)])
def test_a_newcomer_is_lit_once_it_is_known_and_gets_half_of_its_light(found, lx, expected):
    """Light that is there by chance is none, nor is half of none."""
    run = {"found": {"newcomer": found and object_based.COMES + found}, "newcomer_lx": lx}
    assert object_based.newcomer_s(run) == pytest.approx(expected)


def test_switches_misses_and_ghosts_are_counted():
    one, other = torch.tensor([[0.0, 0, 10, 20]]), torch.tensor([[50.0, 0, 60, 20]])
    found = Identities()
    for boxes, numbers in ((one, [1]), (other, [1]), (one, [2]), (torch.cat([one, other]), [2, 3])):
        found.look("a", one, [True], boxes, numbers)
    assert found.counts() == {"seen": 4, "missed": 1, "false": 2, "switches": 1, "several": 1, "mota": pytest.approx(0.0)}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", CROSSINGS)
def test_nobody_changes_identity(name, seed):
    counts = follow(CROSSINGS[name], 80, seed).counts()
    assert counts["switches"] == counts["several"] == 0 < counts["seen"]
    hidden = sum(seen([road(k / RATE_HZ) for road in CROSSINGS["ten frames behind a car"]])[1][1] for k in range(55))
    assert hidden >= 10


@pytest.mark.parametrize(("population", "drives"), [("first", False), ("second", True)])
def test_scenes_are_others_than_those_of_training_and_newcomers_have_room(population, drives):
    first = object_based.FIRST[population]
    assert first > scenes.HELD_OUT + 100_000 > scenes.TRAINING
    given = validate(object_based.scene(population, 1, first, "network"), "here")
    newcomer, *others = (each.pose_track().pose_at(1.5)[:2, 3] for each in given.all_objects)
    assert len(others) > 2 and all(float((newcomer - other).norm()) > object_based.FREE_M for other in others)
    assert (given.vehicle is not None) == drives


def test_detectors_are_kinds_or_files():
    given = {each: object_based.detector(each) for each in ("hog", "half.pt", "own.onnx", "mine:Cascade")}
    assert [each["kind"] for each in given.values()] == ["hog", "network", "onnx", "mine:Cascade"]
    assert given["half.pt"]["weights"].endswith("/half.pt")


@pytest.mark.slow
def test_a_job_runs_through_the_whole_chain(monkeypatch):
    """On a few steps, which decide nothing."""
    for name, value in {"STEPS": 4, "COMES": 2, "END": range(3, 4)}.items():
        monkeypatch.setattr(object_based, name, value)
    monkeypatch.setitem(object_based.BEGINS, object_based.GLARE_FREE, 2)
    found = object_based.illuminate(object_based.scene("first", 0, 5_000_000, "network"), 1)
    runs = {name: run for name, (run,) in found["runs"].items()}
    assert [len(each["flux_lm"]) for each in runs.values()] == [4, 4, 2] and len(runs[object_based.ALONE]["newcomer_lx"]) == 2
    assert 0 < runs[object_based.ALONE]["flux_lm"][-1] < found["flux_lm"][object_based.LOW] < found["flux_lm"][object_based.FULL]
    assert sum(runs[object_based.BESIDE]["causes"].values()) > 0 and json.dumps(found)
