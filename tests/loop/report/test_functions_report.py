"""What report and summary of lighting functions tell: charts that nothing hides, energy beside that of beams, whom the tracker loses."""

import tomllib
from itertools import combinations
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console

from luxloop import Detections, Scenario, Simulation, run, validate
from luxloop.loop.recording.functions_summary import NAMED, brightest, eyes_lx, lost_steps, reference_power, steps_of_nothing
from luxloop.loop.report.courses import write_courses
from luxloop.loop.report.page import _camera
from luxloop.loop.report.picture import Mark, readable
from luxloop.loop.report.run_table import _of_light, _of_lost, summary_table
from luxloop.loop.report.style import STYLE
from luxloop.loop.run import check, in_words
from luxloop.loop.simulation.detection import recognise
from tests.loop.conftest import toml

TOLD = tomllib.loads("""
name = "told"
steps = 4
headlight.model = "hd84"
camera = { width_px = 160, height_px = 90, oversampling = 1, saturation_e = 2000 }
surface.grain = 0.0
detector.kind = "truth"
renderer = "raycast"
[[objects]]
kind = "pedestrian"
name = "walker"
seed = 3
track = [{ position_m = [15, -2, 0] }]
""")
WALKER = TOLD["objects"]
ZONE = toml("{ kind = 'zone', centre_m = [14, 1, 1.0], size_m = [0, 1.6, 1.6], luminance_cd_m2 = 0.1 }")
HALF = toml("{ kind = 'object_based', method = 'constant', share = 0.5, setpoint_lx = 0.0 }")


def scenario(functions: dict[str, dict[str, Any]], beam: str = "high", **changes: Any) -> Scenario:
    given = {"lighting": {"base": {"beam": beam}}, "functions": functions}
    return validate(TOLD | given | changes, "told")


def test_every_chart_is_there_and_no_legend_lies_over_one(tmp_path):
    given = scenario({"half": HALF, "wall": ZONE})
    summary = run(given, tmp_path / "told", video=False, report=False).summary
    table = pq.read_table(tmp_path / "told" / "trajectory.parquet")
    with rc_context(STYLE):
        figure = Figure((5.4, 7.4), 80, layout="constrained")
        FigureCanvasAgg(figure)
        write_courses(figure.add_subfigure(figure.add_gridspec()[0]), Simulation.prepare(given), table, summary)
        figure.canvas.draw()
    charts = {_title(axes): axes for axes in figure.axes}
    assert [title.split()[0] for title in charts] == ["Luminous", "Electrical", "Luminance", "Confidence", "The"]
    zone = charts["Luminance of zones in cd/m², and what is wanted (dashed)"]
    measured, wanted = (np.asarray(line.get_ydata()).tolist() for line in zone.get_lines())
    assert measured == table["functions.wall.luminance"].to_pylist() and wanted == [0.1] * 4
    for axes in charts.values():
        legend = axes.get_legend()
        assert legend is not None
        around, chart = legend.get_window_extent(), axes.get_window_extent()
        assert around.y0 >= chart.y1 and around.x1 <= figure.bbox.x1 and around.y1 <= figure.bbox.y1


def in_sight(lx_max: float | None, **more: Any) -> dict[str, Any]:
    return {"lx_mean": lx_max, "lx_max": lx_max, "masked_steps": 0} | more


def told(summary: dict[str, Any]) -> str:
    """The closing table of a run."""
    console = Console(record=True, width=160)
    console.print(summary_table(summary, "here"))
    return console.export_text()


def test_of_many_objects_the_brightest_are_named_and_the_rest_counted():
    lit = {f"car_{k}": in_sight(float(k)) for k in range(20)}
    unseen = {f"sign_{k}": in_sight(None) for k in range(9)}
    rows = _of_light(lit | unseen, 9)
    assert [*rows] == [*(f"light on car_{k}" for k in range(19, 11, -1)), "light on 12 others", "never in sight"]
    assert (rows["light on 12 others"], rows["never in sight"]) == ("11 lx at most", "9 objects")
    assert "light on 1 other" in _of_light({f"car_{k}": in_sight(float(k)) for k in range(NAMED + 1)}, 9)
    assert _of_light({f"car_{k}": in_sight(0.0) for k in range(NAMED + 1)}, 9) == {f"light on {NAMED + 1} objects": "0 lx at most"}
    few = {f"car_{k}": in_sight(0.0) for k in range(NAMED)}
    assert [*_of_light(few, 9)] == [f"light on car_{k}" for k in range(NAMED)] and brightest(few) == [*few]


