"""Checks: what they take of a recording, what bounds hold, what they compare with, and which are refused."""

import json
import tomllib
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from luxloop import Simulation, load, load_lamp, run, validate
from luxloop.loop.recording.checks import Checks, lines, outcome, ratio
from luxloop.loop.recording.manifest import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.run import check
from luxloop.loop.scenario.checks import CheckParams
from luxloop.loop.scenario.shipped import scenario_files
from luxloop.world.regulation import check_beam
from tests.loop.conftest import SMALL, toml
from tests.refusal import sentence

LIT: dict[str, Any] = tomllib.loads("""
name = "lit"
steps = 3
renderer = "raycast"
headlight.model = "ssl-hd-lores"
camera = { width_px = 320, height_px = 180, pitch_deg = 1.5 }
lighting.base.beam = "high"
functions.guard.kind = "glare_free"
[[objects]]
kind = "box"
name = "car"
category = "car"
size_m = [4.4, 1.8, 1.5]
track = [{ position_m = [30, 0, 0] }]
[[objects]]
kind = "box"
name = "walker"
category = "pedestrian"
size_m = [0.4, 0.5, 1.75]
track = [{ position_m = [15, 1.5, 0] }]
""")
IOU = "functions.symbol.iou"
FLUX = toml("{ metric = 'lamp.left.flux_lm', at_most = 0.7, compare = 'full_light' }")


def with_checks(kind: dict[str, Any], **checks: dict[str, Any]) -> dict[str, Any]:
    return {**kind, "checks": checks}


def of(values: list[float | None], others: list[float | None] | None = None, **check: Any) -> dict[str, Any]:
    """The outcome of a check of the IoU, of a run at 10 Hz with these values of it, and of the open loop beside it with the others."""
    columns = {"time_s": [k / 10 for k in range(len(values))], IOU: values}
    table = pa.table(columns, pa.schema([pa.field(name, pa.float64(), metadata={"unit": "1"}) for name in columns]))
    if others is None:
        return outcome(CheckParams(metric=IOU, **check), table, {})
    return outcome(CheckParams(metric=IOU, compare="open_loop", **check), table, {"open_loop": [{IOU: other} for other in others]})


def said(got: dict[str, Any]) -> str:
    return lines({"checks": {"it": got}})["check it"]


@pytest.mark.parametrize(
    ("check", "value"),
    [
        ({}, 0.5),
        ({"take": "min"}, 0.2),
        ({"take": "max"}, 0.9),
        ({"take": "last"}, 0.4),
        ({"take": "p50"}, 0.4),  # the least of which half of the steps have no more
        ({"take": "p99"}, 0.9),
        ({"absolute": True, "take": "max"}, 0.9),
        ({"over_s": 0.2, "take": "max"}, 0.65),  # of the last two with a value: 0.9 and 0.4
        ({"from_s": 0.3}, 0.4),
        ({"until_s": 0.2}, 0.55),
        ({"from_s": 0.2, "until_s": 0.2}, 0.9),  # a window of one step; its ends belong to it
        ({"until_s": 0.2, "take": "last"}, 0.9),
        ({"from_s": 0.1, "until_s": 0.1}, None),  # a step without a value
        ({"from_s": 7.0}, None),
    ],
    ids=str,
)
def test_a_value_is_taken_of_the_steps_in_the_window_that_have_one(check, value):
    got = of([0.2, None, 0.9, None, 0.4], at_least=0.3, **check)
    assert got["value"] == (value if value is None else pytest.approx(value))
    assert got["passed"] is (value is not None and value >= 0.3)
    if value is None:
        why = "begins at 7 s, the run ends at 0.4 s (raise steps)"
        if check["from_s"] < 7:
            why = "has values from 0 to 0.4 s only; choose from_s and until_s to include some"
        assert said(got).endswith(f"{IOU}, at least 0.3, {why}: failed")


@pytest.mark.parametrize(
    ("bounds", "holds"), [({"at_least": 0.5}, True), ({"at_most": 0.4}, False), ({"at_least": 0.1, "at_most": 0.5}, True)]
)
def test_bounds_hold_the_value_themselves_included(bounds, holds):
    got = of([0.5], **bounds)
    assert got["passed"] is holds
    assert said(got).startswith(f"mean {IOU} 0.5, ") and said(got).endswith("passed" if holds else "failed")


def test_amounts_of_signed_values_are_bounded():
    got = of([-0.4, 0.1], [0.2, -0.1], take="max", absolute=True, at_most=2.5)
    assert (got["value"], got["compared_value"], got["ratio"]) == (0.4, 0.2, 2.0)
    assert said(got).startswith(f"max |{IOU}| 0.4, ")


