"""The summary of sequences whose numbers are known in closed form."""

import json
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from luxloop.loop.recording import functions_summary as of_run
from luxloop.loop.recording.files import table_of
from luxloop.loop.recording.remedies import remedies
from luxloop.loop.recording.summary import Circumstances, overshoot_percent, settle_step, steady_step, summarise, unsettled
from luxloop.loop.report import run_table
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.columns import SYMBOL

SCHEMA = pa.schema([("step", pa.int64()), *((name, pa.string() if name == "loss" else pa.float64()) for name in SYMBOL)])


def table(steps: int = 40, loss: list[str] | None = None, **columns: Any) -> pa.Table:
    """One symbol's columns of a recording; it is at rest but for those given (numbers or arrays)."""
    columns = {"length": 1.0, "aim_x_m": math.nan, "aim_y_m": math.nan, **columns}
    values = {name: np.broadcast_to(columns.get(name, 0.0), steps).tolist() for name in SYMBOL}
    values |= {"step": list(range(steps)), "loss": loss or [""] * steps}
    return table_of([{name: values[name][k] for name in values} for k in range(steps)], SCHEMA)


def decay(start: float, ratio: float, steps: int = 40) -> np.ndarray:
    return start * ratio ** np.arange(steps)


def test_first_order_decay_settles_when_it_enters_two_percent() -> None:
    # 40 * 0.7^k <= 2 from k = ln(20) / ln(1 / 0.7) = 8.4 on; the final value is 40 * 0.7^30 = 1e-3, too little to matter
    assert steady_step(table(centroid_error_x_percent=decay(40, 0.7))) == 9
    assert overshoot_percent(table(centroid_error_x_percent=decay(40, 0.7))) == pytest.approx(0, abs=1e-3)


def test_oscillation_overshoots_by_its_damping() -> None:
    k = np.arange(80)
    # 0.8^k cos(pi k / 5): the first trough in whole steps is at k = 4 or 5, whichever is deeper
    wave = 50 * 0.8**k * np.cos(np.pi * k / 5)
    swinging = table(80, centroid_error_y_percent=wave)
    assert overshoot_percent(swinging) == pytest.approx(-100 * wave.min() / 50, abs=1e-3)
    within = [step for step in range(80) if (np.abs(wave[step:]) <= 2).all()]
    assert steady_step(swinging) == within[0]


def test_overshoot_is_the_largest_of_the_axes_that_start_far_off() -> None:
    x = np.array([20.0, -4.0, *[0.0] * 20])  # 20 %
    y = np.array([-10.0, 5.0, *[0.0] * 20])  # 50 %
    near = np.array([4.0, -4.0, *[0.0] * 20])  # 100 %, of an axis that starts less than 5 % off
    assert overshoot_percent(table(22, centroid_error_x_percent=x, centroid_error_y_percent=y)) == pytest.approx(50)
    assert overshoot_percent(table(22, centroid_error_x_percent=x, centroid_error_y_percent=near)) == pytest.approx(20)
    assert overshoot_percent(table(22, centroid_error_x_percent=near)) is None


def test_overshoot_is_measured_from_the_final_value() -> None:
    x = np.array([20.0, 8.0, *[10.0] * 20])
    assert overshoot_percent(table(22, centroid_error_x_percent=x)) == pytest.approx(100 * 2 / 20)


def test_a_step_settles_at_once() -> None:
    assert steady_step(table(centroid_error_x_percent=np.where(np.arange(40) < 7, 30.0, 1.0))) == 7
    assert steady_step(table()) == 0


@pytest.mark.parametrize(
    ("column", "rest", "outside"),
    [("centroid_error_x_percent", 0, 2.01), ("centroid_error_y_percent", 0, -2.01), ("length", 1, 1.021), ("shear", 0, 0.021)],
)
def test_every_quantity_has_to_stay_within_its_band(column: str, rest: float, outside: float) -> None:
    values = np.where(np.arange(40) == 12, outside, rest)
    assert steady_step(table(**{column: values})) == 13
    inside = np.where(np.arange(40) == 12, rest + 0.95 * (outside - rest), rest)
    assert steady_step(table(**{column: inside})) == 0


def test_never_settling() -> None:
    assert steady_step(table(centroid_error_x_percent=10 * np.sin(np.arange(40)))) is None
    late = np.where(np.arange(40) < 31, 5.0, 0.0)  # at rest for the last nine steps only
    assert steady_step(table(centroid_error_x_percent=late)) is None