def test_of_many_objects_the_largest_that_are_lost_are_named():
    lost, missed = ({"steps_lost": steps, "tracks": tracks, "steps_in_sight": 9} for steps, tracks in ((2, 1), (0, 0)))
    objects = {f"car_{k}": in_sight(1.0, pixels_max=float(k), **(lost if k % 2 else missed)) for k in range(12)}
    rows = _of_lost(objects | {"held": in_sight(1.0, pixels_max=99.0, steps_lost=0, tracks=1, steps_in_sight=9)})
    assert [*rows] == [f"{'lost' if k % 2 else 'missed'} car_{k}" for k in range(11, 3, -1)] + ["smaller objects"]
    assert rows["smaller objects"] == "2 missed, 2 lost, of 3 px at most"
    assert _of_lost({"deer": in_sight(1.0, pixels_max=99.0, **missed, findable=False)}) == {
        "not to be found": "deer: of no class that the detector has, or never 24 px tall"
    }


def _title(axes: Axes) -> str:
    legend = axes.get_legend()
    return axes.get_title(loc="left") if legend is None else legend.get_title().get_text()


def test_energy_stands_beside_that_of_standby_and_of_undimmed_beams(tmp_path):
    dimmed, full = (
        run(scenario({"half": each} if each else {}, objects=[]), tmp_path / str(bool(each)), video=False, report=False).summary
        for each in (HALF, None)
    )
    others, seconds = dimmed["energy_compared_j"], 4 / 30
    assert others == full["energy_compared_j"] and list(others) == ["standby", "low beam", "high beam"]
    assert others["standby"] == pytest.approx(2 * 5.0 * seconds)
    assert others["high beam"] == pytest.approx(full["energy_j"], rel=1e-5) and others["low beam"] < others["high beam"]  # float32
    # What is left above standby goes with the share of the base beam
    assert dimmed["energy_j"] - others["standby"] == pytest.approx(0.5 * (full["energy_j"] - others["standby"]), rel=1e-5)
    text = told(dimmed)
    assert f"standby; undimmed low beam {others['low beam']:.3g} J, high beam" in text
    flux, low = sum(lamp["flux_lm_mean"] for lamp in dimmed["lamps"].values()), dimmed["low_beam_lm"]
    assert low == pytest.approx((others["low beam"] - others["standby"]) / seconds * 40.0, rel=1e-5)  # lm/W; float32
    assert f"{flux:.0f} lm (mean), {flux / low:.0%} of the undimmed low beam's {low:.0f} lm" in text


def test_power_is_compared_within_the_same_limit_and_beams_are_named_once():
    table = pa.table({"time_s": [0.0, 0.1], "beam": ["low", "low"]})
    free, limited = (
        reference_power(Simulation.prepare(scenario({}, "low", lighting={"base": {"beam": "low"}, "power_limit": limit})), table)
        for limit in (1.0, 0.001)
    )
    assert list(free) == list(limited) == ["standby", "low beam"]
    assert free["low beam"].shape == (2,) and free["standby"][0] < limited["low beam"][0] < free["low beam"][0]
    dark = reference_power(Simulation.prepare(scenario({}, "off")), pa.table({"time_s": [0.0], "beam": ["off"]}))
    assert list(dark) == ["standby", "low beam"]


def test_steps_in_which_somebody_in_sight_is_lost_and_tracks_that_show_nobody_are_counted():
    def table(confidence: list[float | None], track: list[int | None], **more: list[Any]) -> pa.Table:
        columns = {"objects.car.confidence": pa.array(confidence, pa.float64()), "objects.car.track": pa.array(track, pa.int64())}
        return pa.table(columns | {name: pa.array(values) for name, values in more.items()})

    none = None
    # seen before the first track; tracked; lost twice; out of sight; tracked again
    assert lost_steps(table([0.0, 0.8, 0.0, 0.0, none, 0.7], [none, 1, none, none, none, 2]), "car") == 2
    assert lost_steps(table([0.0] * 6, [none] * 6), "car") == 0
    # not found yet; found; with a ghost beside it; out of sight, with its track alone; then with a ghost too; its track strays
    ghosts = table([0.0, 0.8, 0.8, none, none, 0.0], [none, 1, 1, none, none, none], tracks=[0, 1, 2, 1, 2, 1])
    assert steps_of_nothing(ghosts, ["car"]) == 3 and steps_of_nothing(ghosts, []) == 5 and steps_of_nothing(ghosts[:0], ["car"]) == 0


