"""The shipped lighting scenarios still run as they were recorded, by the comparison of `luxloop replay`.

A recording here has four steps as `luxloop run` records them, from a coarse camera, and moments of the utilisation of every module.
"""

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from loop.lighting.record import row, schema
from loop.lighting.replay import compare
from loop.lighting.result import LightingResult
from loop.lighting.simulation import LightingSimulation
from loop.recording.recorder import table_of
from loop.scenario.model import LightingScenario, load_any
from loop.scenario.shipped import shipped
from tests.regression.recorded import file_of, replace, told

LIGHTING = [name for name in shipped() if isinstance(load_any(name), LightingScenario)]
STEPS, WIDTH_PX = 4, 320
LEARNING_STEPS = 16  # of which scenarios with a detector are run, since each step depends on those before
MOMENTS = ("mean", "rms", "row", "col")


def moments(result: LightingResult, simulation: LightingSimulation) -> dict[str, float]:
    """Of the utilisation of each module: mean, root of the mean square, and its centre in pixels, NaN for a dark one."""
    values = {}
    for module, light in zip(simulation.modules, result.lights, strict=True):
        u = light.double().view(module.headlight.pixel_rows, module.headlight.pixel_cols)
        row, col = (torch.arange(n, dtype=torch.float64) + 0.5 for n in u.shape)
        found = (u.mean(), u.square().mean().sqrt(), u.sum(1) @ row / u.sum(), u.sum(0) @ col / u.sum())
        values |= {f"module.{module.name}.{key}": float(value) for key, value in zip(MOMENTS, found, strict=True)}
    return values


def trajectory(name: str) -> pa.Table:
    scenario = load_any(name, ["renderer=raycast"])
    if isinstance(scenario, LightingScenario) and scenario.detector is not None:
        # A network's sums are rounded as the processor likes, and a score at the border of what is found decides what is lit.
        scenario = load_any(name, ["renderer=raycast", "detector.kind=truth"], steps=LEARNING_STEPS)
    camera = scenario.camera
    coarse = camera.model_copy(update={"width_px": WIDTH_PX, "height_px": round(WIDTH_PX * camera.height_px / camera.width_px)})
    simulation = LightingSimulation.prepare(scenario.model_copy(update={"camera": coarse}))
    steps = [k * (scenario.steps - 1) // (STEPS - 1) for k in range(STEPS)]
    results = (each for each in simulation.run() if each.step in steps) if simulation.remembers else map(simulation.at, steps)
    rows = [row(result) | moments(result, simulation) for result in results]
    columns = [pa.field(field.name, field.type) for field in schema(simulation) if not field.name.endswith("_ms")]
    columns += [pa.field(f"module.{module.name}.{key}", pa.float64()) for module in simulation.modules for key in MOMENTS]
    return table_of(rows, pa.schema(columns))


@pytest.mark.parametrize("name", LIGHTING)
def test_lighting_runs_as_recorded(name: str, re_record: bool, capsys: pytest.CaptureFixture[str]) -> None:
    now, file = trajectory(name), file_of(name)
    kept = pq.read_table(file) if file.is_file() else None
    if re_record:
        same_columns = kept is not None and kept.column_names == now.column_names
        news = None if kept is None else told(compare(kept, now)) if same_columns else "  has other columns"
        with capsys.disabled():
            print(replace(name, now, news))
        return
    assert kept is not None, f"never recorded: pytest tests/regression --re-record -k {name}"
    assert kept.column_names == now.column_names and kept.num_rows == STEPS
    differences = compare(kept, now)
    assert not differences, f"{name} runs differently; if that is meant, pytest tests/regression --re-record\n{told(differences)}"


def test_a_change_of_the_light_is_told() -> None:
    now = pq.read_table(file_of("gfhb"))
    name = "objects.oncoming_car.lx_max"
    assert max(now["dark_lx_max"].to_pylist()) == 0.0  # the masks of the scenario keep all light off
    leak = now.set_column(now.column_names.index(name), name, pa.array([0.0, 1e-6, 0.0, 0.0]))
    (difference,) = compare(now, leak)
    assert (difference.column, difference.first_step) == (name, 1)
