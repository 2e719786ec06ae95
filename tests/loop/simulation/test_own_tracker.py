"""Trackers of the user's own: the loop follows with them, and what is wrong with what they report is said in a sentence."""

from typing import Any

import pytest

from luxloop import Scenario
from luxloop.loop.recording.record import row
from tests.loop.conftest import scenario_of, simulation_of
from tests.refusal import sentence

OWN = """
from dataclasses import replace

import torch

from luxloop.perception.tracking import Tracker, TrackerParams

class Ours:
    def __init__(self, classes, view, **keys):
        self.tracker = Tracker(classes, view, TrackerParams(**keys))
    def start(self):
        return self.tracker.start()
    def follow(self, state, found, frame, time_s):
        return self.tracker.follow(state, found, frame, time_s)
    def report(self, state, time_s):
        return self.tracker.report(state, time_s)

class Listed(Ours):
    def report(self, state, time_s):
        return super().report(state, time_s).boxes

class Short(Ours):
    def report(self, state, time_s):
        told = super().report(state, time_s)
        return replace(told, confidence=told.confidence.amax(-1))

class Nowhere(Ours):
    def report(self, state, time_s):
        told = super().report(state, time_s)
        return replace(told, boxes=told.boxes * torch.nan)

class Same(Ours):
    def report(self, state, time_s):
        told = super().report(state, time_s)
        return replace(told, number=torch.ones_like(told.number))

class Unknown(Ours):
    def report(self, state, time_s):
        told = super().report(state, time_s)
        return replace(told, category=told.category + 100)

class Failing(Ours):
    def follow(self, state, found, frame, time_s):
        raise RuntimeError("no idea")

class Still:
    def start(self):
        return None
"""


TRACKED = """
name = "tracked"
steps = 5
renderer = "raycast"
headlight.model = "hd84"
camera = { width_px = 320, height_px = 180, oversampling = 1 }
detector.kind = "truth"
lighting.base.beam = "low"
[[objects]]
kind = "pedestrian"
name = "one"
path = { points_m = [[15, -1, 0], [15, 1, 0]], speed_m_s = 1.4 }
[[objects]]
kind = "pedestrian"
name = "two"
path = { points_m = [[15, 2, 0], [15, -2, 0]], speed_m_s = 1.4 }
"""


def scenario(**tracker: Any) -> Scenario:
    return scenario_of(TRACKED, tracker=tracker)


def looked(**tracker: Any) -> list[Any]:
    results = simulation_of(scenario(**tracker)).evaluations()
    return [(each.detections.tracks.boxes.tolist(), each.detections.recognised, [o.name for o in each.now.objects]) for each in results]


@pytest.mark.parametrize("latency_steps", [0, 1])
def test_between_detections_tracks_are_predicted(latency_steps):
    camera = {"width_px": 320, "height_px": 180, "oversampling": 1, "latency_steps": latency_steps}
    tracked = scenario_of(TRACKED, detector_every=2, tracker={"confirm_frames": 2}, steps=5 + latency_steps, camera=camera)
    results = list(simulation_of(tracked).evaluations())[latency_steps:]
    assert [len(each.detections.found.boxes) for each in results] == [2, 0, 2, 0, 2]
    scores = [[value for name, value in row(each).items() if name.endswith(".score")] for each in results]
    assert scores == [[1, 1], [], [1, 1], [], [1, 1]]  # empty, not 0, without detection
    boxes = [each.detections.tracks.boxes for each in results]
    assert [len(each) for each in boxes] == [0, 0, 2, 2, 2]
    seen, predicted = (each[:, ::2].mean(1) for each in boxes[2:4])  # px across, of which they walk 2 a step
    assert ((predicted - seen).abs() > 1.0).all()


@pytest.mark.usefixtures("own")
def test_the_loop_follows_with_it():
    """Ours by another name follows bit for bit; other keys do not."""
    ours = looked(kind="own:Ours", options={"confirm_frames": 2})
    assert ours == looked(confirm_frames=2) != looked()
    assert ours[-1][2] == ["track_1", "track_2"]
    one = scenario(kind="own:Ours", options={"confirm_frames": 2})
    assert type(one).model_validate_json(one.model_dump_json()) == one, "recordings hold it"


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("Listed", {}, "report gives a Tensor"),
        ("Short", {}, "confidence [0] for 0 tracks and 8 classes; give [0, 8]"),
        ("Nowhere", {}, "not finite"),
        ("Same", {}, "the same number to several tracks, [1, 1]"),
        ("Unknown", {}, "category [104, 104]"),
        ("Failing", {}, "follow fails at"),
        ("Still", {}, "has no method follow"),
        ("Ours", {"confirm": 2}, "__init__ with the classes and the view and tracker.options fails"),
    ],
)
def test_what_is_wrong_with_it_is_said_in_a_sentence(name, options, words):
    with sentence(f"tracker.kind: own:{name}", words):
        looked(kind=f"own:{name}", options=options)