def test_texts_do_not_cover_each_other():
    places = {"car 1: 0.90": (100, 50), "left of it": (49, 50), "cyclist 2: 0.80": (150, 55), "below": (150, 62), "": (100, 50)}
    marked = [Mark((), text=text, at=at) for text, at in places.items()]
    found = readable(marked, 5.0, 640)
    assert [mark.text for mark in found] == list(places) and [mark.at[1] for mark in found[:4]] == [50, 50, 35, 62]  # 10 px high
    crowd = readable([Mark((), text=name, at=(100, 50)) for name in "abcd"], 5.0, 640)
    assert [(mark.text, mark.at[1]) for mark in crowd[:3]] == [("a", 50), ("b", 40), ("c", 30)] and crowd[3].text == ""


def test_labels_in_small_pictures_of_the_camera_do_not_overlap():
    walkers = [WALKER[0] | {"name": f"walker_{k}", "track": [{"position_m": [15, 1.5 - k, 0]}]} for k in range(4)]
    simulation = Simulation.prepare(scenario({}, steps=4, objects=walkers, detector={"kind": "truth"}, tracker={"confirm_frames": 1}))
    *_, result = simulation.evaluations()
    with rc_context(STYLE):
        figure = Figure((7.6, 2.4), 80, layout="constrained")
        FigureCanvasAgg(figure)
        for axes in figure.add_subfigure(figure.add_gridspec()[0]).subplots(1, 2):
            _camera(axes, simulation, result, 1.0)
        figure.canvas.draw()
    around = [text.get_window_extent() for text in figure.axes[0].texts if text.get_text()]
    assert len(around) >= 3 and not any(a.overlaps(b) for a, b in combinations(around, 2))


def test_light_on_eyes_is_told_without_the_start_up():
    table = pa.table({"time_s": [0.0, 0.5, 1.0, 1.5], "eyes_lx_max": pa.array([8.0, 2.0, 0.4, None], pa.float64())})
    assert eyes_lx(table) == 8.0 and eyes_lx(table, 1.0) == 0.4 and eyes_lx(table, 1.2) is None


def test_whom_the_tracker_loses_is_told(tmp_path):
    """The detector finds nobody who is hidden by half, and a box comes before the walker in the fourth step."""
    before = toml("{ kind = 'box', name = 'box', size_m = [0.1, 3, 1.4], appears_s = 0.09, track = [{ position_m = [14, -2, 0] }] }")
    tracker = {"confirm_frames": 2, "keep_s": 0.1}
    summary = run(
        scenario({}, steps=12, objects=[*WALKER, before], detector={"kind": "truth", "least_visible": 0.5}, tracker=tracker),
        tmp_path / "lost",
        video=False,
    ).summary
    walker = summary["objects"]["walker"]
    assert walker["steps_in_sight"] == 12 and 2 <= walker["steps_lost"] <= 9
    assert walker["confidence_min"] == 0.0  # in the steps in which it is lost, though not in those before it was found
    text = told(summary)
    assert f"no track shows it in {walker['steps_lost']} of the 12 steps in which it is in sight" in text
    assert "lx at most, all within the first 1 s" in text and "walker 0.00, each from its first track on" in text


def test_who_is_too_small_or_of_another_class_is_not_missed():
    far = toml("{ kind = 'pedestrian', name = 'far', track = [{ position_m = [80.0, 3.0, 0.0] }] }")
    simulation = Simulation.prepare(scenario({}, objects=[*WALKER, far], detector={"kind": "truth"}))
    view = simulation.world.lit(0.0)
    assert simulation.pipeline is not None
    nothing = simulation.pipeline.present(simulation.pipeline.tracker.start(), 0.0), Detections(torch.zeros(0, 4), torch.zeros(0, 8))
    both, cars = (recognise(view, *nothing, classes) for classes in (("pedestrian", "car"), ("car",)))
    assert {name: each.findable for name, each in both.items()} == {"walker": True, "far": False}
    assert not cars["walker"].findable


def test_check_says_how_much_is_found_in_the_first_frame():
    some, none = check(scenario({})), check(scenario({}, detector={"kind": "truth", "least_height_px": 1000}))
    assert some["boxes"] == 1 and some["lx_max"] > 5
    assert f"truth (1 boxes in the first frame, where objects in sight have up to {some['lx_max']:.3g} lx)" in in_words(some)
    assert none["boxes"] == 0 and none["lx_max"] == some["lx_max"]
    assert "where no object is in sight" in in_words(check(scenario({}, objects=[])))
