"""The report is drawn for whatever a run was, and keeps little of a long one."""

import gc
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest
import torch

from loop.recording.recorder import REPORT, row, table_of
from loop.recording.report import PAST_SYMBOLS, Gathered, write_report
from loop.recording.summary import summarise
from loop.run import run
from loop.scenario.model import Scenario
from loop.symbol.simulation import Simulation, StepResult
from perception.extraction import Loss


def drawn(file: Path, simulation: Simulation, results: list[StepResult]) -> np.ndarray:
    gathered, rows = Gathered(len(results)), []
    for result in results:
        gathered.add(result)
        rows.append(row(result))
    table: pa.Table = table_of(rows)
    write_report(file, simulation, gathered, table, summarise(table, "small", "thesis_pid", 0.5))
    return cv2.imread(str(file))


def lost(result: StepResult) -> StepResult:
    nan = torch.full((4,), torch.nan)
    code = torch.tensor(int(Loss.NOTHING))
    return replace(result, seen=replace(result.seen, code=code, errors=nan, pose_error=nan))


def test_page_is_readable_in_print_and_shows_target_and_past(
    tmp_path: Path, small_simulation: Simulation, small_results: list[StepResult]
) -> None:
    page = drawn(tmp_path / "report.png", small_simulation, small_results)
    assert page.shape == (1410, 1800, 3)
    blue, green, red = (page[..., i].astype(int) for i in range(3))
    assert ((red > 80) & (green < 50) & (blue < 50)).sum() > 500, "no past symbol in red"
    assert ((blue > 200) & (green > 150) & (red < 80)).sum() > 200, "no target in cyan"
    assert (page == 255).all(-1).mean() > 0.3, "no white paper"


@pytest.mark.parametrize("which", ["one step", "last step lost", "all steps lost"])
def test_page_of_an_unlucky_run(which: str, tmp_path: Path, small_simulation: Simulation, small_results: list[StepResult]) -> None:
    first, *others = small_results
    results = {
        "one step": [first],
        "last step lost": [first, *others[:2], lost(others[2])],
        "all steps lost": [lost(first), lost(others[0])],
    }[which]
    assert drawn(tmp_path / "report.png", small_simulation, results).shape[1] == 1800


def test_page_of_two_lamps_seen_from_above(tmp_path: Path, small_scenario: Scenario) -> None:
    scenario = small_scenario.model_copy(
        update={
            "headlight": small_scenario.headlight.model_copy(update={"lamps": ("left", "right")}),
            "features": small_scenario.features.model_copy(update={"view": "birdseye", "shape": "moments"}),
            "steps": 2,
        }
    )
    simulation = Simulation.prepare(scenario)
    assert drawn(tmp_path / "report.png", simulation, list(simulation.run())).shape[1] == 1800


def test_long_run_keeps_few_images(small_results: list[StepResult]) -> None:
    gathered = Gathered(10_000)
    for step in range(10_000):
        gathered.add(small_results[step] if step < 3 else replace(small_results[3], step=step))
    assert len(gathered.symbols) <= PAST_SYMBOLS
    assert len(gathered.path) == 10_000
    assert gathered.last is not None and gathered.last.step == 9_999


def test_path_is_the_centroid_in_the_image(small_results: list[StepResult]) -> None:
    gathered = Gathered(2)
    gathered.add(small_results[0])
    gathered.add(lost(small_results[1]))
    assert gathered.path[0] == pytest.approx(small_results[0].seen.appearance.centroids[0].tolist(), abs=1e-3)  # float32 sums of 320 px
    assert np.isnan(gathered.path[1]).all()


@pytest.mark.parametrize("report", [True, False])
def test_a_run_reports_if_wanted_and_leaves_no_simulation_behind(report: bool, tmp_path: Path, small_scenario: Scenario) -> None:
    def simulations() -> int:
        return sum(type(each) is Simulation for each in gc.get_objects())

    gc.collect()
    before = simulations()
    gc.disable()  # what is left to Python's own passes stays for many runs: they count objects, not bytes
    try:
        run(small_scenario.model_copy(update={"steps": 1}), tmp_path, video=False, report=report)
    finally:
        gc.enable()
    assert (tmp_path / REPORT).exists() == report
    assert simulations() == before, "hundreds of megabytes each"
