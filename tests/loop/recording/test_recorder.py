"""Recordings: whatever ends a run, what was done can be read; one seed gives the same recording in any process."""

import hashlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import torch

from luxloop import ExtractionStatus, Frame, ProjectionCommand, Scenario, Simulation, run, validate
from luxloop.loop.recording import recorder
from luxloop.loop.recording.manifest import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.recording.recorder import Recorder
from luxloop.loop.recording.replay import load
from luxloop.loop.simulation.columns import POSE, SYMBOL, loss_name
from luxloop.loop.simulation.result import Clock, StepResult
from luxloop.world.caches import Part, PartialImage
from tests.loop.conftest import SMALL
from tests.refusal import refusal

ROOT = Path(__file__).parents[3]


def record(directory: Path, simulation: Simulation, results: list[StepResult]) -> None:
    with Recorder(directory, simulation) as recording:
        for result in results:
            recording.add(result)


def strict_json(file: Path) -> Any:
    """JSON as the standard has it, without NaN."""

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    return json.loads(file.read_text(), parse_constant=refuse)


def test_row_has_plain_values_in_the_units_of_their_names(small_simulation, small_results):
    result, names = small_results[0], schema(small_simulation).names
    values, symbol = row(result), result.symbol
    assert {type(values[name]) for name in names if name != "dark_lx_max"} == {int, float, str}
    assert values["dark_lx_max"] is None, "nothing must be dark"
    held = {name: values[f"functions.symbol.{name}"] for name in SYMBOL}
    assert [held[name] for name in (*POSE, "z_m")] == pytest.approx([19.0, 1.0, 5.0, -2.0, 0.0]) and held["loss"] == ""
    assert held["pose_error_roll_deg"] == pytest.approx(math.degrees(symbol.measurement.pose_error[2]))
    assert held["br_v"] == symbol.measurement.appearance.centroids[4, 1].item()
    assert held["centroid_error_y_percent"] == symbol.metrics.centroid_percent[1].item()
    assert {f"{part}_ms" for part in ("plan", "light", "look", "control", "processing")} == {name for name in names if name.endswith("_ms")}
    assert values["look_ms"] == result.timings["plant"] + result.timings["look"], "rendering is no part of the car"


def test_what_the_plant_computes_of_a_frame_where_it_is_read_is_no_time_of_the_car():
    def slowly(part: Part) -> torch.Tensor:
        end_s = time.thread_time() + 0.05
        while time.thread_time() < end_s:
            pass
        return torch.zeros(9, 16)[part]

    clock, frame = Clock(), PartialImage.of(9, 16, torch.zeros(0), slowly)
    clock.watch([Frame(0, 0.0, 0.0, frame)])
    assert not frame.any()
    clock.lap("control")
    assert clock.ms["plant"] >= 50 > 25 > clock.processing_ms


def test_lost_symbol_is_a_row_with_a_reason(small_simulation, small_results):
    result = small_results[0]
    seen = small_simulation.symbol.sensor.measure(None, ProjectionCommand(result.symbol.pose), small_simulation.symbol.projector.resting)
    values = row(replace(result, held={"symbol": replace(result.symbol, measurement=seen)}))
    assert values["functions.symbol.loss"] == "no_frame"
    assert math.isnan(values["functions.symbol.c_u"]) and math.isnan(values["functions.symbol.e_pitch"])
    assert table_of([values], schema(small_simulation))["functions.symbol.c_u"].null_count == 1
    assert {loss_name(code) for code in ExtractionStatus} == {"", "no_frame", "nothing", "too_small", "too_large", "covered"}


def test_recording_is_complete(tmp_path, small_simulation, small_results):
    directory = tmp_path / "runs" / "small"
    record(directory, small_simulation, small_results)
    assert sorted(path.name for path in directory.iterdir()) == ["manifest.json", "summary.json", "trajectory.parquet"]
    manifest = strict_json(directory / "manifest.json")
    assert (manifest["status"], manifest["renderer"]) == ("complete", small_simulation.world.source.name)
    assert validate(manifest["scenario"], "manifest") == small_simulation.scenario
    symbol = ROOT / "scenarios" / "symbols" / "snowflake.png"
    assert manifest["inputs"]["functions.symbol.image snowflake.png"]["sha256"] == hashlib.sha256(symbol.read_bytes()).hexdigest()
    table, columns = pq.read_table(directory / "trajectory.parquet"), schema(small_simulation)
    assert table.schema.equals(columns, check_metadata=True) and columns.field("functions.symbol.pitch_deg").metadata[b"unit"] == b"deg"
    assert table.equals(table_of([row(result) for result in small_results], columns))
    summary = strict_json(directory / "summary.json")
    assert summary["steps"] == len(small_results)
    # open loop on a flat road is the target itself but for shadows and facets
    assert summary["functions"]["symbol"]["iou_open"] == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("done", [1, 5])
