"""How the car sees: frames go to a detector, what it finds to a tracker, and tracks become boxes on the road."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

import torch
from torch import Tensor

from luxloop.controllers.situation import TrackedObject
from luxloop.loop.simulation.world import LitScene
from luxloop.perception.boxes import place_boxes
from luxloop.perception.detection.build import detector
from luxloop.perception.detection.detector import SAME, AnyParams, Detections, Detector, TruthParams, overlaps
from luxloop.perception.trackers import OwnTracker
from luxloop.perception.trackers import tracker as build_tracker
from luxloop.perception.tracking import ObjectTracker, TrackedBoxes, TrackerParams
from luxloop.world.frames import View
from luxloop.world.traffic.tracked import Category

LEAST_PX = 24.0  # height from which on a detector ought to find somebody


@dataclass(frozen=True)
class Recognition:
    """What is made of an object that is there. track: its number, None for none. confidence and score: of that track, 0 for none;
    of what was found in this frame alone. findable: whether it is of a class that the detector has, and tall enough.
    """

    track: int | None
    confidence: float
    score: float
    findable: bool


@dataclass(frozen=True, eq=False)
class DetectionPipeline:
    """A detector, None for the truth, and what tracks what it finds."""

    detector: Detector | None
    params: AnyParams
    tracker: ObjectTracker
    classes: tuple[Category, ...]
    view: View

    @classmethod
    def prepare(cls, params: AnyParams, tracker: TrackerParams | OwnTracker, view: View, device: torch.device) -> "DetectionPipeline":
        """Raises LuxloopError where the detector's file is missing or broken, or one of the user's own cannot be made."""
        finds = None if isinstance(params, TruthParams) else detector(params, device)
        classes = get_args(Category) if finds is None else finds.classes
        return cls(finds, params, build_tracker(tracker, classes, view), classes, view)

    def find(self, frame: Tensor, view: LitScene | None) -> Detections:
        """frame: `[height, width]`, digital numbers as a share of the largest. Raises LuxloopError where one's own detector fails at it."""
        if isinstance(self.params, TruthParams):
            assert view is not None
            return view.detections(self.params, self.classes)
        assert self.detector is not None
        return self.detector.detect(frame[None])[0]

    def objects(self, tracks: Any, time_s: float, view: View) -> tuple[TrackedObject, ...]:
        """The tracks as objects for lighting functions, where they are expected at a time, placed on the ground that a view sees."""
        told = self.tracker.report(tracks, time_s)
        numbers = told.category.tolist()
        names = tuple(self.classes[number] for number in numbers)
        boxes = place_boxes(told.boxes, names, view)
        return tuple(
            TrackedObject(
                name_of(int(told.number[k])),
                names[k],
                boxes.T_world_box[k],
                tuple(boxes.size_m[k].tolist()),
                float(told.since_s[k]),
                float(told.until_s[k]),
                float(told.confidence[k, number]),
                float(told.score[k, number]),
            )
            for k, number in enumerate(numbers)
        )

    def present(self, tracks: Any, time_s: float) -> TrackedBoxes:
        """Those that are not lost, with boxes that end at the borders of the image."""
        present = self.tracker.report(tracks, time_s).present
        size = torch.tensor([self.view.width, self.view.height] * 2).double()
        return replace(present, boxes=torch.minimum(present.boxes.clamp(min=0), size))


def name_of(number: int) -> str:
    """A track's name as an object."""
    return f"track_{number}"


def recognise(view: LitScene, tracks: TrackedBoxes, found: Detections, classes: Collection[Category]) -> Mapping[str, Recognition]:
    """What is made of each object in sight, by its name. classes: those of the detector."""
    boxes, scores = found.boxes.double().cpu(), found.scores.double().cpu()
    its_track = dict(pairs(view.boxes, tracks.boxes))
    its_box = dict(pairs(view.boxes, boxes))
    whole, sure = {}, tracks.confidence.amax(-1)
    for k, each in enumerate(view.objects):
        row, column = its_track.get(k), its_box.get(k)
        whole[each.name] = Recognition(
            None if row is None else int(tracks.number[row]),
            0.0 if row is None else float(sure[row]),
            0.0 if column is None else float(scores[column].max()),
            each.category in classes and float(view.boxes[k, 3] - view.boxes[k, 1]) >= LEAST_PX,
        )
    return whole


def false_positives(view: LitScene, found: Detections, least: float) -> int:
    """Number of detections with at least that score that overlap no object."""
    boxes = found.boxes[found.scores.amax(-1) >= least].double().cpu()
    return int((~(overlaps(boxes, view.boxes) >= SAME).any(-1)).sum())


def pairs(objects: Tensor, boxes: Tensor) -> list[tuple[int, int]]:
    """Indices of objects and of their boxes, each once, so that they overlap most in all."""
    from scipy.optimize import linear_sum_assignment

    shares = overlaps(objects, boxes)
    return [(i, j) for i, j in zip(*(each.tolist() for each in linear_sum_assignment(-shares)), strict=True) if shares[i, j] >= SAME]
