"""The summary of sequences whose numbers are known in closed form."""

import json
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from luxloop import load
from luxloop.loop.recording import functions_summary as of_run
from luxloop.loop.recording.manifest import table_of
from luxloop.loop.recording.remedies import remedies
from luxloop.loop.recording.summary import Circumstances, overshoot_percent, settle_step, settling_failure, steady_step, summarise
from luxloop.loop.report import run_table
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


def test_first_order_decay_settles_when_it_enters_two_percent():
    # 40 * 0.7^k <= 2 from k = ln(20) / ln(1 / 0.7) = 8.4 on; the final value is 40 * 0.7^30 = 1e-3, too little to matter
    assert steady_step(table(centroid_error_x_percent=decay(40, 0.7))) == 9
    assert overshoot_percent(table(centroid_error_x_percent=decay(40, 0.7))) == pytest.approx(0, abs=1e-3)


def test_oscillation_overshoots_by_its_damping():
    k = np.arange(80)
    # 0.8^k cos(pi k / 5): the first trough in whole steps is at k = 4 or 5, whichever is deeper
    wave = 50 * 0.8**k * np.cos(np.pi * k / 5)
    swinging = table(80, centroid_error_y_percent=wave)
    assert overshoot_percent(swinging) == pytest.approx(-100 * wave.min() / 50, abs=1e-3)
    within = [step for step in range(80) if (np.abs(wave[step:]) <= 2).all()]
    assert steady_step(swinging) == within[0]


def test_overshoot_is_the_largest_of_the_axes_that_start_far_off():
    twenty, fifty = [20.0, -4.0], [-10.0, 5.0]
    near = [4.0, -4.0]  # 100 %, of an axis that starts less than 5 % off
    for x, y, expected in ((twenty, fifty, 50), (twenty, near, 20), (near, [0.0, 0.0], None)):
        off = {f"centroid_error_{axis}_percent": np.array([*start, *[0.0] * 20]) for axis, start in (("x", x), ("y", y))}
        assert overshoot_percent(table(22, **off)) == (expected if expected is None else pytest.approx(expected))


@pytest.mark.parametrize(
    ("column", "rest", "outside"),
    [("centroid_error_x_percent", 0, 2.01), ("centroid_error_y_percent", 0, -2.01), ("length", 1, 1.021), ("shear", 0, 0.021)],
)
def test_every_quantity_has_to_stay_within_its_band(column, rest, outside):
    for value, step in ((outside, 13), (rest + 0.95 * (outside - rest), 0)):
        assert steady_step(table(**{column: np.where(np.arange(40) == 12, value, rest)})) == step


def test_never_settling_and_too_few_steps():
    assert steady_step(table(centroid_error_x_percent=10 * np.sin(np.arange(40)))) is None
    late = np.where(np.arange(40) < 31, 5.0, 0.0)  # at rest for the last nine steps only
    assert steady_step(table(centroid_error_x_percent=late)) is steady_step(table(9)) is None
    assert steady_step(table(10)) == 0


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
def test_only_a_symbol_that_is_seen_on_its_target_has_settled(recorded, why):
    assert settling_failure(recorded) == why
    assert settle_step(recorded) == (steady_step(recorded) if why is None else None)


WENT_WRONG = [
    table(9),
    *(table(loss=[reason] * 40) for reason in ("nothing", "no_frame", "covered")),
    *(table(**{OFF: off}) for off in (12.0, np.arange(40), math.nan)),
]


@pytest.mark.parametrize("controller", ["open", "thesis_pid", "feedforward", "luxloop"])
@pytest.mark.parametrize("recorded", WENT_WRONG)
def test_the_closing_table_says_what_went_wrong_and_names_keys_that_exist(recorded, controller):
    note = closing({"symbol": summarise(recorded, controller, 0.0)})["note"]
    keys = re.findall(r"\b(?:functions\.symbol|camera|disturbances)(?:\.[a-z_]+)+|\bjudge_every\b|(?<=raise )steps\b", note)
    scenario = load("snowflake", ["functions.symbol.controller={name='feedforward'}"] if controller == "feedforward" else [])
    assert keys
    for key in keys:
        found: Any = scenario
        for name in key.split("."):
            found = found[name] if isinstance(found, Mapping) else getattr(found, name)


@pytest.mark.parametrize(("road_m", "is_named"), [(-0.17, True), (0.17, True), (-0.13, False), (math.nan, False)])
def test_a_road_beyond_what_is_looked_for_is_named(road_m, is_named):
    run = Circumstances(drives=True, road_m=road_m, highest_m=0.14)
    (said,) = remedies("symbol", summarise(table(**{OFF: np.full(40, 20.0)}), "luxloop", 0.0, run=run))
    assert ("functions.symbol.controller.highest_m = 0.14" in said and "x²/(2R)" in said) == is_named
    assert (f"0.17 m {'above' if road_m > 0 else 'below'} the plane" in said) == is_named
    swing = 10 * np.sin(np.arange(40))
    there, astray = (remedies("symbol", summarise(table(**{OFF: off}), "luxloop", 0.0, run=run))[0] for off in (swing, swing + 20))
    assert "keeps moving" in there and "highest_m" not in there, "it is at the target on the mean, so the road is found"
    assert ("highest_m" in astray) == is_named


@pytest.mark.parametrize("steps", [0, 1, 40])
def test_nothing_seen_is_null_in_json(steps):
    numbers = [name for name in SYMBOL if name != "loss"]
    summary = summarise(table(steps, **dict.fromkeys(numbers, math.nan)), "open", math.nan)
    written = json.loads(json.dumps(summary, allow_nan=False))
    assert written["shown_steps"] == steps
    nothing = ("settle_step", "steady_step", "overshoot_percent", "iou_open", "iou_final", "iou_mean", "iou_second_half_min", "ssim_final")
    assert {key: written[key] for key in nothing} == dict.fromkeys(nothing)
    assert written["centroid_error_percent"] == [None, None]
