"""Replays: the same run again agrees, a changed one is told by column, step and size, and a damaged recording by a sentence."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from luxloop import Simulation
from luxloop.controllers.symbol.sensing.symbol_sensor import FeatureParams
from luxloop.loop.recording.comparison import SHARE, differences, tolerances
from luxloop.loop.recording.manifest import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.recording.recorder import Recorder
from luxloop.loop.recording.replay import compare, load, replay, to_csv
from luxloop.loop.recording.summary import steady_step
from luxloop.loop.simulation.columns import SYMBOL, of_one
from luxloop.loop.simulation.result import StepResult
from luxloop.world.arrays import read_parquet
from tests.refusal import refusal, sentence

HELD = {"symbol": FeatureParams()}
RAW = tolerances(FeatureParams())


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, small_simulation: Simulation, small_results: list[StepResult]) -> Path:
    directory = tmp_path_factory.mktemp("recorded")
    with Recorder(directory, small_simulation) as recording:
        for result in small_results:
            recording.add(result)
    return directory


@pytest.fixture
def recording(recorded: Path, tmp_path: Path) -> Path:
    """A copy of the recording, to be damaged."""
    return Path(shutil.copytree(recorded, tmp_path / "recording"))


@pytest.fixture(scope="module")
def table(small_simulation: Simulation, small_results: list[StepResult]) -> pa.Table:
    return table_of([row(result) for result in small_results], schema(small_simulation))


def edit(file: Path, **changes: Any) -> None:
    file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))


def changed(table: pa.Table, name: str, values: Any) -> pa.Table:
    field = table.schema.field(name)
    return table.set_column(table.column_names.index(name), field, pa.array(values, field.type, from_pandas=True))


def of_symbol(name: str) -> str:
    """A column of the recording's symbol."""
    return f"functions.symbol.{name}"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["driving", "obl"])
def test_a_replay_with_two_threads_is_within_the_tolerances(name, tmp_path):
    """What docs/recordings.md says of the two scenarios whose bits depend on threads."""
    for threads, command in (("1", ["run", name, "--steps", "2", "--no-video", "--out", str(tmp_path)]), ("2", ["replay", str(tmp_path)])):
        environment = {**os.environ, "OMP_NUM_THREADS": threads}
        done = subprocess.run(
            [sys.executable, "-m", "luxloop.loop.commands.cli", *command], env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout + done.stderr


def test_replay_of_an_untouched_recording_agrees(recorded, small_results):
    steps = []
    comparison = replay(recorded, on_step=lambda result: steps.append(result.step))
    assert comparison.agrees and comparison.differences == comparison.notes == ()
    assert comparison.steps == len(small_results) and steps == list(range(len(small_results)))


def test_recordings_are_compared_without_running(recorded, recording, table):
    assert compare(str(recorded), recording).agrees
    name = of_symbol("y_m")
    pq.write_table(changed(table, name, table[name].to_numpy() + 0.01), recording / "trajectory.parquet")
    manifest = json.loads((recording / "manifest.json").read_text())
    edit(recording / "manifest.json", device="cuda", scenario=manifest["scenario"] | {"seed": 7})
    comparison = compare(recorded, recording)
    assert name in {each.column for each in comparison.differences} and any("cuda" in note for note in comparison.notes)
    assert f"{recording} has seed=7" in comparison.notes[0]
    pq.write_table(table.drop_columns([name]), recording / "trajectory.parquet")
    with sentence(str(recording), name, str(recorded)):  # the remedy names the other one
        compare(recording, recorded)


def test_replay_tells_what_differs_from_where_and_by_how_much(recording, table):
    name = of_symbol("y_m")
    y = table[name].to_numpy().copy()
    y[4:] += 0.01
    y[6] += 0.1
    pq.write_table(changed(table, name, y), recording / "trajectory.parquet")
    comparison = replay(recording)
    (difference,) = comparison.differences
    assert not comparison.agrees
    assert (difference.column, difference.first_step, difference.largest_step, difference.tolerance) == (name, 4, 6, 0.001)
    assert (difference.recorded - difference.replayed, difference.largest) == pytest.approx((0.01, 0.11))


def test_replay_follows_the_manifest_and_says_what_is_not_as_it_was(recording):
    manifest = json.loads((recording / "manifest.json").read_text())
    manifest["inputs"]["functions.symbol.image snowflake.png"]["sha256"] = "0" * 64
    manifest["versions"]["numpy"] = "1.0"
    manifest["scenario"]["seed"] = 5
    edit(recording / "manifest.json", **{**manifest, "renderer": "brush"})
    comparison = replay(recording)
    assert {of_symbol("c_u"), of_symbol("x_m")} <= {difference.column for difference in comparison.differences}
    words = (
        "the scenario in the manifest was edited",
        "functions.symbol.image snowflake.png: .*snowflake.png has changed",
        "renderer: recorded with brush, replayed with ",
        "numpy: recorded with version 1.0, replayed with ",
    )
    assert all(map(re.match, words, comparison.notes)) and len(comparison.notes) == len(words), comparison.notes


def test_interrupted_recording_is_replayed_as_far_as_it_goes(recording, table):
    pq.write_table(table.slice(0, 5), recording / "trajectory.parquet")
    edit(recording / "manifest.json", status="running")
    (recording / "summary.json").unlink()
    comparison = replay(recording)
    assert comparison.agrees and comparison.steps == 5


@pytest.mark.parametrize("name", ["time_s", "lamp.left.flux_lm", *(of_symbol(name) for name in SYMBOL if name != "loss")])
def test_every_column_is_held_at_its_tolerance(table, name):
    # a tenth of the tolerance is far above rounding
    values = np.nan_to_num(table[name].to_numpy())  # of an ordinary symbol there is no aim
    tolerance = SHARE * values.max() if name.startswith("lamp.") else RAW[name.removeprefix("functions.symbol.")][0]
    table = changed(table, name, values)
    within, beyond = (differences(table, changed(table, name, values + share * tolerance), HELD) for share in (0.9, 1.1))
    assert within == () and [(each.column, each.first_step) for each in beyond] == [(name, 0)]


def test_loss_and_steps_are_held_exactly_and_timings_not_at_all(table):
    steps = table.num_rows
    lost = differences(table, changed(table, of_symbol("loss"), [*[""] * (steps - 1), "nothing"]), HELD)
    assert [(d.column, d.first_step, d.recorded, d.replayed) for d in lost] == [(of_symbol("loss"), steps - 1, "", "nothing")]
    assert differences(table, changed(table, "control_ms", np.arange(steps) * 1e6), HELD, exact=True) == ()
    (shorter,) = differences(table, table.slice(0, steps - 3), HELD)
    assert (shorter.column, shorter.recorded, shorter.replayed, shorter.largest) == ("step", steps, steps - 3, 3)


def test_missing_in_one_differs_and_missing_in_both_agrees(table):
    name = of_symbol("c_u")
    values = table[name].to_numpy().copy()
    values[3] = np.nan
    gap = changed(table, name, values)
    assert differences(gap, gap, HELD, exact=True) == ()
    (difference,) = differences(table, gap, HELD)
    assert (difference.column, difference.first_step, difference.replayed, difference.largest) == (name, 3, None, np.inf)


def test_steady_step_may_shift_by_one(table):
    def settling(step: int | None) -> pa.Table:
        k = np.arange(30)
        long = changed(pa.concat_tables([table.slice(0, 1)] * 30), "step", k)
        moving = np.where(k < (30 if step is None else step), 9.0 * (-1.0) ** k, 0.0)
        at_rest = {"length": 0 * k + 1.0, "shear": 0.0 * k, "centroid_error_y_percent": 0.0 * k, "centroid_error_x_percent": moving}
        for name, values in at_rest.items():
            long = changed(long, of_symbol(name), values)
        assert steady_step(of_one(long, "symbol")) == step
        return long

    for a, b, largest in ((10, 11, None), (10, 12, 2), (10, None, np.inf), (None, None, None)):
        found = [each for each in differences(settling(a), settling(b), HELD) if each.column == "functions.symbol: steady step"]
        assert [(each.largest, each.recorded, each.replayed) for each in found] == ([] if largest is None else [(largest, a, b)])


NO_IMAGE = {"name": "x", "functions": {"s": {"kind": "symbol", "image": "/none.png", "controller": "open"}}}
DAMAGE = {  # by what is said
    r"manifest.json: damaged, not valid JSON": lambda d: (d / "manifest.json").write_text("{"),
    r"manifest.json: not the manifest of a recording": lambda d: (d / "manifest.json").write_text("[]"),
    r"format_version: 2 is not understood": lambda d: edit(d / "manifest.json", format_version=2),
    r"manifest.json: scenario: name: is missing": lambda d: edit(d / "manifest.json", scenario={"steps": 3}),
    r"none\.png": lambda d: edit(d / "manifest.json", scenario=NO_IMAGE),
    r"trajectory.parquet: is missing, no step was recorded": lambda d: (d / "trajectory.parquet").unlink(),
    r"trajectory.parquet: damaged, not readable as Parquet": lambda d: truncate(d / "trajectory.parquet"),
    r"the column 'functions.symbol.iou' is missing": lambda d: rewrite(d, lambda t: t.drop_columns(of_symbol("iou"))),
    r"trajectory.parquet: a column is not of its type": lambda d: rewrite(d, words),
    r"trajectory.parquet: holds no step": lambda d: rewrite(d, lambda t: t.slice(0, 0)),
}


def truncate(file: Path) -> None:
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])