def test_ctrl_c_finishes_the_recording(tmp_path, small_simulation, small_results, done):
    with pytest.raises(KeyboardInterrupt), Recorder(tmp_path, small_simulation) as recording:
        for result in small_results[:done]:
            recording.add(result)
        raise KeyboardInterrupt
    assert load(tmp_path).manifest.status == "interrupted"
    assert load(tmp_path).table.num_rows == done
    assert strict_json(tmp_path / "summary.json")["steps"] == done


@pytest.mark.parametrize("writes", range(1, 6))
def test_death_in_the_middle_of_a_write_leaves_the_write_before(tmp_path, small_simulation, small_results, writes, monkeypatch):
    """The process dies when it would have put the new trajectory into place."""
    monkeypatch.setattr(recorder, "REST", 0)  # write at every step
    recording = Recorder(tmp_path, small_simulation)
    for result in small_results[:writes]:
        recording.add(result)

    class Killed(BaseException):
        pass

    def die(*paths: Path) -> None:
        raise Killed

    monkeypatch.setattr(os, "replace", die)
    with pytest.raises(Killed):
        recording.add(small_results[writes])
    assert load(tmp_path).manifest.status == "running"
    assert load(tmp_path).table.num_rows == writes


RUN = """
import itertools, json, sys
from pathlib import Path
from luxloop.loop.recording.recorder import Recorder
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.scenario.model import validate

simulation = Simulation.prepare(validate(json.loads(sys.argv[2]), "test"))
with Recorder(Path(sys.argv[1]), simulation) as recording:
    for result in simulation.evaluations():
        recording.add(result)
        print(result.step, flush=True)
"""


def start(directory: Path, scenario: Scenario, **changes: Any) -> "subprocess.Popen[str]":
    arguments = [sys.executable, "-W", "ignore", "-c", RUN, str(directory), json.dumps({**scenario.model_dump(mode="json"), **changes})]
    return subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, cwd=ROOT)


def test_kill_leaves_all_but_the_last_few_steps(tmp_path, small_scenario):
    process = start(tmp_path, small_scenario, steps=100_000)
    assert process.stdout is not None
    for _ in range(40):
        last = int(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    last = max([last, *map(int, process.stdout.read().split())])
    process.wait()
    recording = load(tmp_path)
    assert recording.manifest.status == "running"
    steps = recording.table["step"].to_pylist()
    assert steps == list(range(len(steps)))
    assert len(steps) > last - 20  # eleven times the duration of a write, 4 ms, at 5 ms a step, and twice that where the machine is busy


@pytest.mark.slow
def test_one_seed_gives_the_same_bits_in_two_processes(tmp_path, small_scenario):
    processes = [start(tmp_path / name, small_scenario, steps=5) for name in ("a", "b")]
    for process in processes:
        process.communicate()
        assert process.returncode == 0
    a, b = (load(tmp_path / name).table for name in ("a", "b"))
    exact = [name for name in a.column_names if not name.endswith("_ms")]
    assert a.num_rows == 5
    assert a.select(exact).equals(b.select(exact))


def test_what_ends_before_its_first_step_leaves_all_as_it_was(tmp_path, small_simulation, small_results):
    old = tmp_path / "old"
    record(old, small_simulation, small_results)
    before = {file.name: file.read_bytes() for file in old.iterdir()}
    for directory in (old, tmp_path / "new" / "below"):
        with pytest.raises(KeyboardInterrupt), Recorder(directory, small_simulation):
            raise KeyboardInterrupt
    assert {file.name: file.read_bytes() for file in old.iterdir()} == before
    assert list(tmp_path.iterdir()) == [old]


@pytest.mark.parametrize(
    ("name", "content"), [("thesis.tex", "text"), ("manifest.json", "{}"), ("manifest.json", "text"), ("trajectory.parquet", "")]
)
def test_directory_of_something_else_is_left_alone(tmp_path, small_simulation, name, content):
    (tmp_path / name).write_text(content)
    with refusal(r"holds files that are no recording"):
        run(validate(SMALL | {"headlight": {"model": "nothing.npz"}}, "never made ready"), tmp_path)
    with refusal(r"holds files that are no recording.*; give an empty or a new directory"):
        Recorder(tmp_path, small_simulation)
    assert (tmp_path / name).read_text() == content
    assert len(list(tmp_path.iterdir())) == 1


def test_what_cannot_be_written_is_said(tmp_path, small_simulation, small_results, monkeypatch):
    (tmp_path / "file").touch()
    for directory in (tmp_path / "file", tmp_path / "file" / "below"):
        with refusal(r"file.*: cannot be written \(.*\); give another folder with --out"):
            Recorder(directory, small_simulation)
    monkeypatch.setattr(recorder, "REST", 0)  # write at every step
    recording = Recorder(tmp_path / "gone", small_simulation)
    recording.add(small_results[0])
    shutil.rmtree(tmp_path / "gone")
    with refusal(r"gone/trajectory.parquet: cannot be written \(No such file or directory\)"):
        recording.add(small_results[0])