def test_ten_steps_are_needed() -> None:
    assert steady_step(table(9)) is None
    assert steady_step(table(10)) == 0


def test_what_is_not_lit_is_not_settled() -> None:
    dark = np.where(np.arange(40) == 20, np.nan, 0.0)
    assert steady_step(table(centroid_error_x_percent=dark)) == 21
    dark_at_the_end = np.where(np.arange(40) == 39, np.nan, 0.0)
    assert steady_step(table(centroid_error_x_percent=dark_at_the_end)) is None


def closing(symbols: dict[str, dict[str, Any]]) -> dict[str, str]:
    """Rows of the closing table of a run of these symbols."""
    run = of_run.summarise(pa.table({"time_s": [0.0], "processing_ms": [1.0], "dark_lx_max": [math.nan]}), "name", {}, symbols)
    shown = run_table.summary_table(run | {"shadow_of": None, "idle_functions": [], "checks": {}}, "runs/name")
    names, cells = ([str(cell) for cell in column.cells] for column in shown.columns)
    return {name.removeprefix("[bold]").removesuffix("[/]"): cell for name, cell in zip(names, cells, strict=True)}


HALF_LOST = [""] * 30 + ["too_small", ""] * 5
LATE_FRAMES = ["no_frame"] * 3 + [""] * 7
OFF = "centroid_error_y_percent"


@pytest.mark.parametrize(
    ("recorded", "why"),
    [
        (table(), None),
        (table(9), "too_short"),
        (table(loss=HALF_LOST), None),
        (table(loss=[*HALF_LOST[:-1], "nothing"]), "lost"),
        (table(loss=[""] * 34 + ["no_frame"] * 6), "no_frame"),
        (table(loss=[""] * 34 + ["covered"] * 6), "covered"),
        (table(loss=[""] * 34 + ["covered"] * 5 + ["nothing"]), "lost"),
        (table(10, loss=LATE_FRAMES), None),
        (table(**{OFF: decay(40, 0.7) + 4.9}), None),
        (table(**{OFF: decay(40, 0.7) - 5.1}), "off_target"),
        (table(**{OFF: math.nan}), "off_target"),
        (table(**{OFF: 10 * np.sin(np.arange(40))}), "moving"),
    ],
)
def test_only_a_symbol_that_is_seen_on_its_target_has_settled(recorded: pa.Table, why: str | None) -> None:
    assert unsettled(recorded) == why
    assert settle_step(recorded) == (steady_step(recorded) if why is None else None)


def test_a_lost_symbol_is_steady_but_has_not_settled() -> None:
    summary = summarise(table(loss=["too_small"] * 40, iou=0.0), "luxloop", 0.0)
    assert (summary["settle_step"], summary["unsettled"], summary["steady_step"]) == (None, "lost", 0)


@pytest.mark.parametrize("controller", ["open", "thesis_pid", "feedforward", "luxloop"])
@pytest.mark.parametrize(
    "recorded",
    [
        table(9),
        table(loss=["nothing"] * 40),
        table(loss=["no_frame"] * 40),
        table(loss=["covered"] * 40),
        table(**{OFF: 12.0}),
        table(**{OFF: np.arange(40)}),
        table(**{OFF: math.nan}),
    ],
)
def test_the_closing_table_says_what_went_wrong_and_names_keys_that_exist(recorded: pa.Table, controller: str) -> None:
    note = closing({"symbol": summarise(recorded, controller, 0.0)})["note"]
    keys = re.findall(r"\b(?:functions\.symbol|camera|disturbances)(?:\.[a-z_]+)+|\bjudge_every\b|(?<=raise )steps\b", note)
    scenario = load("snowflake", ["functions.symbol.controller={name='feedforward'}"] if controller == "feedforward" else [])
    assert keys
    for key in keys:
        found: Any = scenario
        for name in key.split("."):
            found = found[name] if isinstance(found, Mapping) else getattr(found, name)


