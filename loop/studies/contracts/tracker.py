"""Contract of a user's own tracker."""

import warnings
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from torch import Tensor

from luxloop.loop.simulation.detection import pairs
from luxloop.loop.studies.contracts.values import build_part, pure, pure_state, world
from luxloop.perception.detection.detector import Detections
from luxloop.perception.trackers import KEY, CheckedTracker, OwnTracker, own_tracker
from luxloop.perception.tracking import TrackedBoxes
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.frames import View
from luxloop.world.traffic.tracked import Category

CALLS = {"start": (), "follow": ("state", "found", "frame", "time_s"), "report": ("state", "time_s")}
RATE_HZ = 10.0  # of the scenario
SCENARIO = """
name = "check_tracker"
steps = 12
rate_hz = 10.0
camera = { width_px = 320, height_px = 180, oversampling = 1 }
headlight.model = "hd84"
lighting.base.beam = "high"
renderer = "raycast"
detector.kind = "truth"
[[objects]]
kind = "pedestrian"
name = "walker"
appears_s = 0.25
vanishes_s = 0.95
path = { points_m = [[15.0, 3.0, 0.0], [15.0, 1.0, 0.0]], speed_m_s = 1.0 }
[[objects]]
kind = "car"
name = "car"
path = { points_m = [[32.0, -3.0, 0.0], [10.0, -3.0, 0.0]], speed_m_s = 4.0 }
"""
EMPTY_AFTER = (1, 6)  # frames after which a frame without detections is tried


def check_tracker(tracker: type, options: Mapping[str, Any] | None = None, device: str = "auto") -> None:
    """Check your own tracker against the contract of `[tracker]`, in a few seconds.

    tracker: the class, from which a scenario makes `tracker(classes, view, **options)`. options: those of `[tracker]`. device: "auto",
    "cpu" or "cuda", of detections and frames.

    The check follows 12 frames `[180, 320]` at 10 Hz with detections of score 1: an approaching car, and a pedestrian from the fourth frame
    to the tenth. After some frames it tries a frame without detections. Raises LuxloopError with likely cause and remedy if a method is
    missing, fails, changes its arguments, or gives different results for the same arguments; if a state is no data; if a report's shapes or
    dtypes differ from those of `TrackedBoxes`, or values are not finite; and if an object's number changes or becomes another object's.
    Warns if nothing is reported.
    """
    view, classes, frames = _frames(device)
    params = dict(options or {})
    own = build_part(tracker, KEY, CALLS, lambda name: own_tracker(tracker, OwnTracker(kind=name, options=params), classes, view))
    state = pure_state(own.own, "start", {})
    _report(own, state, 0.0)
    numbers, where = dict[str, int](), f"{KEY}: {own.own.name}"
    for k, (frame, time_s, found) in enumerate(frames):
        state = _follow(own, state, found, frame, time_s)
        for kind, number in _numbers(found, _report(own, state, time_s), classes).items():
            others = {other for other, known in numbers.items() if known == number} - {kind}
            if numbers.setdefault(kind, number) != number or others:
                was = f"that of the {others.pop()}" if others else f"{numbers[kind]} before"
                raise LuxloopError(
                    f"{where}: report gives the {kind} the number {number}, which was {was}; keep an object's number in the state "
                    "from frame to frame, whatever the order of detections, and number each new object higher"
                )
        if k in EMPTY_AFTER:
            (next_frame, next_s, _), (last_frame, last_s, last_found) = frames[k + 1 : k + 3]
            empty = Detections(found.boxes[:0], found.scores[:0])
            with locate("in a frame without detections"):
                blind = _follow(own, state, empty, next_frame, next_s)
            with locate("after a frame without detections"):
                _follow(own, blind, last_found, last_frame, last_s)
    if not numbers:
        warnings.warn(
            f"{where}: reported none of 2 objects in {len(frames)} frames with detections of score 1; boxes are px",
            stacklevel=2,
        )


DetectionFrame = tuple[Tensor, float, Detections]  # a tracker's frame `[height, width]`, its time in s, and its detections


@cache
def _frames(device: str) -> tuple[View, tuple[Category, ...], Sequence[DetectionFrame]]:
    simulation = world(SCENARIO, device)
    assert simulation.pipeline is not None
    most, frames = 2**simulation.scenario.camera.bits - 1, []
    for step in simulation.run():
        assert step.frame is not None and step.perception.found is not None
        image, found = step.frame / most, step.perception.found
        frames.append((image, step.time_s, Detections(found.boxes.to(image), found.scores.to(image))))
    return simulation.view, simulation.pipeline.classes, frames


def _follow(tracker: CheckedTracker, state: Any, found: Detections, frame: Tensor, time_s: float) -> Any:
    """State after a frame, with reports at the frame's time and later."""
    after = pure_state(tracker.own, "follow", {"state": state, "found": found, "frame": frame, "time_s": time_s})
    for later_s in (time_s, time_s + 1 / RATE_HZ):
        _report(tracker, after, later_s)
    return after


def _report(tracker: CheckedTracker, state: Any, time_s: float) -> TrackedBoxes:
    return tracker.check(pure(tracker.own, "report", {"state": state, "time_s": time_s}, "report"))


def _numbers(found: Detections, told: TrackedBoxes, classes: Sequence[Category]) -> dict[str, int]:
    """Track numbers of the detected objects, by class."""
    present, boxes = told.present, found.boxes.double().cpu()
    return {classes[int(found.scores[i].argmax())]: int(present.number[j]) for i, j in pairs(boxes, present.boxes)}
