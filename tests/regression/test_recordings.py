"""The shipped scenarios still run as they were recorded, by the comparison of `luxloop replay`.

A recording here is the trajectory without its timings: what else a manifest says is the scenario file itself. Of symbols that are held
alone it has all steps; of others four, from a coarse camera, and moments of the utilisation of every module. The fast tests compare only
how most recordings begin; `pytest -m slow tests/regression` compares all of all.
"""

import os
import subprocess
import sys
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from luxloop.controllers.symbol.sensing.symbol_sensor import FeatureParams
from luxloop.loop.recording.comparison import differences
from luxloop.loop.recording.manifest import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario, load
from luxloop.loop.scenario.shipped import scenario_files
from luxloop.loop.simulation.result import StepResult
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.roads.scan import OpenCrgRoad
from tests.regression.recorded import FOLDER, ROOT, file_of, replace, told

# Thin extraction on these roads amplifies the rounding of another processor a hundredfold in ten steps, from about step 25 visibly.
SHORTENED = {"rough_course": ["steps=15"], "torsion_track": ["steps=15"]}
# Of these it shows earlier. They run in a process in which MKL rounds alike on all processors.
SENSITIVE, ALIKE = ("masked_symbol", "torsion_track"), {"MKL_CBWR": "COMPATIBLE"}
STEPS, WIDTH_PX = 4, 320
LEARNING_STEPS = 16  # of which scenarios with a detector are run, since each step depends on those before
MOMENTS = ("mean", "rms", "row", "col")
# How much of a recording the fast test compares: steps of a symbol that is held alone, else rows.
FIRST_STEPS, FIRST_ROWS = 8, 2
# Only the slow test compares them: they differ from others by road, picture or number of functions alone.
LIKE_OTHERS = (
    *("belgian_block", "black_box_static", "chevrons", "conditional_animation", "crest", "crossing_symbols", "curb", "distance_warning"),
    *("flat", "half_round_bar", "night_drive", "rough_course", "speed_bump", "torsion_track", "warning_triangle"),
    *("black_box_dynamic", "held_on_the_move", "misaimed", "path_projection", "raw_utilisations", "snowflake_birdseye", "two_symbols"),
)


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


def trajectory(name: str, whole: bool = True) -> pa.Table:
    """All rows of a recording, or those that a fast test compares."""
    scenario = load(name, SHORTENED.get(name, []))
    skip_without_data(scenario)
    if name in SENSITIVE and not ALIKE.items() <= os.environ.items():
        return trajectory_elsewhere(name, whole)
    if scenario.meters_light:
        return coarse(name, STEPS if whole else FIRST_ROWS)
    return of_each_step(Simulation.prepare(scenario), scenario.steps if whole else FIRST_STEPS)


def trajectory_elsewhere(name: str, whole: bool) -> pa.Table:
    """The trajectory from a process in which MKL rounds alike on all processors."""
    with TemporaryDirectory() as folder:
        file = Path(folder, "trajectory.parquet")
        command = [sys.executable, "-m", "tests.regression.test_recordings", name, str(file), *(["whole"] if whole else [])]
        subprocess.run(command, env={**os.environ, **ALIKE}, cwd=ROOT, check=True)
        return pq.read_table(file)


def of_each_step(simulation: Simulation, steps: int) -> pa.Table:
    columns = pa.schema([field for field in schema(simulation) if not field.name.endswith("_ms")])
    return table_of([row(result) for result in islice(simulation.evaluations(), steps)], columns)