@pytest.mark.parametrize(
    ("shares", "said"),
    [
        ({"bottom": 0.019}, []),
        ({"bottom": 0.3, "left": 0.1}, ["40 % of the symbol lies beyond the lower border of the lamps' field; raise functions.symbol.x_m"]),
        ({"left": 0.03}, ["3 % of the symbol lies beyond the left border of the lamps' field; bring functions.symbol.y_m nearer to 0"]),
    ],
)
def test_what_is_cut_at_the_border_of_the_field_is_said_even_of_a_settled_symbol(shares: dict[str, float], said: list[str]) -> None:
    recorded = table(**{f"cut_{side}": np.where(np.arange(40) < 39, 0.0, share) for side, share in shares.items()})
    values = summarise(recorded, "luxloop", 0.0)
    assert values["cut"] == pytest.approx(sum(shares.values())) and values["cut_side"] == max(shares, key=shares.__getitem__)
    assert remedies("symbol", values) == said


def test_a_symbol_that_was_aimed_elsewhere_is_off_its_target_for_no_other_reason() -> None:
    values = summarise(table(**{OFF: math.nan}, aim_x_m=28.31, aim_y_m=0.0), "luxloop", 0.0)
    assert values["aim"] == [28.31, 0.0] and values["unsettled"] == "off_target"
    (said,) = remedies("symbol", values)
    assert "28.3 m ahead" in said


@pytest.mark.parametrize("course", [{"loss": ["nothing"] * 40}, {OFF: 20 + 10 * np.sin(np.arange(40))}])
def test_a_symbol_that_is_cut_is_lost_or_moves_astray_for_no_other_reason(course: dict[str, Any]) -> None:
    values = summarise(table(**course, cut_bottom=0.9), "luxloop", 0.0)
    assert len(remedies("symbol", values)) == 1 and "lower border" in remedies("symbol", values)[0]


def test_how_far_the_road_lies_off_the_plane_is_said_where_it_is_drawn_for() -> None:
    (said,) = remedies("symbol", summarise(table(**{OFF: 12.0}, z_m=-0.57), "luxloop", 0.0))
    assert said.startswith(
        "the symbol lies 12 % of its size off its target, drawn for a road 0.6 m below the plane of the ground; lower functions.symbol.x_m"
    )


@pytest.mark.parametrize(
    ("controller", "key"),
    [
        ("thesis_pid", "functions.symbol.start.x_m"),
        ("open", "functions.symbol.controller.name"),
        ("feedforward", "functions.symbol.controller.road"),
        ("luxloop", "functions.symbol.x_m"),
    ],
)
def test_a_symbol_that_was_never_seen_starts_too_far_only_where_a_controller_moves_it(controller: str, key: str) -> None:
    (said,) = remedies("symbol", summarise(table(loss=["nothing"] * 40), controller, 0.0))
    assert said.startswith("the camera never saw the symbol") and key in said
    assert ("functions.symbol.start.x_m" in said) == (controller == "thesis_pid")


def test_a_symbol_that_was_lost_is_counted() -> None:
    (lost,) = remedies("symbol", summarise(table(loss=[""] * 20 + ["nothing"] * 20), "luxloop", 0.0))
    assert lost.startswith("the camera lost the symbol in 20 of 40 steps")


def test_a_symbol_that_swings_on_needs_more_steps_only_in_a_short_run() -> None:
    short, long = (table(steps, **{OFF: 10 * np.sin(np.arange(steps))}) for steps in (30, 40))
    assert "raise steps" in remedies("symbol", summarise(short, "thesis_pid", 0.0))[0]
    assert 'functions.symbol.controller.name = "luxloop"' in remedies("symbol", summarise(long, "thesis_pid", 0.0))[0]


def test_a_car_that_drives_has_no_overshoot() -> None:
    swings = table(30, **{OFF: 10 * np.cos(np.arange(30))})
    still, drives = (summarise(swings, "luxloop", 0.0, run=Circumstances(drives=each)) for each in (False, True))
    assert still["overshoot_percent"] > 50 and drives["overshoot_percent"] is None


def test_a_car_that_drives_is_not_asked_for_more_steps() -> None:
    swings = table(30, **{OFF: 10 * np.sin(np.arange(30))})
    for controller, key in (("luxloop", "functions.symbol.x_m"), ("thesis_pid", "functions.symbol.controller.name")):
        (said,) = remedies("symbol", summarise(swings, controller, 0.0, run=Circumstances(drives=True)))
        assert "while the car drives" in said and "steps to" not in said and key in said


