"""The contract of trackers: what keeps it passes, and each way of breaking it has a sentence with cause and remedy."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from luxloop import LuxloopError, TrackedBoxes, check_tracker
from luxloop.loop.scenario.shipped import examples
from luxloop.perception.tracking import Tracker, TrackerParams


class Kept:
    def __init__(self, classes: Any, view: Any, **keys: Any) -> None:
        self.classes, self.tracker, self.memory = classes, Tracker(classes, view, TrackerParams(**keys)), [0]

    def start(self) -> Any:
        return self.tracker.start()

    def follow(self, state: Any, found: Any, frame: Any, time_s: float) -> Any:
        return self.tracker.follow(state, found, frame, time_s)

    def report(self, state: Any, time_s: float) -> Any:
        return self.tracker.report(state, time_s)


class Silent(Kept):
    def follow(self, state: Any, found: Any, frame: Any, time_s: float) -> Any:
        return state


class ByPlace(Kept):
    def follow(self, state: Any, found: Any, frame: Any, time_s: float) -> Any:
        return (found, time_s)

    def report(self, state: Any, time_s: float) -> Any:
        if not isinstance(state, tuple):
            return super().report(state, time_s)
        (found, now) = state
        number = torch.arange(1, len(found) + 1)
        return TrackedBoxes.of(number, found, torch.full((len(found),), now))


class Anew(Kept):
    def report(self, state: Any, time_s: float) -> Any:
        told = super().report(state, time_s)
        return replace(told, number=told.number + round(10 * time_s))


class Single(Kept):
    def report(self, state: Any, time_s: float) -> Any:
        told = super().report(state, time_s)
        return replace(told, number=told.number.float())


class FromZero(Kept):
    def report(self, state: Any, time_s: float) -> Any:
        told = super().report(state, time_s)
        return replace(told, number=told.number - 1)


class Timeless(Kept):
    def report(self, state: Any, time_s: float) -> Any:
        told = super().report(state, time_s)
        return replace(told, until_s=told.until_s * torch.nan)


class NotANumber(Kept):
    def report(self, state: Any, time_s: float) -> Any:
        told = super().report(state, time_s)
        return replace(told, confidence=told.score * torch.nan)


class InPlace(Kept):
    def follow(self, state: Any, found: Any, frame: Any, time_s: float) -> Any:
        state.mean.add_(1)
        return super().follow(state, found, frame, time_s)


class Remembering(Kept):
    def follow(self, state: Any, found: Any, frame: Any, time_s: float) -> Any:
        self.memory[0] += 1
        return replace(super().follow(state, found, frame, time_s), following=self.memory[0])


class NeedsSome(Kept):
    def follow(self, state: Any, found: Any, frame: Any, time_s: float) -> Any:
        found.scores.amax()
        return super().follow(state, found, frame, time_s)


class Unsaved(Kept):
    def start(self) -> Any:
        return iter(())


class TakesLess(Kept):
    def follow(self, state: Any, found: Any) -> Any:  # type: ignore[override]
        return state


class Still:
    def start(self) -> None: ...


BROKEN: dict[Any, list[str]] = {
    Still: ["has no method follow"],
    TakesLess: ["called as follow(state, found, frame, time_s)"],
    Unsaved: ["a state that cannot be saved"],
    InPlace: ["follow changes state.mean, which was passed to it"],
    Remembering: ["follow gives another state.following", "in the state and not in self"],
    Single: ["gives number as torch.float32; give torch.int64"],
    FromZero: ["gives the numbers [0]; number tracks from 1 on"],
    Timeless: ["gives NaN as a time", "until_s = inf"],
    NotANumber: ["boxes or confidence that are not finite"],
    NeedsSome: ["in a frame without detections: ", "follow fails"],
    ByPlace: ["gives the pedestrian the number 1, which was that of the car", "whatever the order of detections"],
    Anew: ["gives the car the number 4, which was 3 before"],
}


@pytest.mark.parametrize("broken", BROKEN, ids=lambda each: each.__name__)
def test_each_way_to_break_the_contract_is_told_in_a_sentence(broken: Any, device: torch.device) -> None:
    with pytest.raises(LuxloopError) as caught:
        check_tracker(broken, device=device.type)
    (sentence,) = caught.value.args
    assert f"tracker.kind: {__name__}:{broken.__name__}: " in sentence
    assert all(words in sentence for words in BROKEN[broken]), sentence


def test_what_keeps_the_contract_passes(device: torch.device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_tracker(Kept, {"confirm_frames": 2}, device.type)
    shutil.copy(examples()["alpha_beta.py"], tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    check_tracker(__import__("alpha_beta").AlphaBeta, device=device.type)
    with pytest.warns(UserWarning, match="reported none of 2 objects in 12 frames"):
        check_tracker(Silent, device=device.type)