def coarse(name: str, rows: int) -> pa.Table:
    """The first rows of four, of steps that are spread over the scenario."""
    scenario = load(name, ["renderer=raycast"])
    if scenario.detector is not None:
        # A network's sums are rounded as the processor likes, and a score at the border of what is found decides what is lit.
        scenario = load(name, ["renderer=raycast", "detector.kind=truth"], steps=LEARNING_STEPS)
    camera = scenario.camera
    few = camera.model_copy(update={"width_px": WIDTH_PX, "height_px": round(WIDTH_PX * camera.height_px / camera.width_px)})
    simulation = Simulation.prepare(scenario.model_copy(update={"camera": few}))
    steps = [k * (scenario.steps - 1) // (STEPS - 1) for k in range(STEPS)]
    results = (each for each in simulation.evaluations() if each.step in steps) if simulation.remembers else map(simulation.at, steps)
    found = [row(result) | moments(result, simulation) for result in islice(results, rows)]
    columns = [pa.field(field.name, field.type) for field in schema(simulation) if not field.name.endswith("_ms")]
    columns += [pa.field(f"module.{module.name}.{key}", pa.float64()) for module in simulation.modules for key in MOMENTS]
    return table_of(found, pa.schema(columns))


def moments(result: StepResult, simulation: Simulation) -> dict[str, float]:
    """Of the utilisation of each module: mean, root of the mean square, and its centre in pixels, NaN for a dark one."""
    values = {}
    for module, light in zip(simulation.modules, result.lights, strict=True):
        u = light.double().view(module.headlight.pixel_rows, module.headlight.pixel_cols)
        row, col = (torch.arange(n, dtype=torch.float64) + 0.5 for n in u.shape)
        found = (u.mean(), u.square().mean().sqrt(), u.sum(1) @ row / u.sum(), u.sum(0) @ col / u.sum())
        values |= {f"module.{module.name}.{key}": float(value) for key, value in zip(MOMENTS, found, strict=True)}
    return values


def held(name: str) -> dict[str, FeatureParams]:
    """What is looked at of each symbol that is held."""
    scenario = load(name)
    return {each: scenario.functions[each].features for each in scenario.symbols}


@pytest.mark.parametrize("name", [name for name in scenario_files() if name not in LIKE_OTHERS])
def test_scenario_begins_as_recorded(name, re_record):
    if re_record:
        pytest.skip("the recording is replaced")
    compared(name, trajectory(name, whole=False))


@pytest.mark.slow
@pytest.mark.parametrize("name", scenario_files())
def test_scenario_runs_as_recorded(name, re_record, capsys):
    now, file = trajectory(name), file_of(name)
    kept = pq.read_table(file) if file.is_file() else None
    if re_record:
        same = kept is not None and kept.column_names == now.column_names
        news = None if kept is None else told(differences(kept, now, held(name), exact=True)) if same else "  has other columns"
        with capsys.disabled():
            print(replace(name, now, news))
        return
    assert kept is not None and now.num_rows == kept.num_rows, f"{name} has another number of steps"
    compared(name, now)


def compared(name: str, now: pa.Table) -> None:
    """Assert that a run does not differ from the recording, of which it may have the first rows alone."""
    file = file_of(name)
    assert file.is_file(), f"never recorded: pytest -m slow tests/regression --re-record -k {name}"
    kept = pq.read_table(file)
    assert kept.column_names == now.column_names and kept.num_rows >= now.num_rows > 0
    apart = differences(kept.slice(0, now.num_rows), now, held(name))
    remedy = "if that is meant, pytest -m slow tests/regression --re-record"
    assert not apart, f"{name} runs differently; {remedy}\n{told(apart)}"


def test_a_change_of_the_light_is_told():
    now = pq.read_table(file_of("gfhb"))
    name = "objects.oncoming_car.lx_max"
    assert max(now["dark_lx_max"].to_pylist()) == 0.0  # the masks of the scenario keep all light off
    leak = now.set_column(now.column_names.index(name), name, pa.array([0.0, 1e-6, 0.0, 0.0]))
    (difference,) = differences(now, leak, {})
    assert (difference.column, difference.first_step) == (name, 1)


@pytest.mark.slow
@pytest.mark.parametrize("setting", [{"OMP_NUM_THREADS": "1"}, {"OMP_NUM_THREADS": "2"}, {"ATEN_CPU_CAPABILITY": "default"}], ids=str)
def test_recordings_hold_on_other_machines(setting):
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-m", "slow", "-k", "runs_as_recorded", str(Path(__file__).parent)]
    result = subprocess.run(command, env={**os.environ, **setting}, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout


def test_every_recording_has_its_scenario():
    assert {file.stem for file in FOLDER.glob("*")} <= set(scenario_files())


if __name__ == "__main__":
    pq.write_table(trajectory(sys.argv[1], "whole" in sys.argv[3:]), sys.argv[2])
