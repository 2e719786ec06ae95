"""The contract of trackers: what keeps it passes, and each way of breaking it has a sentence with cause and remedy."""

import shutil
from dataclasses import replace

import pytest
import torch

from luxloop import TrackedBoxes, check_tracker
from luxloop.loop.scenario.shipped import examples
from luxloop.perception.tracking import Tracker, TrackerParams
from tests.luxloop.variants import assert_refused, variant


class Good:
    def __init__(self, classes, view, **keys):
        self.classes, self.tracker, self.memory = classes, Tracker(classes, view, TrackerParams(**keys)), [0]

    def start(self):
        return self.tracker.start()

    def follow(self, state, found, frame, time_s):
        return self.tracker.follow(state, found, frame, time_s)

    def report(self, state, time_s):
        return self.reported(self.tracker.report(state, time_s), time_s)

    def reported(self, boxes, time_s):
        return boxes


class ByPlace(Good):
    def follow(self, state, found, frame, time_s):
        return (found, time_s)

    def report(self, state, time_s):
        if not isinstance(state, tuple):
            return super().report(state, time_s)
        found, now = state
        return TrackedBoxes.of(torch.arange(1, len(found) + 1), found, torch.full((len(found),), now))


class InPlace(Good):
    def follow(self, state, found, frame, time_s):
        state.mean.add_(1)
        return super().follow(state, found, frame, time_s)


class Remembering(Good):
    def follow(self, state, found, frame, time_s):
        self.memory[0] += 1
        return replace(super().follow(state, found, frame, time_s), following=self.memory[0])


class NeedsSome(Good):
    def follow(self, state, found, frame, time_s):
        found.scores.amax()
        return super().follow(state, found, frame, time_s)


class Still:
    def start(self): ...


BROKEN = {
    "has no method follow": Still,
    "follow changes state.mean, which was passed to it": InPlace,
    "follow gives another state.following": Remembering,
    "gives number as torch.float32; give torch.int64": variant(
        Good, reported=lambda self, boxes, _: replace(boxes, number=boxes.number.float())
    ),
    "number tracks from 1 on": variant(Good, reported=lambda self, boxes, _: replace(boxes, number=boxes.number - 1)),
    "gives NaN as a time": variant(Good, reported=lambda self, boxes, _: replace(boxes, until_s=boxes.until_s * torch.nan)),
    "boxes or confidence that are not finite": variant(
        Good, reported=lambda self, boxes, _: replace(boxes, confidence=boxes.score * torch.nan)
    ),
    "in a frame without detections: ": NeedsSome,
    "gives the pedestrian the number 1, which was that of the car": ByPlace,
    "gives the car the number 4, which was 3 before": variant(
        Good, reported=lambda self, boxes, time_s: replace(boxes, number=boxes.number + round(10 * time_s))
    ),
}


@pytest.mark.parametrize(("kind", "broken"), BROKEN.items())
def test_each_way_to_break_the_contract_is_told_in_a_sentence(kind, broken, device):
    assert_refused(lambda each: check_tracker(each, device=device.type), broken, "tracker.kind", kind)


def test_what_keeps_the_contract_passes(device, tmp_path, monkeypatch):
    check_tracker(Good, {"confirm_frames": 2}, device.type)
    shutil.copy(examples()["alpha_beta.py"], tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    check_tracker(__import__("alpha_beta").AlphaBeta, device=device.type)
    with pytest.warns(UserWarning, match="reported none of 2 objects in 12 frames"):
        check_tracker(variant(Good, follow=lambda self, state, found, frame, time_s: state), device=device.type)