def rewrite(directory: Path, change: Any) -> None:
    file = directory / "trajectory.parquet"
    pq.write_table(change(pq.read_table(file)), file)


def words(table: pa.Table) -> pa.Table:
    name = of_symbol("x_m")
    return table.set_column(table.column_names.index(name), name, pa.array(["far"] * table.num_rows))


@pytest.mark.parametrize("message", DAMAGE)
def test_damaged_recording_is_told_in_a_sentence(recording, message):
    DAMAGE[message](recording)
    with refusal(message) as caught:
        replay(recording)
    assert "\n" not in str(caught.value)


def test_trajectory_from_elsewhere_may_have_more_columns(recording, table):
    rewrite(recording, lambda t: t.append_column("mine", pa.array(range(t.num_rows))))
    assert load(recording).table.select(table.column_names).equals(table)
    assert replay(recording).agrees


def test_csv_has_every_value(recording, tmp_path, table):
    c_u, iou, loss = (of_symbol(name) for name in ("c_u", "iou", "loss"))
    pq.write_table(changed(table, c_u, [np.nan, *table[c_u].to_pylist()[1:]]), recording / "trajectory.parquet")
    to_csv(recording, tmp_path / "out.csv")
    rows = list(csv.DictReader((tmp_path / "out.csv").open(newline="")))
    assert list(rows[0]) == table.column_names and rows[0][c_u] == ""
    assert [float(values[iou]) for values in rows] == table[iou].to_pylist()
    assert [values[loss] for values in rows] == table[loss].to_pylist()


def test_a_table_that_unpacks_to_more_than_the_budget_is_refused(tmp_path):
    file = tmp_path / "a.parquet"
    zeros = pa.repeat(0.0, 1_000_000)
    pq.write_table(pa.table({f"c{k}": zeros for k in range(200)}), file)
    assert file.stat().st_size < 1e6
    with refusal(r"its table would take at least 3.2 GB"):
        read_parquet(file)