def test_a_difference_is_taken_step_by_step():
    runs, least = ([0.5, 0.9, 0.6, 0.7], [0.6, 0.5, 0.7, 0.6]), {"by": "difference", "take": "min"}
    worst, over = of(*runs, **least, at_least=-0.2), of(*runs, **least, over_s=0.2, at_least=0.1)
    assert worst["difference"] == pytest.approx(-0.1) and worst["passed"] and worst["ratio"] is worst["recall"] is None
    assert over["difference"] == pytest.approx(0.2 / 3) and not over["passed"], "of the first three: -0.1, 0.4 and -0.1"
    assert of([0.5, 0.6], [0.5, 0.6], by="difference", over_s=5.0, at_least=0.0)["difference"] is None, "no window is as long"
    assert "min -0.1 relative to open loop" in said(worst)


def test_recall_is_the_share_of_what_the_other_light_finds():
    got = of([0.0, 0.3, None, 0.9, 0.8], [0.9, 0.2, 0.5, None, 0.0], by="recall", at_least=0.5)
    assert got["recall"] == pytest.approx(1 / 3) and not got["passed"], "one of three that the other finds; out of sight is not found"
    assert said(got).endswith("in 33.33 % of the steps in which it is above 0 with open loop, at least 50 %: failed")
    assert of([0.5], [0.0], by="recall", at_least=0.5)["passed"] is False, "nothing was there to find"


def test_a_ratio_has_an_answer_where_there_is_nothing_to_divide_by():
    assert ratio(1.0, 4.0) == 0.25
    assert ratio(0.0, 0.0) == 1.0  # alike
    assert (ratio(2.0, 0.0), ratio(-2.0, 0.0)) == (np.inf, -np.inf)
    assert ratio(None, 1.0) is ratio(1.0, None) is None


# what is wrong: the check, what the sentence must name
REFUSED: dict[str, tuple[dict[str, Any], dict[str, Any], str, str]] = {
    "no bound": (SMALL, {"metric": IOU}, "checks.it: ", "at_least, at_most"),
    "window exchanged": (
        SMALL,
        toml("{ metric = 'functions.symbol.iou', at_least = 0.0, from_s = 2.0, until_s = 1.0 }"),
        "checks.it: ",
        "until_s: 1 is below from_s = 2",
    ),
    "unknown column": (SMALL, {"metric": "functions.symbol.iuo", "at_least": 0.0}, "checks.it.metric: ", f"'{IOU}'"),
    "a symbol in full light": (SMALL, {"metric": IOU, "at_least": 0.0, "compare": "full_light"}, "checks.it.metric: ", "leave compare out"),
    "no symbol": (LIT, FLUX | {"compare": "open_loop"}, "checks.it.compare: ", "full_light or low_beam"),
    "unknown object": (LIT, {"metric": "objects.walkr.lx_max", "at_most": 1.0}, "checks.it.metric: ", "'objects.walker.lx_max'"),
    "unknown rule": (LIT, {"metric": "rules.r149-pasing-c", "at_most": 0}, "checks.it.metric: ", "'rules.r149-passing-c'"),
    "no detector": (LIT, {"metric": "oncoming_lx_max", "at_most": 1.0}, "checks.it.metric: ", "[detector]"),
}


@pytest.mark.parametrize("wrong", REFUSED)
def test_a_check_that_makes_no_sense_is_refused_before_the_run(wrong):
    kind, given, key, remedy = REFUSED[wrong]
    with sentence(f"here: {key}", remedy):
        check(validate(with_checks(kind, it=given), "here"), "cpu")


def test_open_loop_beside_is_the_run_that_it_would_be_alone():
    gain = {"metric": IOU, "take": "last", "at_least": 1.0, "compare": "open_loop"}
    scenario = validate(with_checks(SMALL, gain=gain) | {"steps": 3}, "x")
    simulation = Simulation.prepare(scenario)
    checks = Checks(simulation.scenario.checks, lambda light: map(row, simulation.lit_by(light).evaluations()))
    rows = []
    for result in simulation.evaluations():
        rows.append(row(result))
        checks.step(result)
    table = table_of(rows, schema(simulation))
    opened = {"symbol": SMALL["functions"]["symbol"] | {"controller": {"name": "open"}}}
    alone = Simulation.prepare(validate(SMALL | {"steps": 3, "functions": opened}, "open"))
    *_, last = (row(result) for result in alone.evaluations())
    got = checks.outcomes(table)["gain"]
    assert got["compared_value"] == last[IOU]  # the same bits: world and noise are the same
    assert got["value"] == table[IOU][-1].as_py() and got["ratio"] == got["value"] / last[IOU]


