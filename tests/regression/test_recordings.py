"""The shipped scenarios still run as they were recorded, by the comparison of `luxloop replay`.

A recording here is the trajectory without its timings: what else a manifest says is the scenario file itself.
"""

import os
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from loop.recording.comparison import compare, tolerances
from loop.recording.recorder import COLUMNS, LATER, SCHEMA, row, table_of
from loop.scenario import data
from loop.scenario.model import LightingScenario, Scenario, load, load_any
from loop.scenario.shipped import shipped
from loop.symbol.simulation import Simulation
from tests.regression.recorded import FOLDER, ROOT, file_of, replace, told
from world.roads.shapes import OpenCrgRoad

SYMBOLS = [name for name in shipped() if not isinstance(load_any(name), LightingScenario)]
# Thin extraction on these roads amplifies the rounding of another processor a hundredfold in ten steps, from about step 25 visibly.
SHORTENED = {"rough_course": ["steps=15"], "torsion_track": ["steps=15"]}
COMPARED = [name for name in COLUMNS if not name.endswith("_ms")]


@pytest.fixture(autouse=True)
def data_at_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let measured roads be found where the tests' data lies, if it lies anywhere."""
    folder = ROOT.parent / "shared" / "data"
    if data.FOLDER_VARIABLE not in os.environ and folder.is_dir():
        monkeypatch.setenv(data.FOLDER_VARIABLE, str(folder))


def skip_without_data(scenario: Scenario) -> None:
    road = scenario.road
    if isinstance(road, OpenCrgRoad) and road.file in data.registry() and data.present(road.file) is None:
        pytest.skip(f"the measured road is not here: luxloop data get {road.file}")


def trajectory(scenario: Scenario) -> pa.Table:
    return table_of([row(result) for result in Simulation.prepare(scenario).run()])


def read(file: Path) -> pa.Table:
    """A recorded trajectory; its timings, which are not kept, become null."""
    kept = pq.read_table(file)
    fields = [SCHEMA.field(name) for name in COLUMNS if name in kept.column_names or name not in LATER]
    columns = [kept[field.name] if field.name in COMPARED else pa.nulls(kept.num_rows, field.type) for field in fields]
    return pa.Table.from_arrays(columns, schema=pa.schema(fields))


@pytest.mark.parametrize("name", SYMBOLS)
def test_scenario_runs_as_recorded(name: str, re_record: bool, capsys: pytest.CaptureFixture[str]) -> None:
    scenario, file = load(name, SHORTENED.get(name, [])), file_of(name)
    skip_without_data(scenario)
    if re_record:
        now = trajectory(scenario)
        news = told(compare(read(file), now, {})) if file.is_file() else None
        with capsys.disabled():
            print(replace(name, now.select(COMPARED), news))
        return
    assert file.is_file(), f"never recorded: pytest tests/regression --re-record -k {name}"
    differences = compare(read(file), trajectory(scenario), tolerances(scenario.features))
    assert not differences, f"{name} runs differently; if that is meant, pytest tests/regression --re-record\n{told(differences)}"


@pytest.mark.slow
@pytest.mark.parametrize("setting", [{"OMP_NUM_THREADS": "1"}, {"OMP_NUM_THREADS": "2"}, {"ATEN_CPU_CAPABILITY": "default"}], ids=str)
def test_recordings_hold_on_other_machines(setting: dict[str, str]) -> None:
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-k", "runs_as_recorded", str(Path(__file__).parent)]
    result = subprocess.run(command, env={**os.environ, **setting}, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout


def test_every_recording_has_its_scenario() -> None:
    assert {file.stem for file in FOLDER.glob("*")} <= set(shipped())
