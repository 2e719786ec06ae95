"""A tracker: an alpha-beta filter of the sides of each box in the image.

    luxloop new --like alpha_beta.py
    luxloop run obl --set tracker.kind=alpha_beta:AlphaBeta

Between two frames, dt apart, the sides x of a box move at their speeds v. The residual r = measured - (x + dt v) corrects both:
x <- x + dt v + alpha r and v <- v + beta r / dt. A detection goes to the track whose predicted box it overlaps most.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from luxloop import Detections, TrackedBoxes

START, CONTINUE = 0.5, 0.25  # least scores of a detection that starts a track, and of one that continues it
FADE_S = 2.0  # for which a lost track is reported, so that its light can fade


@dataclass(frozen=True)
class Track:
    """box: `[4]` px. speed: `[4]` px/s. confidence: `[C]`, filtered scores. score: `[C]` in the last frame, NaN if not found there.

    found: number of frames that showed it. found_s, since_s, until_s: when it was last found, first reported, and lost.
    """

    number: int
    box: Tensor
    speed: Tensor
    confidence: Tensor
    score: Tensor
    found: int
    found_s: float
    since_s: float = math.inf
    until_s: float = math.inf


@dataclass(frozen=True)
class State:
    """All tracks after the frame of time_s. following: number of the next one."""

    tracks: tuple[Track, ...] = ()
    time_s: float = 0.0
    following: int = 1


class AlphaBeta:
    """alpha, beta: gains. least: IoU of a track and its detection. confirm: frames until a report. keep_s: a track without detections."""

    def __init__(
        self,
        classes: Sequence[str],
        view: Any,
        alpha: float = 0.6,
        beta: float = 0.2,
        least: float = 0.2,
        confirm: int = 3,
        keep_s: float = 0.5,
    ) -> None:
        self.classes, self.alpha, self.beta, self.least, self.confirm, self.keep_s = classes, alpha, beta, least, confirm, keep_s

    def start(self) -> State:
        return State()

    def follow(self, state: State, found: Detections, frame: Tensor, time_s: float) -> State:
        boxes, scores = found.boxes.cpu(), found.scores.cpu()
        dt, free, tracks = time_s - state.time_s, set(range(len(boxes))), []
        for track in sorted(state.tracks, key=lambda each: -each.found):  # those that are known best choose first
            expected = track.box + dt * track.speed
            near = [(iou(expected, boxes[i]), i) for i in free if scores[i].max() >= CONTINUE] if track.until_s == math.inf else []
            if near and max(near)[0] >= self.least:
                free.remove(max(near)[1])
                tracks.append(self._corrected(track, expected, boxes[max(near)[1]], scores[max(near)[1]], time_s, dt))
            elif track.until_s < math.inf or (track.since_s < math.inf and time_s - track.found_s <= self.keep_s):
                tracks.append(self._missed(track, expected))
            elif track.since_s < math.inf:
                tracks.append(replace(self._missed(track, expected), until_s=time_s))
        start = [i for i in sorted(free) if scores[i].max() >= START and all(iou(each.box, boxes[i]) < self.least for each in tracks)]
        new = (Track(state.following + n, boxes[i], torch.zeros(4), scores[i], scores[i], 1, time_s) for n, i in enumerate(start))
        known = (each for each in (*tracks, *new) if time_s - each.until_s <= FADE_S)
        return State(tuple(known), time_s, state.following + len(start))

    def report(self, state: State, time_s: float) -> TrackedBoxes:
        known = [each for each in state.tracks if each.since_s < math.inf]
        confidence = self._stacked([each.confidence for each in known], len(self.classes))
        times = torch.tensor([(each.since_s, each.until_s) for each in known], dtype=torch.float64).reshape(-1, 2)
        return TrackedBoxes(
            torch.tensor([each.number for each in known], dtype=torch.int64),
            self._stacked([each.box + (time_s - state.time_s) * each.speed for each in known], 4),
            confidence.argmax(-1),
            confidence,
            self._stacked([each.score for each in known], len(self.classes)),
            *times.T,
        )

    def _corrected(self, track: Track, expected: Tensor, box: Tensor, score: Tensor, time_s: float, dt: float) -> Track:
        off, count = box - expected, track.found + 1
        confidence = track.confidence + 0.2 * (score - track.confidence)
        since_s = time_s if track.since_s == math.inf and count >= self.confirm else track.since_s
        speed = track.speed + self.beta * off / dt
        return Track(track.number, expected + self.alpha * off, speed, confidence, score, count, time_s, since_s)

    def _missed(self, track: Track, expected: Tensor) -> Track:
        return replace(track, box=expected, confidence=0.8 * track.confidence, score=torch.full_like(track.score, math.nan))

    def _stacked(self, values: list[Tensor], width: int) -> Tensor:
        return torch.stack(values) if values else torch.zeros(0, width)


def iou(a: Tensor, b: Tensor) -> float:
    """Intersection over union of two boxes `[4]`."""
    both = (torch.minimum(a[2:], b[2:]) - torch.maximum(a[:2], b[:2])).clamp(min=0).prod()
    return float(both / ((a[2:] - a[:2]).prod() + (b[2:] - b[:2]).prod() - both))