def test_a_run_is_compared_with_full_light_in_the_same_world(tmp_path):
    checked = {"flux": FLUX, "car": toml("{ metric = 'objects.car.lx_max', take = 'max', at_most = 0.5, compare = 'full_light' }")}
    dark = toml("{ dark = { metric = 'dark_lx_max', take = 'max', at_most = 0.3 } }")
    scenario = validate(with_checks(LIT, **checked, **dark), "lit")
    summary = run(scenario, tmp_path, device="cpu", video=False, report=False, checks=True).summary
    full = validate(LIT | toml("{ lighting.base.beam = 'full', functions = {} }"), "full")
    alone = run(full, device="cpu", video=False, report=False)
    flux, car = summary["checks"]["flux"], summary["checks"]["car"]
    assert flux["compared_value"] == alone.summary["lamps"]["left"]["flux_lm_mean"]
    assert flux["value"] == summary["lamps"]["left"]["flux_lm_mean"] and flux["ratio"] < 1
    assert car["compared_value"] == alone.summary["objects"]["car"]["lx_max"] and car["passed"]
    assert json.loads((tmp_path / "summary.json").read_text())["checks"] == summary["checks"]
    assert list(run(scenario, tmp_path, device="cpu", video=False, report=False).summary["checks"]) == ["dark"]


@pytest.mark.parametrize("level_deg", [0.0, 1.5])
def test_a_rule_judges_the_base_beam_as_the_lamps_are_mounted(level_deg):
    legal = {"metric": "rules.r149-passing-c", "take": "max", "at_most": 0}
    lighting = {"lighting": {"base": {"beam": "low"}}, "headlight": LIT["headlight"] | {"level_deg": level_deg}}
    scenario = validate(with_checks(LIT, low=legal) | lighting, "here")
    got = run(scenario, device="cpu", video=False, report=False).summary["checks"]["low"]
    lamp = load_lamp("ssl-hd-lores")
    results = check_beam(lamp.lit(lamp.beam("low")), "r149-passing-c", aim=(0.0, -level_deg))
    assert got["value"] == sum(each.verdict == "fail" for each in results)
    assert got["passed"] is (level_deg == 0)
    assert got["reasons"] == [str(each) for each in results if each.verdict == "fail"]
    assert all(reason in said(got) for reason in got["reasons"][:3]) and (level_deg == 0 or " cd, at least " in said(got))


# what never existed: columns, and the cause and remedy that the check names
NEVER = {
    "dark_lx_max": ("no object that must be dark was in view", "glare_free"),
    "objects.behind.lx_max": ("the camera never saw the object", "objects.behind.track"),
    "functions.late.iou": ("the symbol was never shown", "functions.late.when, unless, start_s"),
    "probes.rider.lx": ("never existed", "appears_s"),
}


def test_a_check_without_a_value_names_what_never_existed_and_the_remedy():
    behind = {"kind": "box", "category": "car", "size_m": [4.4, 1.8, 1.5], "track": [{"position_m": [-30, 0, 0]}]}
    scenario = LIT | {
        "steps": 1,
        "lighting": {"base": {"beam": "off"}},
        "objects": [{**behind, "name": "behind"}, {**behind, "name": "later", "appears_s": 9}],
        "functions": {"late": SMALL["functions"]["symbol"] | {"start_s": 9.0}},
        "probes": {"rider": {"position_m": [0, 0, 1], "frame": "later"}},
    }
    wanted = {f"it_{n}": {"metric": metric, "at_least": 1.0} for n, metric in enumerate(NEVER)}
    wanted["legal"] = {"metric": "rules.r149-passing-c", "at_most": 0}
    summary = run(validate(with_checks(scenario, **wanted), "here"), device="cpu", video=False, report=False).summary
    for line, words in zip(lines(summary).values(), NEVER.values(), strict=False):
        assert line.endswith("failed") and all(word in line for word in words), line
    assert "the base beam is off; set lighting.base.beam" in lines(summary)["check legal"]


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in scenario_files() if load(name).checks])
def test_shipped_scenarios_pass_their_checks(name):
    summary = run(name, device="cpu", video=False, report=False, checks=True).summary
    failed = {key: line for key, line in lines(summary).items() if not line.endswith("passed")}
    assert not failed
