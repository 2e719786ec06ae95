"""Symbols that controllers hold among the lighting functions: beside masks, several of them, and what a file may ask for."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch
from rich.console import Console

from luxloop import Arrivals, Exposure, ExtractionStatus, Observation, Simulation, Utilisation
from luxloop.controllers.symbol.sensing.symbol_sensor import Projection
from luxloop.loop.recording.record import row, schema
from luxloop.loop.report.run_table import summary_table
from luxloop.loop.run import run as luxloop_run
from luxloop.loop.simulation.result import StepResult
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import box, scenario_of, simulated, toml
from tests.refusal import sentence

WORLD = f"""
name = "held"
steps = 10
road = {{ kind = "bumps", seed = 3 }}
headlight = {{ model = "{SMALL_LAMP}", lamps = ["left"] }}
camera = {{ width_px = 320, height_px = 180, oversampling = 2 }}
light.ambient_lx = 0.3
"""
FLAKE: dict[str, Any] = toml("{ kind = 'symbol', image = 'snowflake', controller = 'luxloop' }")
START = toml("{ x_m = 15.0, y_m = -0.8, roll_deg = 3.0, pitch_deg = -1.0 }")
LEFT, RIGHT = FLAKE | {"x_m": 17.5, "y_m": 1.6}, FLAKE | toml("{ image = 'chevrons', x_m = 16.0, y_m = -1.6 }")


def simulation(functions: dict[str, Any], *overrides: str, **changes: Any) -> Simulation:
    return simulated(WORLD, *overrides, functions=functions, **changes)


def run(functions: dict[str, Any], **changes: Any) -> list[StepResult]:
    return list(simulation(functions, **changes).evaluations())


def ious(results: Sequence[StepResult], name: str) -> list[float]:
    """Of the steps in which it was evaluated."""
    metrics = [each.held[name].metrics for each in results if name in each.held]
    return [float(each.iou) for each in metrics if each is not None]


@pytest.mark.parametrize("controller", ["luxloop", pytest.param("thesis_pid", marks=pytest.mark.slow)])
def test_a_mask_over_a_part_neither_moves_nor_loses_a_symbol(controller):
    car = box("box", (1.0, 0.5, 0.6), (15.2, 1.0, 0.0), category="car")
    flake = FLAKE | {"controller": controller}
    plain, masked = (run({"flake": flake} | more, objects=[car]) for more in ({}, {"guard": {"kind": "glare_free"}}))
    assert all(each.objects["box"].lx_max == 0 for each in masked)
    assert float(masked[-1].illuminance.sum()) < 0.9 * float(plain[-1].illuminance.sum()), "the mask takes nothing"
    assert {int(each.held["flake"].measurement.code) for each in masked} == {ExtractionStatus.SEEN}
    apart = (masked[-1].held["flake"].pose - plain[-1].held["flake"].pose).abs()
    # what a pixel of this camera sees of the road at 17 m, 0.3 m along and 3 cm across, and an angle by which the ends move as far
    assert float(apart[0]) < 0.3 and float(apart[1]) < 0.03 and float(apart[2:].max()) < 0.015


def test_a_symbol_under_other_functions_is_lost_as_covered_and_they_are_named(tmp_path):
    wall = box("wall", (6.0, 5.0, 0.1), (17.0, 0.0, 0.0), category="car")
    beside = toml("{ kind = 'symbol', image = 'chevrons', x_m = 30.0, y_m = 3.0, priority = 9 }")
    functions = {"flake": FLAKE | {"controller": "open"}, "guard": {"kind": "glare_free"}, "beside": beside}
    given = scenario_of(WORLD, "steps=11", functions=functions, objects=[wall])
    done = luxloop_run(given, tmp_path / "covered", device="cpu", video=False, report=False)
    assert set(done.trajectory["functions.flake.loss"].to_pylist()) == {"covered"}
    told = done.summary["functions"]["flake"]
    assert (told["unsettled"], told["lost_steps"], told["covered_steps"], told["covered_by"]) == ("covered", 11, 11, ["guard"])
    console = Console(record=True, width=200)
    console.print(summary_table(done.summary, "covered"))
    text = " ".join(console.export_text().split())
    assert "11, of which guard covered it in 11" in text and "functions.guard took too much light from the symbol to measure it" in text


def test_symbols_apart_are_measured_in_each_step_and_each_is_evaluated_by_itself():
    results = run({"left": LEFT, "right": RIGHT})
    for name in ("left", "right"):
        assert len(ious(results, name)) == len(results) and min(ious(results, name)[5:]) > 0.8


def test_symbols_that_meet_take_turns_and_stay_lit_in_the_other_ones():
    both = simulation({"lower": FLAKE, "upper": FLAKE | toml("{ image = 'chevrons', x_m = 15.0, y_m = -0.6, priority = 1 }")})
    results = list(both.evaluations())
    turns = [[name for name, held in each.held.items() if held.metrics is not None] for each in results]
    assert turns == [["lower"], ["upper"]] * 5
    assert {int(each.held[name].measurement.code) for each in results[2:] for name in each.held} == {
        ExtractionStatus.SEEN,
        ExtractionStatus.NO_FRAME,
    }
    assert min(ious(results, "upper")[2:]) > 0.75
    on, off = (each.lights[0].u for each in results[-1].exposures)  # the upper one's turn
    alone = simulation({"lower": FLAKE}).at(0).lights[0]
    assert float(((alone > 0.5) & (off > 0.5) & (on > 0.5)).sum()) > 100


def test_a_run_is_recorded_by_symbol_and_compared_with_the_open_loop():
    held = simulation({"flake": FLAKE | {"start": START}})
    names = schema(held).names
    assert {"functions.flake.x_m", "functions.flake.iou", "functions.flake.loss", "control_ms"} <= set(names)
    last = list(held.evaluations())[-1]
    values = row(last)
    assert values["functions.flake.iou"] == pytest.approx(ious([last], "flake")[0])
    opened = list(held.lit_by("open_loop").evaluations())[-1]
    assert ious([opened], "flake")[0] < 0.75 < 0.85 < values["functions.flake.iou"]
    assert opened.held["flake"].pose.tolist() == pytest.approx([17.0, 0.0, 0.0, 0.0])


WRONG = {
    "observer": {"observer": {}, "controller": "thesis_pid"},
    "yaw_deg": {"yaw_deg": 10.0},
    "animation": {"animation": {"kind": "blink"}},
    "controller.x_range_m": toml("{ start.x_m = 45.0, controller.name = 'thesis_pid' }"),
    "cannot hold a place": {"target": "place", "controller": "thesis_pid"},
    "x_m": {"x_m": 200.0},
    "luxlop": {"controller": "luxlop"},
    "functions.flake.modules": {"modules": ["right"]},
    "outside of the camera's view": {"y_m": 15.0},
    "functions.flake.image": {"image": "snowflak"},
}


@pytest.mark.parametrize(("words", "changes"), WRONG.items(), ids=WRONG)
def test_what_cannot_be_held_is_refused_in_a_sentence(words, changes):
    with sentence("functions.flake", words):
        simulation({"flake": FLAKE | changes})


def test_the_share_of_a_step_without_the_symbol_weighs_the_means_and_moves_no_symbol():
    """A car that stands sees the same at other times, and the light of both exposures stays as it is."""
    car = box("box", (0.2, 1.0, 0.3), (16.5, 0.0, 0.0), category="car")
    half, quarter = (
        simulation({"flake": FLAKE}, f"off_share={share}", "camera.exposure_s=0.008", "steps=4", objects=[car]) for share in (0.5, 0.25)
    )
    for a, b in zip(half.evaluations(), quarter.evaluations(), strict=True):
        assert a.held["flake"].pose.equal(b.held["flake"].pose)
        on, off = b.exposures
        begins_s = b.step / 30
        assert (on.start_s, off.start_s) == pytest.approx((begins_s, begins_s + 0.75 / 30))
        assert (on.duration_s, off.duration_s) == pytest.approx((0.75 / 30, 0.25 / 30))
        dark = float((off.lights[0].u * quarter.modules[0].flux).sum())
        assert b.powers["left"].flux_lm_peak == a.powers["left"].flux_lm_peak > dark
        assert b.powers["left"].flux_lm == pytest.approx(0.75 * b.powers["left"].flux_lm_peak + 0.25 * dark)
        assert a.objects["box"].lx_peak == b.objects["box"].lx_peak > 0
        assert a.objects["box"].lx_max == pytest.approx(0.5 * a.objects["box"].lx_peak)  # in the off exposure there is no light
        assert b.objects["box"].lx_max == pytest.approx(0.75 * b.objects["box"].lx_peak)
    assert "lamp.left.flux_lm_peak" in schema(quarter).names and "objects.box.lx_peak" in schema(quarter).names


def test_what_a_frame_says_that_it_shows_is_what_is_measured():
    """The controller on a plant that shows half of what is asked for gets the light that was shown."""
    asked = simulation({"flake": FLAKE | {"start": START, "controller": "thesis_pid"}}, "steps=4")

    class Half:
        def start(self) -> tuple[Any, Arrivals]:
            return asked.plant.start()

        def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
            shown = replace(exposure, lights=tuple(Utilisation(light.u / 2) for light in exposure.lights))
            state, came = asked.plant.show(state, shown)
            return state, replace(came, frames=tuple(replace(frame, shown=shown) for frame in came.frames))

    looks: list[Projection] = []
    symbol = asked.controlled["flake"]

    class Listening:
        start, projection = symbol.controller.start, symbol.controller.projection

        def step(self, state: Any, observation: Observation) -> Any:
            looks.append(observation.shown)
            return symbol.controller.step(state, observation)

    listening = replace(asked, plant=Half(), controlled={"flake": replace(symbol, controller=Listening())})
    results = list(listening.evaluations())
    for observation, each in zip(looks, results, strict=True):
        torch.testing.assert_close(observation.lights[0].u, each.lights[0] / 2)
