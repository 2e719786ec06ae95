"""A plant whose clock does not begin at 0: nothing of a scenario or a recording knows of it."""

from pathlib import Path
from typing import Any

import pytest

from luxloop.loop.recording.record import row
from luxloop.loop.run import prepare, run
from luxloop.loop.scenario.model import validate
from luxloop.loop.simulation.result import StepResult
from luxloop.loop.studies.contracts.plant import check_plant
from luxloop.world.errors import LuxloopError
from tests.loop.conftest import SMALL

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
    return list(prepare(validate(given, "clock"), "cpu").run())


@pytest.mark.usefixtures("own")
def test_a_car_that_stands_sees_the_same_bits_by_any_clock() -> None:
    zero, epoch = results(0.0), results(EPOCH_S)
    assert [len(each.held) for each in epoch] == [0, 0, 1, 1, 1, 1, 1, 0] and [each.now.wet for each in epoch] == 4 * [False] + 4 * [True]
    assert len({each.plan.primitives is None for each in epoch}) == 2, "the blinking symbol"
    for a, b in zip(zero, epoch, strict=True):
        assert b.time_s == pytest.approx(a.time_s, abs=ROUNDED_S) and b.taken_s == pytest.approx(a.taken_s, abs=ROUNDED_S, nan_ok=True)
        assert all(u.equal(v) for u, v in zip(a.lights, b.lights, strict=True))
        assert all(held.pose.equal(b.held[name].pose) for name, held in a.held.items())


BROKEN = {  # what is replaced in OWN by what, and words of the sentence that tells it
    "a state alone": ("return self.told(*self.inner.start())", "return self.told(*self.inner.start())[0]", "start: gives ()"),
    "frames by another clock": ("taken_s=each.taken_s + by", "taken_s=each.taken_s", "frame 0: was taken at 0 s"),
    "a clock that stands": ("Arrivals(came.time_s + by", "Arrivals(by", "give the time at its end"),
    "half an image": ("replace(each, taken_s", "replace(each, image=each.image[::2], taken_s", "give a tensor [180, 320], as camera"),
    "an image of bytes": ("replace(each, taken_s", "replace(each, image=each.image.byte(), taken_s", "torch.uint8"),
    "an image of another dtype": ("replace(each, taken_s", "replace(each, image=each.image.double(), taken_s", "torch.float64"),
    "an image of NumPy": ("replace(each, taken_s", "replace(each, image=each.image.numpy(), taken_s", "an image that is a ndarray"),
    "an image that is not finite": (
        "replace(each, taken_s",
        "replace(each, image=each.image / 0, taken_s",
        "frame 0: has an image that is not finite",
    ),
    "no time": ("taken_s=each.taken_s + by", "taken_s=None", "frame 0: has the time None; give the plant's time in s"),
    "an image as what is shown": ("replace(each, taken_s", "replace(each, shown=each.image, taken_s", "frame 0: has shown = PartialImage"),
    "a sample of no time": ("measured_s=each.measured_s + by", "measured_s=float('nan')", "sample of wheels: was measured at nan s"),
    "a sample of NumPy": ("replace(each, measured_s", "replace(each, values=each.values.numpy(), measured_s", "values that are a ndarray"),
    "objects that are none": ("tuple(samples))", "tuple(samples), (3,))", "gives objects that are no tuple of TrackedObject"),
    "objects of one name": ("tuple(samples))", "tuple(samples), 2 * (WALKER,))", "gives two objects of the name 'walker'"),
    "an object without a pose": (
        "tuple(samples))",
        "tuple(samples), (replace(WALKER, T_world_object=0 * WALKER.T_world_object),))",
        "object walker: T_ground_object: ",
    ),
    "a sample of whole numbers": (
        "replace(each, measured_s",
        "replace(each, values=each.values.long(), measured_s",
        "torch.int64 [1] on cpu",
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


@pytest.mark.slow
@pytest.mark.usefixtures("own")
def test_a_car_that_drives_differs_by_the_rounding_of_its_clock() -> None:
    zero, epoch = (results(begins_s, vehicle=DRIVES) for begins_s in (0.0, EPOCH_S))
    for a, b in zip(zero, epoch, strict=True):
        assert [each.exposure.start_s for each in b.showings] == pytest.approx(
            [each.exposure.start_s for each in a.showings], abs=ROUNDED_S
        )
        assert row(b)["speed_m_s"] == pytest.approx(6.0, rel=1e-4)
        for name, held in a.held.items():  # 6 m/s * 2.4e-7 s are 1.4 µm, which noise of a few pixels' rounding exceeds
            assert held.pose.tolist() == pytest.approx(b.held[name].pose.tolist(), abs=1e-3)


@pytest.mark.usefixtures("own")
def test_windows_of_checks_and_recorded_times_count_from_the_start() -> None:
    check = {"metric": "lamp.left.flux_lm", "at_least": 1.0, "take": "min", "from_s": 0.1, "until_s": 0.2}
    plant = {"kind": "own:Clock", "options": {"begins_s": EPOCH_S}}
    done = run(validate(SMALL | {"plant": plant, "checks": {"lit": check}}, "clock"), device="cpu", video=False, report=False)
    assert done.summary["checks"]["lit"]["passed"]
    assert done.trajectory["time_s"].to_pylist() == pytest.approx([k / 30 for k in range(12)], abs=ROUNDED_S)


@pytest.mark.usefixtures("own")
def test_the_contract_lets_a_clock_begin_at_any_time() -> None:
    import own  # type: ignore[import-not-found]

    check_plant(own.Clock, {"begins_s": EPOCH_S}, "cpu")
