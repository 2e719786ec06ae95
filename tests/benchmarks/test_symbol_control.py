"""The table of symbol control: worlds that controllers share, measures that follow from trajectories, a page that says what was missed."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import symbol_control
import symbol_control_cases
from symbol_control_cases import controlled, trajectories, uncontrolled
from symbol_control_goals import GOALS, Goal
from symbol_control_page import goals

from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import load

TINY = ("camera={width_px=320, height_px=240}",)


def judged(iou: list[float | None], settle_step: int | None = 3, centroid: float | None = 1.0) -> dict[str, Any]:
    offsets = {"centroid_error_x_percent": [-2.0, *[centroid] * (len(iou) - 1)], "centroid_error_y_percent": [0.0] * len(iou)}
    return {"settle_step": settle_step, "overshoot_percent": None, "iou": iou, **offsets}


def measured(part: str, own: dict[str, Any], undisturbed: dict[str, Any] | None = None) -> dict[str, Any]:
    case = symbol_control_cases.Case(part, "mixed", 0, 0, load("snowflake"))
    opened = judged([0.5] * len(own["iou"]))
    reference = None if undisturbed is None else {"open": opened, "luxloop": undisturbed}
    return symbol_control.measures(case, {"open": opened, "luxloop": own}, reference)[1]


def test_the_open_loop_is_the_yardstick_after_step_ten_alone() -> None:
    iou = [0.0] * 11 + [0.9] * 8 + [0.3, 0.9]
    found = measured("standing", judged(iou))
    assert found["gap"] == pytest.approx(0.2)
    assert found["iou_least"] == 0.3
    assert measured("standing", judged([0.0] * 11 + [0.9] * 10))["gap"] == pytest.approx(-0.4)


def test_the_end_is_five_steps_and_a_drives_end_all_after_the_tenth() -> None:
    iou: list[float | None] = [0.1] * 11 + [0.4] * 5 + [0.8] * 5
    assert measured("standing", judged(iou))["iou"] == pytest.approx(0.8)
    assert measured("driving", judged(iou))["iou"] == pytest.approx(0.6)


def test_what_never_settles_counts_with_all_steps_and_darkness_as_all_of_the_symbol() -> None:
    found = measured("standing", judged([0.0] * 20, settle_step=None, centroid=None))
    assert (found["settle"], found["centroid"], found["iou"]) == (20, 100.0, 0.0)


@pytest.mark.parametrize(("worse", "steps"), [([], 0), ([31], 2), ([25, 33], 4), ([49], 20)])
def test_recovered_is_when_the_undisturbed_run_is_reached_for_good(worse: list[int], steps: int) -> None:
    own = [0.7 if step in worse else 0.9 for step in range(50)]
    assert measured("disturbed", judged(own), judged([0.9] * 50))["recovery"] == steps


def test_goals_take_the_worst_mean_over_seeds_and_of_luxloop_alone() -> None:
    def run(scene: str, seed: int, iou: float, controller: str = "luxloop") -> dict[str, Any]:
        return {"part": "standing", "scene": scene, "latency": 2, "seed": seed, "controller": controller, "iou": iou}

    rows = [run("flat", 0, 1.0), run("flat", 1, 0.8), run("curb", 0, 0.95), run("curb", 1, 0.95), run("flat", 0, 0.0, "open")]
    goal = Goal("IoU", "iou", 0.85, ("flat", "curb"), "why", least=True)
    value, where = goal.worst(rows)
    assert value == pytest.approx(0.9) and where == "flat, 2 late" and goal.reached(value)
    strict = Goal("IoU", "iou", 0.85, ("flat", "curb"), "why", least=True, each="case")
    assert strict.worst(rows) == (0.8, "flat, 2 late, seed 1") and not strict.reached(0.8)
    assert goal.worst([]) is None
    assert all(each.scenes and each.limited for each in GOALS)


def test_what_failed_or_is_not_here_is_not_passed_over() -> None:
    run = {"part": "standing", "latency": 0, "seed": 0, "controller": "luxloop", "centroid": 0.1}
    rows = [run | {"scene": scene} for scene in ("flat", "Belgian block", "curb")]
    (all_here,) = (line for line in goals(rows).splitlines() if "measured roads" in line)
    assert all_here.endswith("| reached |  |")
    (broken,) = (line for line in goals(rows, failed=["flat"]).splitlines() if "measured roads" in line)
    assert broken.endswith("| – | **missed** | failed: flat |")
    (partly,) = (line for line in goals(rows, absent=["torsion track"]).splitlines() if "measured roads" in line)
    assert partly.endswith("| reached, without torsion track |  |")


def test_a_symbol_that_is_never_seen_overshoots() -> None:
    dark = judged([0.0] * 20, settle_step=None, centroid=None) | {
        "centroid_error_x_percent": [None] * 20,
        "centroid_error_y_percent": [None] * 20,
    }
    assert measured("standing", dark)["overshoot"] == 100.0
    assert measured("standing", judged([0.9] * 20))["overshoot"] is None, "it began in its place"


@pytest.mark.slow
def test_controllers_side_by_side_run_as_each_does_alone() -> None:
    """Rendered views are shared, noise and states are not."""
    scenario = uncontrolled(load("snowflake", (*TINY, "camera.latency_steps=1"), steps=5))
    tables = {"thesis_pid": {"name": "thesis_pid"}, "luxloop": {"name": "luxloop"}}
    together = trajectories(scenario, tables)["judged"]
    for name, table in tables.items():
        alone = [float(result.symbol.verdict.iou) for result in prepare(controlled(scenario, table), "cpu").run()]
        assert together[name]["iou"] == [round(iou, 4) for iou in alone]


@pytest.mark.slow
def test_the_page_is_written_and_a_second_run_does_nothing_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def few(seeds: int, quick: bool) -> Iterator[Any]:
        assert seeds == 1 and quick
        yield symbol_control_cases.Case("standing", "curb", 0, 0, load("curb", TINY, steps=13))

    monkeypatch.setattr(symbol_control, "cases", few)
    arguments = ["--quick", "--jobs", "1", "--out", str(tmp_path / "run"), "--page", str(tmp_path), "--json", str(tmp_path / "rows.json")]
    monkeypatch.setattr(sys, "argv", ["symbol_control.py", *arguments])
    symbol_control.main()
    kept = (tmp_path / "run" / "jobs.jsonl").read_bytes()
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert [row["controller"] for row in rows] == list(symbol_control_cases.CONTROLLERS)
    opened = rows[0]
    assert opened["gap"] == 0 and opened["settle"] == 0, "the open loop never moves"
    page = (tmp_path / "symbol_control.md").read_text("utf-8")
    assert f"| curb | {opened['iou']:.2f} |" in page
    assert "| Mean IoU at least 0.92 at 5 m/s | – | not measured |  |" in page
    assert (tmp_path / "images" / "symbol-control.png").stat().st_size > 10_000
    monkeypatch.setattr(symbol_control_cases, "prepare", None)  # a job done again would fail
    symbol_control.main()
    assert (tmp_path / "run" / "jobs.jsonl").read_bytes() == kept
    monkeypatch.setattr(symbol_control, "digests", lambda scenario: {"road.file": "of another scan"})
    with pytest.raises(SystemExit, match="failed: curb"):  # so it is done again
        symbol_control.main()
