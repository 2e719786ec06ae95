"""The report is drawn for whatever a run was, and keeps little of a long one."""

import gc
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pytest
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from luxloop import ExtractionStatus, Simulation, run, validate
from luxloop.loop.recording.functions_summary import summary_of
from luxloop.loop.recording.manifest import REPORT, Manifest, table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.report.highlights import Highlights, SymbolHistory, busiest_step
from luxloop.loop.report.page import DPI, LIGHT_IN, WIDE_IN, _from_near, write_report
from luxloop.loop.report.symbol import HIGH_IN, _courses, _title, outline_target
from luxloop.loop.simulation.columns import of_one
from luxloop.loop.simulation.result import StepResult
from luxloop.world.frames import View, pose_from_degrees
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import SMALL, box, simulation_of, toml

SYMBOL = SMALL["functions"]["symbol"]


def drawn(file: Path, simulation: Simulation, results: list[StepResult]) -> np.ndarray:
    highlights, rows = Highlights(simulation), []
    for result in results:
        highlights.add(result)
        rows.append(row(result))
    table = table_of(rows, schema(simulation))
    last = {name: result for result in results for name in result.held}
    manifest = Manifest.of(simulation.scenario, simulation.renderer, simulation.device)
    write_report(file, simulation, highlights, table, summary_of(simulation, table, last) | {"checks": {}}, manifest)
    page = cv2.imread(str(file))
    assert page is not None
    return page


def holds(page: np.ndarray, height_in: float) -> bool:
    """Whether a page has parts of this height, and a few lines of facts below."""
    return page.shape[1] == round(DPI * WIDE_IN) and 0.2 < page.shape[0] / DPI - height_in < 1.6


@pytest.fixture
def table(small_simulation: Simulation, small_results: list[StepResult]) -> pa.Table:
    """Of the symbol."""
    return of_one(table_of([row(result) for result in small_results], schema(small_simulation)), "symbol")


def courses(function: Any, table: pa.Table, **summary: Any) -> list[Axes]:
    figure = Figure()
    given = {"settle_step": None, "iou_open": None, "unsettled": "too_short"} | summary
    _courses(figure.add_subfigure(figure.add_gridspec()[0]), function, SymbolHistory("symbol", 12), table, given)
    return figure.axes


def test_a_title_has_no_folder_of_an_own_controller(small_simulation):
    title = _title(small_simulation, "symbol", {"controller": "/home/me/mine:Mine"}, "runs/recorded")
    assert "mine:Mine" in title[0] and "/home" not in title[0]


def test_curves_in_full_light_lie_beside_those_of_the_run(tmp_path, monkeypatch):
    drawn: list[Axes] = []
    monkeypatch.setattr("luxloop.loop.report.courses.heading", lambda axes, title: drawn.append(axes))
    dimmed, lamp = {"base": {"beam": "low"}}, {"model": "ssl-hd-lores"}
    car = box("car", (4.4, 1.8, 1.5), (20.0, 0.0, 0.0), category="car")
    checks = {"flux": toml("{ metric = 'lamp.left.flux_lm', at_most = 0.9, compare = 'full_light' }")}
    scenario = validate(SMALL | {"functions": {}, "objects": [car], "headlight": lamp, "lighting": dimmed, "checks": checks}, "here")
    found = run(scenario, tmp_path, device="cpu", video=False, checks=True)
    run_lm, full_lm = (line.get_ydata() for line in drawn[0].lines[:2])
    assert run_lm == pytest.approx(found.trajectory["lamp.left.flux_lm"].to_numpy())
    assert full_lm == pytest.approx(np.full(len(run_lm), found.summary["checks"]["flux"]["compared_value"]))


def lost(result: StepResult) -> StepResult:
    nan = torch.full((4,), torch.nan)
    code = torch.tensor(int(ExtractionStatus.NOTHING))
    seen = replace(result.symbol.measurement, code=code, errors=nan, pose_error=nan)
    return replace(result, held={"symbol": replace(result.symbol, measurement=seen)})


