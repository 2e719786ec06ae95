"""How the car sees: frames go to a detector, what it finds to a tracker, and tracks become boxes on the road."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_args

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor
from torch.nn.functional import one_hot

from controllers.situation import TrackedObject
from loop.lighting.view import LitScene
from perception.detection.build import detector
from perception.detection.params import AnyParams, TruthParams
from perception.detection.protocol import Detections, Detector
from perception.detection.suppression import overlaps
from perception.lamps import SHINE, by_lamps
from perception.placing import placed
from perception.tracking import Tracker, TrackerParams
from perception.tracks import Tracks
from world.traffic.tracked import Category
from world.view import View

SAME = 0.3  # least overlap of a box with the object that it is said to show


@dataclass(frozen=True)
class Recognised:
    """What is made of an object that is there. track: its number, None for none. confidence and score: of that track, 0 for none;
    of what was found in this frame alone.
    """

    track: int | None
    confidence: float
    score: float


@dataclass(frozen=True, eq=False)
class Sight:
    """A detector, None for the truth, and what tracks what it finds."""

    detector: Detector | None
    params: AnyParams
    tracker: Tracker

    @classmethod
    def prepare(cls, params: AnyParams, tracker: TrackerParams, view: View, device: torch.device) -> "Sight":
        """Raises LuxloopError where the detector's file is missing or broken."""
        finds = None if isinstance(params, TruthParams) else detector(params, device)
        classes = get_args(Category) if finds is None else finds.classes
        return cls(finds, params, Tracker(classes, view, tracker))

    def find(self, frame: Tensor, view: LitScene) -> Detections:
        """frame: `[height, width]`, digital numbers as a share of the largest. Raises LuxloopError where one's own detector fails at it."""
        if isinstance(self.params, TruthParams):
            return view.detections(self.params, self.tracker.classes)
        assert self.detector is not None
        return self.detector.detect(frame[None])[0]

    def follow(self, tracks: Tracks, found: Detections, frame: Tensor, time_s: float) -> Tracks:
        """The tracks after a frame. Vehicles that are not found in it are kept, though not for sure, where their lamps shine."""
        present = self.tracker.at(tracks, time_s).present
        boxes, scores = self.tracker.whole(present), found.scores.detach().double().cpu()
        shine = torch.tensor([self.tracker.classes[number] in SHINE for number in present.category.tolist()], dtype=torch.bool)
        sure = found.boxes.detach().double().cpu()[scores.amax(-1) >= self.tracker.params.keeps_score]
        missed = shine & ~(overlaps(boxes, sure) >= SAME).any(-1)
        metre = (boxes[missed, 2] - boxes[missed, 0]) / present.size_m[missed, 0]
        moved = by_lamps(frame, boxes[missed], metre, boxes[~missed])
        there = moved.isfinite().all(-1)
        kept = one_hot(present.category[missed][there], len(self.tracker.classes)).double() * self.tracker.params.keeps_score
        all_found = Detections(torch.cat([found.boxes.detach().double().cpu(), moved[there]]), torch.cat([scores, kept]))
        return self.tracker.step(tracks, all_found, time_s)

    def objects(self, tracks: Tracks, time_s: float) -> tuple[TrackedObject, ...]:
        """The tracks as lighting functions are told of them, where they are expected at a time."""
        ahead = self.tracker.at(tracks.known, time_s)
        numbers = ahead.category.tolist()
        names = tuple(self.tracker.classes[number] for number in numbers)
        boxes = placed(self.tracker.whole(ahead), names, self.tracker.view)
        return tuple(
            TrackedObject(
                name_of(int(ahead.number[k])),
                names[k],
                boxes.T_world_box[k],
                tuple(boxes.size_m[k].tolist()),
                float(ahead.since_s[k]),
                float(ahead.until_s[k]),
                float(ahead.confidence[k, number]),
                float(ahead.score[k, number]),
            )
            for k, number in enumerate(numbers)
        )


def name_of(number: int) -> str:
    """A track's name as an object."""
    return f"track {number}"


def recognised(view: LitScene, tracked: Tensor, tracks: Tracks, found: Detections) -> Mapping[str, Recognised]:
    """What is made of each object in sight, by its name. tracked: boxes `[n, 4]` px of the tracks."""
    boxes, scores = found.boxes.double().cpu(), found.scores.double().cpu()
    its_track = dict(pairs(view.boxes, tracked))
    its_box = dict(pairs(view.boxes, boxes))
    whole, sure = {}, tracks.confidence.amax(-1)
    for k, each in enumerate(view.objects):
        row, column = its_track.get(k), its_box.get(k)
        whole[each.name] = Recognised(
            None if row is None else int(tracks.number[row]),
            0.0 if row is None else float(sure[row]),
            0.0 if column is None else float(scores[column].max()),
        )
    return whole


def false_positives(view: LitScene, found: Detections, least: float) -> int:
    """Number of detections with at least that score that overlap no object."""
    boxes = found.boxes[found.scores.amax(-1) >= least].double().cpu()
    return int((~(overlaps(boxes, view.boxes) >= SAME).any(-1)).sum())


def pairs(objects: Tensor, boxes: Tensor) -> list[tuple[int, int]]:
    """Indices of objects and of their boxes, each once, so that they overlap most in all."""
    shares = overlaps(objects, boxes)
    return [(i, j) for i, j in zip(*(each.tolist() for each in linear_sum_assignment(-shares)), strict=True) if shares[i, j] >= SAME]
