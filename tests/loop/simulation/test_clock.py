"""A plant whose clock does not begin at 0: nothing of a scenario or a recording knows of it."""

from pathlib import Path
from typing import Any

import pytest

from luxloop.loop.scenario.model import validate
from luxloop.loop.simulation.result import StepResult
from luxloop.world.errors import LuxloopError
from tests.loop.conftest import SMALL, simulation_of

OWN = """
from dataclasses import replace
import torch
from luxloop import Arrivals, TrackedObject, simulated_plant

WALKER = TrackedObject("walker", "pedestrian", torch.eye(4, dtype=torch.float64), (0.5, 0.5, 1.8))

class Clock:
    def __init__(self, scenario, modules, begins_s=0.0):
        self.inner, self.begins_s = simulated_plant(scenario, modules), begins_s
        self.truth = self.inner.truth
    def start(self):
        return self.told(*self.inner.start())
    def show(self, state, exposure):
        assert exposure.start_s >= self.begins_s
        return self.told(*self.inner.show(state, replace(exposure, start_s=exposure.start_s - self.begins_s)))
    def told(self, state, came):
        by = self.begins_s
        frames = [replace(each, taken_s=each.taken_s + by, arrived_s=each.arrived_s + by) for each in came.frames]
        samples = [replace(each, measured_s=each.measured_s + by, arrived_s=each.arrived_s + by) for each in came.samples]
        return state, Arrivals(came.time_s + by, tuple(frames), tuple(samples))
"""
EPOCH_S = 1.7e9
ROUNDED_S = 2.4e-7  # the spacing of float64 there
HELD = SMALL["functions"]["symbol"] | {"controller": "luxloop", "start_s": 0.05, "stop_s": 0.21}
LATE = {"kind": "symbol", "image": "chevrons", "x_m": 25.0, "start_s": 0.02, "animation": {"kind": "blinking", "rate_hz": 8.0}}
DRIVES = {"course": [{"speed_m_s": 6.0}], "oscillation": {"pitch_deg": 0.5}}
RAIN = [{}, {"time_s": 0.11, "wet": True}]


def results(begins_s: float, **changes: Any) -> list[StepResult]:
    plant = {"kind": "own:Clock", "options": {"begins_s": begins_s}}
    functions = {"symbol": HELD, "late": LATE}
    given = SMALL | {"steps": 8, "conditions": RAIN, "functions": functions, "plant": plant} | changes
    return list(simulation_of(validate(given, "clock")).evaluations())


@pytest.mark.usefixtures("own")
def test_a_car_that_stands_sees_the_same_bits_by_any_clock() -> None:
    zero, epoch = results(0.0), results(EPOCH_S)
    assert [len(each.held) for each in epoch] == [0, 0, 1, 1, 1, 1, 1, 0] and [each.now.wet for each in epoch] == 4 * [False] + 4 * [True]
    assert len({each.plan.primitives is None for each in epoch}) == 2, "the blinking symbol"
    for a, b in zip(zero, epoch, strict=True):
        assert b.time_s == pytest.approx(a.time_s, abs=ROUNDED_S)
        assert b.perception.taken_s == pytest.approx(a.perception.taken_s, abs=ROUNDED_S, nan_ok=True)
        assert all(u.equal(v) for u, v in zip(a.lights, b.lights, strict=True))
        assert all(held.pose.equal(b.held[name].pose) for name, held in a.held.items())


BROKEN = {  # what is replaced in OWN by what, and words of the sentence that tells it
    "a state alone": ("return self.told(*self.inner.start())", "return self.told(*self.inner.start())[0]", "start: gives ()"),
    "frames by another clock": ("taken_s=each.taken_s + by", "taken_s=each.taken_s", "frame 0: was taken at 0 s"),
    "a clock that stands": ("Arrivals(came.time_s + by", "Arrivals(by", "give the time at its end"),
    "half an image": ("replace(each, taken_s", "replace(each, image=each.image[::2], taken_s", "give a tensor [180, 320], as camera"),
    "an image that is not finite": (
        "replace(each, taken_s",
        "replace(each, image=each.image / 0, taken_s",
        "frame 0: has an image that is not finite",
    ),
    "an image as what is shown": ("replace(each, taken_s", "replace(each, shown=each.image, taken_s", "frame 0: has shown = PartialImage"),
    "a sample of no time": ("measured_s=each.measured_s + by", "measured_s=float('nan')", "sample of wheels: was measured at nan s"),
    "objects that are none": ("tuple(samples))", "tuple(samples), (3,))", "gives objects that are no tuple of TrackedObject"),
    "an object without a pose": (
        "tuple(samples))",
        "tuple(samples), (replace(WALKER, T_world_object=0 * WALKER.T_world_object),))",
        "object walker: T_ground_object: ",
    ),
}


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize("broken", BROKEN)
def test_what_a_plant_cannot_mean_is_told_in_a_sentence(broken: str, tmp_path: Path) -> None:
    old, new, words = BROKEN[broken]
    (tmp_path / "own.py").write_text(OWN.replace(old, new))
    with pytest.raises(LuxloopError) as caught:
        results(EPOCH_S, vehicle=DRIVES)
    assert "plant.kind: own:Clock: " in str(caught.value) and words in str(caught.value)