def test_the_target_is_outlined_where_a_pitched_camera_sees_it(small_simulation):
    """The outline moves by the focal length times the pitch, but for the distortion of a pinhole a few degrees off its axis."""
    symbol, view = small_simulation.symbol, small_simulation.symbol.sensor.model.eye.view
    pitch_deg, middles = 1.0, []
    turned = replace(view, T_world_view=pose_from_degrees(tuple(view.origin.tolist()), pitch_deg=pitch_deg) @ rotated_only(view))
    for each in (view, turned):
        axes = Figure().subplots()
        outline_target(axes, symbol, each)
        (collection,) = axes.collections
        middles.append(np.concatenate([path.vertices for path in collection.get_paths()]).mean(0))
    (u, v), (u_turned, v_turned) = middles
    assert u_turned == pytest.approx(u, abs=1.0)
    assert v - v_turned == pytest.approx(view.fy * np.tan(np.radians(pitch_deg)), rel=0.03)


def rotated_only(view: View) -> torch.Tensor:
    """The view's pose without its place."""
    T = view.T_world_view.clone()
    T[:3, 3] = 0
    return T


def test_page_is_readable_in_print_and_shows_target_and_past(tmp_path, small_simulation, small_results):
    page = drawn(tmp_path / "report.png", small_simulation, small_results)
    assert holds(page, HIGH_IN)
    blue, green, red = (page[..., i].astype(int) for i in range(3))
    assert ((red > 80) & (green < 50) & (blue < 50)).sum() > 500, "no past symbol in red"
    assert ((blue > 200) & (green > 150) & (red < 80)).sum() > 200, "no target in cyan"
    assert (page == 255).all(-1).mean() > 0.3, "no white paper"


@pytest.mark.parametrize("which", ["one step", "last step lost", "all steps lost"])
def test_page_of_an_unlucky_run(which, tmp_path, small_simulation, small_results):
    first, *others = small_results
    results = {
        "one step": [first],
        "last step lost": [first, *others[:2], lost(others[2])],
        "all steps lost": [lost(first), lost(others[0])],
    }[which]
    assert holds(drawn(tmp_path / "report.png", small_simulation, results), HIGH_IN)


@pytest.mark.slow
def test_page_of_two_lamps_seen_from_above(tmp_path):
    lamps = {"model": SMALL_LAMP, "lamps": ["left", "right"]}
    symbol = SYMBOL | toml("{ modules = ['left', 'right'], features = { view = 'birdseye', shape = 'moments' } }")
    simulation = simulation_of(validate(SMALL | {"headlight": lamps, "functions": {"symbol": symbol}, "steps": 2}, "two lamps"))
    assert len(simulation.symbol.projector.modules) == 2
    assert holds(drawn(tmp_path / "report.png", simulation, list(simulation.evaluations())), HIGH_IN)


@pytest.mark.slow
def test_page_has_all_light_and_then_each_symbol(tmp_path):
    car = box("box", (1.0, 0.5, 0.6), (25.0, 0.0, 0.0), category="car")
    functions = {name: SYMBOL | {"y_m": y_m, "start": {"x_m": 17.0, "y_m": y_m}} for name, y_m in (("left", 1.6), ("right", -1.6))}
    simulation = simulation_of(validate(SMALL | {"objects": [car], "functions": functions, "steps": 4}, "lit"))
    results = list(simulation.evaluations())
    assert holds(drawn(tmp_path / "both.png", simulation, results), LIGHT_IN + 2 * HIGH_IN)
    without = [replace(result, held={name: each for name, each in result.held.items() if name == "right"}) for result in results]
    assert holds(drawn(tmp_path / "one.png", simulation, without), LIGHT_IN + HIGH_IN), "a symbol that was never shown has no part"


@pytest.mark.parametrize(("z_m", "least_m"), [(0.0, 0.01), (4e-4, 0.01), (0.05, 0.05)])
def test_the_pose_shows_height_on_an_axis_of_a_centimetre_at_least(z_m, least_m, small_simulation, table):
    function = small_simulation.symbol.function
    held = {"x_m": function.x_m, "y_m": function.y_m + 1e-4, "roll_deg": 0.0, "pitch_deg": 0.0, "z_m": z_m}
    for name, value in held.items():
        table = table.set_column(table.column_names.index(name), name, pa.array([value] * table.num_rows))
    _, pose, *_ = courses(function, table)
    lines = {str(line.get_label()): line for line in pose.get_lines()}
    assert ("z" in lines) == bool(z_m) and (not z_m or np.asarray(lines["z"].get_ydata()).tolist() == [z_m] * 12)
    low, high = pose.get_ylim()
    assert low <= -0.01 and least_m <= high < 1.2 * least_m  # matplotlib leaves 5 % of the range free


