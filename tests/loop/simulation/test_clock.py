"""A plant whose clock does not begin at 0: nothing of a scenario or a recording knows of it."""

import tomllib

import pytest

from luxloop import validate
from luxloop.loop.scenario.overrides import overridden
from luxloop.loop.simulation.result import StepResult
from tests.loop.conftest import SMALL, simulation_of
from tests.refusal import sentence

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


TABLES = """
steps = 8
conditions = [{}, { time_s = 0.11, wet = true }]
[plant]
kind = "own:Clock"
[functions.symbol]
controller = "luxloop"
start_s = 0.05
stop_s = 0.21
[functions.late]
kind = "symbol"
image = "chevrons"
x_m = 25.0
start_s = 0.02
animation = { kind = "blinking", rate_hz = 8.0 }
"""


def results(begins_s: float, *overrides: str) -> list[StepResult]:
    given = overridden(SMALL, [tomllib.loads(TABLES), f"plant.options.begins_s={begins_s}", *overrides])
    return list(simulation_of(validate(given, "clock")).evaluations())


@pytest.mark.usefixtures("own")
def test_a_car_that_stands_sees_the_same_bits_by_any_clock():
    zero, epoch = results(0.0), results(EPOCH_S)
    assert [len(each.held) for each in epoch] == [0, 0, 1, 1, 1, 1, 1, 0] and [each.now.wet for each in epoch] == 4 * [False] + 4 * [True]
    assert len({each.plan.primitives is None for each in epoch}) == 2, "the blinking symbol"
    for a, b in zip(zero, epoch, strict=True):
        assert b.time_s == pytest.approx(a.time_s, abs=ROUNDED_S)
        assert b.perception.taken_s == pytest.approx(a.perception.taken_s, abs=ROUNDED_S, nan_ok=True)
        assert all(u.equal(v) for u, v in zip(a.lights, b.lights, strict=True))
        assert all(held.pose.equal(b.held[name].pose) for name, held in a.held.items())


BROKEN = {  # words of the sentence: what is replaced in OWN by what
    "start: gives ()": ("return self.told(*self.inner.start())", "return self.told(*self.inner.start())[0]"),
    "frame 0: was taken at 0 s": ("taken_s=each.taken_s + by", "taken_s=each.taken_s"),
    "give the time at its end": ("Arrivals(came.time_s + by", "Arrivals(by"),
    "give a tensor [180, 320]": ("replace(each, taken_s", "replace(each, image=each.image[::2], taken_s"),
    "an image that is not finite": ("replace(each, taken_s", "replace(each, image=each.image / 0, taken_s"),
    "frame 0: has shown = PartialImage": ("replace(each, taken_s", "replace(each, shown=each.image, taken_s"),
    "sample of wheels: was measured at nan s": ("measured_s=each.measured_s + by", "measured_s=float('nan')"),
    "gives objects that are no tuple of TrackedObject": ("tuple(samples))", "tuple(samples), (3,))"),
    "object walker: T_ground_object: ": (
        "tuple(samples))",
        "tuple(samples), (replace(WALKER, T_world_object=0 * WALKER.T_world_object),))",
    ),
}


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize("words", BROKEN)
def test_what_a_plant_cannot_mean_is_told_in_a_sentence(words, tmp_path):
    (tmp_path / "own.py").write_text(OWN.replace(*BROKEN[words]))
    with sentence("plant.kind: own:Clock: ", words):
        results(EPOCH_S, "vehicle={ course=[{ speed_m_s=6.0 }], oscillation.pitch_deg=0.5 }")
