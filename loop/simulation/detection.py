"""Detection pipeline: detector on frames, tracker on detections, and tracks as boxes on the road."""

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

LEAST_PX = 24.0  # smallest height of an object that a detector should find


@dataclass(frozen=True)
class Recognition:
    """Track and detection of a true object. track: number of its track, None without one. confidence: of the track, 0 without one. score:
    of the detection in this frame, 0 without one. findable: whether the detector has its class and it is tall enough.
    """

    track: int | None
    confidence: float
    score: float
    findable: bool


@dataclass(frozen=True, eq=False)
class DetectionPipeline:
    """A detector, None for the truth, and a tracker of its detections."""

    detector: Detector | None
    params: AnyParams
    tracker: ObjectTracker
    classes: tuple[Category, ...]
    view: View

    @classmethod
    def prepare(cls, params: AnyParams, tracker: TrackerParams | OwnTracker, view: View, device: torch.device) -> "DetectionPipeline":
        """Build detector and tracker. Raises LuxloopError for a missing or broken file, or a user's class that cannot be made."""
        finds = None if isinstance(params, TruthParams) else detector(params, device)
        classes = get_args(Category) if finds is None else finds.classes
        return cls(finds, params, build_tracker(tracker, classes, view), classes, view)

    def find(self, frame: Tensor, view: LitScene | None) -> Detections:
        """Detections in a frame `[height, width]` of digital numbers scaled to 0..1. Raises LuxloopError if a user's detector fails."""
        if isinstance(self.params, TruthParams):
            assert view is not None
            return view.detections(self.params, self.classes)
        assert self.detector is not None
        return self.detector.detect(frame[None])[0]

    def objects(self, tracks: Any, time_s: float, view: View) -> tuple[TrackedObject, ...]:
        """Tracks as objects for lighting functions, predicted to a time and placed on the ground. view: in the ground frame."""
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
        """Tracks that are not lost, with boxes clipped to the image."""
        present = self.tracker.report(tracks, time_s).present
        size = torch.tensor([self.view.width, self.view.height] * 2).double()
        return replace(present, boxes=torch.minimum(present.boxes.clamp(min=0), size))


def name_of(number: int) -> str:
    """Name of a track as an object."""
    return f"track_{number}"


def recognise(view: LitScene, tracks: TrackedBoxes, found: Detections, classes: Collection[Category]) -> Mapping[str, Recognition]:
    """Recognition of each visible object, by name. classes: of the detector."""
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
    """Number of detections with at least the score least that overlap no object."""
    boxes = found.boxes[found.scores.amax(-1) >= least].double().cpu()
    return int((~(overlaps(boxes, view.boxes) >= SAME).any(-1)).sum())


def pairs(objects: Tensor, boxes: Tensor) -> list[tuple[int, int]]:
    """Index pairs (object, box) of largest total overlap, each index once; pairs that overlap less than SAME are left out."""
    from scipy.optimize import linear_sum_assignment

    shares = overlaps(objects, boxes)
    return [(i, j) for i, j in zip(*(each.tolist() for each in linear_sum_assignment(-shares)), strict=True) if shares[i, j] >= SAME]