def test_evaluations_far_apart_are_joined_and_where_there_are_none_the_chart_says_why(small_simulation, table):
    at, function = table.column_names.index("iou"), small_simulation.symbol.function
    for iou, unsettled, told in (([0.5, None, None, 0.7] * 3, "too_short", []), ([None] * 12, "not_judged", ["not evaluated, b"])):
        axes = courses(function, table.set_column(at, "iou", pa.array(iou, pa.float64())), unsettled=unsettled, judge_every=None)
        (line,) = (line for each in axes for line in each.get_lines() if line.get_label() == "IoU")
        assert np.asarray(line.get_ydata()).tolist() == [each for each in iou if each is not None]
        assert [text.get_text()[:16] for text in axes[2].texts if text.get_text()] == told


def test_light_from_above_is_looked_at_closely_where_it_is():
    def look(view: View) -> torch.Tensor:
        """1 lx on 3 m by 0.5 m, about a place 22 m ahead and 1 m to the left."""
        rays = view.rays()
        x, y, _ = view.origin[:, None, None] - rays * view.origin[2] / rays[2]
        return ((x - 22).abs().le(1.5) & (y - 1).abs().le(0.25)).float()

    light, (left, right, low, high) = _from_near(look)
    cell_m = (right - left) / light.shape[1], (high - low) / light.shape[0]
    assert max(cell_m) < 0.02, "a fifth of what all that can be lit is looked at with"
    assert light.sum() * cell_m[0] * cell_m[1] == pytest.approx(3 * 0.5, rel=0.02)  # of borders of 7 m, half a cell wide
    x, y = left + cell_m[0] * (np.arange(light.shape[1]) + 0.5), high - cell_m[1] * (np.arange(light.shape[0]) + 0.5)
    assert (light @ x).sum() / light.sum() == pytest.approx(22, abs=0.03)  # the view begins at whole cells
    assert (y @ light).sum() / light.sum() == pytest.approx(1, abs=0.03)
    assert left < 20 and right > 24 and low < 0 and high > 2


def test_path_is_the_centroid_in_the_image(small_results):
    gathered = SymbolHistory("symbol", 2)
    gathered.add(small_results[0])
    gathered.add(lost(small_results[1]))
    centre = small_results[0].symbol.measurement.appearance.centroids[0].tolist()
    assert gathered.path[0] == pytest.approx(centre, abs=1e-3)  # float32 sums of 320 px
    assert np.isnan(gathered.path[1]).all()


@pytest.mark.parametrize("report", [True, False])
def test_a_run_reports_if_wanted_and_leaves_no_simulation_behind(report, tmp_path, small_scenario):
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


def test_main_picture_is_from_amid_the_time_in_which_most_is_on():
    spans = {"early": (None, 1.0), "late": (0.6, 2.0), "all_along": (None, None)}
    functions = {name: {"kind": "lane", "start_s": start, "stop_s": stop} for name, (start, stop) in spans.items()}
    given = {key: value for key, value in SMALL.items() if key != "functions"} | {"steps": 60}
    lanes = {name: {key: value for key, value in each.items() if value is not None} for name, each in functions.items()}
    assert busiest_step(validate(given | {"functions": lanes}, "three")) == 24, "at 0.8 s of 2 s"
    assert busiest_step(validate(given | {"functions": {"all_along": lanes["all_along"]}}, "one")) is None
    assert busiest_step(validate(given | {"functions": {"late": lanes["late"]}}, "one")) == 39, "at 1.3 s"


def test_moments_begin_with_the_first_whichever_is_busiest(small_simulation, small_results):
    highlights = Highlights(small_simulation)
    for result in small_results:
        highlights.add(result)
    assert highlights.moments[0] is small_results[0] and highlights.moments[-1] is small_results[-1]
    assert highlights.busiest[0] is small_simulation and highlights.busiest[1] in small_results