@pytest.mark.parametrize(("road_m", "is_named"), [(-0.17, True), (0.17, True), (-0.13, False), (math.nan, False)])
def test_a_road_beyond_what_is_looked_for_is_named(road_m: float, is_named: bool) -> None:
    run = Circumstances(drives=True, road_m=road_m, highest_m=0.14)
    (said,) = remedies("symbol", summarise(table(**{OFF: np.full(40, 20.0)}), "luxloop", 0.0, run=run))
    assert ("functions.symbol.controller.highest_m = 0.14" in said and "x²/(2R)" in said) == is_named
    assert (f"0.17 m {'above' if road_m > 0 else 'below'} the plane" in said) == is_named
    swing = 10 * np.sin(np.arange(40))
    there, astray = (remedies("symbol", summarise(table(**{OFF: off}), "luxloop", 0.0, run=run))[0] for off in (swing, swing + 20))
    assert "keeps moving" in there and "highest_m" not in there, "it is at the target on the mean, so the road is found"
    assert ("highest_m" in astray) == is_named


@pytest.mark.parametrize(
    ("recorded", "judge_every", "why"),
    [
        (table(iou=math.nan), 0, "not judged, because judge_every = 0"),
        (table(iou=math.nan), None, "not judged, because the plant does not know the truth"),
        (table(0), 1, "never shown"),
    ],
)
def test_the_closing_table_says_why_nobody_judged_in_place_of_dashes(recorded: pa.Table, judge_every: int | None, why: str) -> None:
    rows = closing({"symbol": summarise(recorded, "open", math.nan, run=Circumstances(judge_every))})
    assert rows["symbol: result"] == why
    assert not [row for name, row in rows.items() if name.startswith("symbol: ") and "–" in row]
    assert ("judge_every" in rows["note"]) == (judge_every == 0)


def test_the_open_loop_is_told_for_the_last_step() -> None:
    rows = closing({"symbol": summarise(table(iou=0.9), "luxloop", 0.4)})
    assert rows["symbol: IoU"].startswith("0.900 at the last step, 0.400 without control (open loop) at the last step; 0.900 on average")


def test_notes_name_the_symbol_where_there_are_several() -> None:
    lost = summarise(table(loss=["nothing"] * 40), "luxloop", 0.0)
    lies = summarise(table(iou=1.0), "luxloop", 0.0)
    note = closing({"symbol": lost})["note"]
    assert note.startswith("the camera never saw the symbol")
    assert closing({"left_flake": lost, "right": lies})["note"] == f"left flake: {note.replace('.symbol.', '.left_flake.')}"


def test_summary_has_every_field() -> None:
    k = np.arange(40)
    recorded = table(
        loss=["no_frame", *[""] * 38, "too_small"],
        centroid_error_x_percent=k - 37.0,
        iou=k / 40,
        ssim=k / 80,
    )
    assert summarise(recorded, "thesis_pid", 0.25) == {
        "controller": "thesis_pid",
        "shown_steps": 40,
        "seen_steps": 38,
        "lost_steps": 1,  # frames came in the last one
        "covered_steps": 0,
        "covered_by": [],
        "settle_step": None,
        "unsettled": "moving",
        "steady_step": None,
        "overshoot_percent": pytest.approx(100 * 4.5 / 37),  # the final value, -2.5, is passed by the last step's 2
        "centroid_error_percent": [0.0, 0.0],
        "cut": 0.0,
        "cut_side": None,
        "aim": None,
        "iou_open": 0.25,
        "iou_final": 39 / 40,
        "iou_mean": pytest.approx(29.5 / 40),  # steps 20 to 39
        "iou_min": 20 / 40,
        "z_m_final": 0.0,
        "ssim_final": 39 / 80,
        "judge_every": 1,
        "drives": False,
        "road_m": None,
        "highest_m": None,
    }


@pytest.mark.parametrize("steps", [0, 1, 40])
def test_nothing_seen_is_null_in_json(steps: int) -> None:
    numbers = [name for name in SYMBOL if name != "loss"]
    summary = summarise(table(steps, **dict.fromkeys(numbers, math.nan)), "open", math.nan)
    written = json.loads(json.dumps(summary, allow_nan=False))
    assert written["shown_steps"] == steps
    nothing = ("settle_step", "steady_step", "overshoot_percent", "iou_open", "iou_final", "iou_mean", "iou_min", "ssim_final", "z_m_final")
    assert {key: written[key] for key in nothing} == dict.fromkeys(nothing)
    assert written["centroid_error_percent"] == [None, None]
