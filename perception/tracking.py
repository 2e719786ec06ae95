"""Multi-object tracking: from detections in single frames to tracks with identity and filtered scores.

A track is a Kalman filter with constant velocity for the centre of the box's foot in the image, and a size on the road within the limits of
the class. Darkness and other objects hide parts, so a box that is smaller than expected counts as a part and is completed. Detections are
assigned to tracks at least cost (Hungarian method) by overlap, distance and class. Lengths in the image are in units of the box size, the
root of the box area, which is about a metre for a pedestrian at any distance.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, Self

import torch
from pydantic import Field
from torch import Tensor
from torch.nn.functional import one_hot

from luxloop.perception.boxes import (
    MEASURED,
    SHINE,
    SOLID,
    are_parts,
    by_lamps,
    complete,
    extend_cut,
    limits_m,
    nearness,
    occluders_of,
    parts_of,
    plausible,
    range_rate,
    similar_classes,
    spread_of,
    standing,
)
from luxloop.perception.detection.detector import SAME, Detections, overlaps
from luxloop.world.frames import View
from luxloop.world.params import Params
from luxloop.world.traffic.tracked import Category


@dataclass(frozen=True, eq=False)
class TrackedBoxes:
    """A tracker's report: n tracks, C classes.

    number: `[n]` int64 from 1 on, unique identity. boxes: `[n, 4]` px, left, top, right, bottom, including hidden parts and parts outside
    the image. category: `[n]` int64, index of the class. confidence: `[n, C]` in 0..1, of each class. score: `[n, C]`, the same in the last
    frame alone, NaN if not detected. since_s: `[n]`, time of the first report. until_s: `[n]`, time of loss, inf if not lost; a lost track
    is reported for 2 s, so that its light can fade.
    """

    number: Tensor
    boxes: Tensor
    category: Tensor
    confidence: Tensor
    score: Tensor
    since_s: Tensor
    until_s: Tensor

    @classmethod
    def of(cls, number: Tensor, found: Detections, since_s: Tensor) -> Self:
        """Tracks `[n]` at the places of a frame's detections, with their scores."""
        scores = found.scores
        return cls(number, found.boxes, scores.argmax(-1), scores, scores, since_s, torch.full_like(since_s, torch.inf))

    def __len__(self) -> int:
        return len(self.number)

    @property
    def present(self) -> "TrackedBoxes":
        """The tracks that are not lost."""
        return TrackedBoxes(*(value[self.until_s.isinf()] for value in vars(self).values()))


class ObjectTracker(Protocol):
    """Tracks detections from frame to frame; its state is a value."""

    def start(self) -> Any:
        """The state before the first frame."""
        ...

    def follow(self, state: Any, found: Detections, frame: Tensor, time_s: float) -> Any:
        """The state after a frame `[height, width]` (digital numbers as shares 0..1 of the largest) and the detections in it."""
        ...

    def report(self, state: Any, time_s: float) -> TrackedBoxes:
        """The objects, predicted to a time not before the last frame."""
        ...


@dataclass(frozen=True, eq=False)
class Tracks:
    """All n tracks after a frame at time_s, C classes. following: number of the next new track.

    number: `[n]`, the identity. mean: `[n, 2, 2]`, u and v of the foot in px and their rates a second. covariance: `[n, 2, 2, 2]`. size_m:
    `[n, 2]`, width and height. frames: `[n]`, number of frames with a detection. odds_s: `[n]`, log odds of existence times the period of
    frames: the time without a detection that a track outlasts. since_s, until_s: `[n]`, times of confirmation and loss; inf: not yet.
    category: `[n]`, index of the class. confidence: `[n, C]`, filtered. score: `[n, C]` in this frame, NaN if not detected.
    """

    time_s: float
    number: Tensor
    mean: Tensor
    covariance: Tensor
    size_m: Tensor
    frames: Tensor
    odds_s: Tensor
    since_s: Tensor
    until_s: Tensor
    category: Tensor
    confidence: Tensor
    score: Tensor
    following: int

    def __len__(self) -> int:
        return len(self.number)

    def take(self, which: Tensor) -> "Tracks":
        """The tracks of indices or of a mask."""
        return replace(self, **{name: getattr(self, name)[which] for name in EACH})

    @property
    def confirmed_tracks(self) -> "Tracks":
        """The confirmed tracks, lost ones included."""
        return self.take(self.since_s.isfinite())

    @property
    def present(self) -> "Tracks":
        """The confirmed tracks that are not lost."""
        return self.take(self.since_s.isfinite() & self.until_s.isinf())


EACH = ("number", "mean", "covariance", "size_m", "frames", "odds_s", "since_s", "until_s", "category", "confidence", "score")


STARTS = (4.0, 0.5)  # of a new track's rates, in sizes a second: 4 m/s across for a pedestrian's size, less up and down
CHANGES = (1.0, 0.3)  # of how rates change, in sizes and the root of a second
GATE = 4.0  # standard deviations in u and v beyond which a detection belongs to no track, unless both boxes are of the same object
OTHER_CLASS = 0.5  # cost of a detection with score 0 for the track's class
LARGEST_COST = 1.8  # above it a track gets no detection; overlap costs at most 1, a distance of one size 1
FOLLOWS_S = 1.0  # time constant of the low-pass filter of sizes
WEAK = 0.5  # of the score that starts a track: least score that continues one
SUREST = 0.95  # score above which a detection tells no more of existence
BOTH = 0.5  # IoU of a box with a second track, without a detection, above which the box may belong to both
GROWTH = (0.9, 1.0)  # limits of the ratio of ranges in a prediction: what nears faster pitches, and what hides feet seems to recede
LINGER_S = 2.0  # time for which a lost track is still reported, so that its light can fade
SURER = 2.0  # ratio of another class's score to its own at which a track changes class


class TrackerParams(Params):
    """Parameters of luxloop's tracker."""

    kind: Literal["kalman"] = "kalman"
    start_score: float = Field(
        0.5,
        gt=0,
        lt=1,
        description="least score of a detection that starts a track and speaks for its existence; half of it continues one",
    )
    confirm_frames: int = Field(3, ge=1, le=30, description="consecutive frames with at least that score before a new object is reported")
    keep_s: float = Field(
        0.6,
        ge=0,
        le=10,
        description="time for which a surely detected object is kept undetected at its predicted place; others are kept for less",
    )
    confidence_s: float = Field(0.15, ge=0, le=10, description="time constant of the low-pass filter from scores to confidence; 0: none")

    @property
    def keeps_score(self) -> float:
        """Least score of a detection that continues a track."""
        return WEAK * self.start_score


@dataclass(frozen=True, eq=False)
class Tracker:
    """luxloop's tracker, for the classes of a detector in a fixed view."""

    classes: tuple[Category, ...]
    view: View
    params: TrackerParams

    def start(self) -> Tracks:
        """The state before the first frame."""
        return self._start(1, Detections(torch.zeros(0, 4).double(), torch.zeros(0, len(self.classes)).double()), 0.0)

    def follow(self, tracks: Tracks, found: Detections, frame: Tensor, time_s: float) -> Tracks:
        """The tracks after a frame `[height, width]`, shares of the largest digital number. Vehicles without a detection continue as sure
        as they were if their lamps are seen.
        """
        present = self.at(tracks, time_s).present
        boxes, scores = self.whole(present), found.scores.detach().double().cpu()
        shine = torch.tensor([self.classes[number] in SHINE for number in present.category.tolist()], dtype=torch.bool)
        sure = found.boxes.detach().double().cpu()[scores.amax(-1) >= self.params.keeps_score]
        missed = shine & ~(overlaps(boxes, sure) >= SAME).any(-1)
        metre = (boxes[missed, 2] - boxes[missed, 0]) / present.size_m[missed, 0]
        moved = by_lamps(frame, boxes[missed], metre, boxes[~missed])
        there = moved.isfinite().all(-1)
        sure_so_far = present.confidence[missed][there].amax(-1, keepdim=True).clamp(min=self.params.keeps_score)
        kept = one_hot(present.category[missed][there], len(self.classes)).double() * sure_so_far
        all_found = Detections(torch.cat([found.boxes.detach().double().cpu(), moved[there]]), torch.cat([scores, kept]))
        return self.step(tracks, all_found, time_s)

    def report(self, tracks: Tracks, time_s: float) -> TrackedBoxes:
        """The confirmed tracks, lost ones included, predicted to a time."""
        ahead = self.at(tracks.confirmed_tracks, time_s)
        return TrackedBoxes(ahead.number, self.whole(ahead), ahead.category, ahead.confidence, ahead.score, ahead.since_s, ahead.until_s)

    def boxes(self, tracks: Tracks) -> Tensor:
        """Boxes `[n, 4]` px (left, top, right, bottom), clipped to the image."""
        return torch.minimum(self.whole(tracks).clamp(min=0), torch.tensor([self.view.width, self.view.height] * 2).double())

    def whole(self, tracks: Tracks) -> Tensor:
        """Boxes `[n, 4]` px, including parts outside the image."""
        u, v = tracks.mean[..., 0].unbind(-1)
        width, height = (tracks.size_m * self._pixels_a_metre(u, v)[:, None]).unbind(-1)
        return torch.stack([u - width / 2, v - height, u + width / 2, v], -1)

    def at(self, tracks: Tracks, time_s: float) -> Tracks:
        """The tracks predicted to a time at constant velocity on the road; lost tracks do not move.

        In the image, rates grow with the square of nearness: after a time t the foot has moved by u' t / g and v' t / g, where the range
        is g times what it was.
        """
        dt = (time_s - tracks.time_s) * tracks.until_s.isinf().double()[:, None]
        growth = (1 + dt * range_rate(self.view, tracks.mean)[:, None]).clamp(*GROWTH)
        changes = (torch.tensor(CHANGES).double() * self._px(tracks)[:, None]) ** 2
        a, b, c = tracks.covariance[..., 0, 0], tracks.covariance[..., 0, 1], tracks.covariance[..., 1, 1]
        ahead, both, rate = a + 2 * dt * b + dt**2 * c + changes * dt**3 / 3, b + dt * c + changes * dt**2 / 2, c + changes * dt
        covariance = torch.stack([torch.stack([ahead, both], -1), torch.stack([both, rate], -1)], -2)
        mean = torch.stack([tracks.mean[..., 0] + dt * tracks.mean[..., 1] / growth, tracks.mean[..., 1] / growth**2], -1)
        return replace(tracks, time_s=time_s, mean=mean, covariance=covariance)

    def step(self, tracks: Tracks, found: Detections, time_s: float) -> Tracks:
        """The tracks after a frame at a later time with these detections."""
        found = self._standing(found)
        alive = self.at(tracks, time_s).take(tracks.until_s.isinf())
        lost = tracks.take(tracks.until_s.isfinite() & (time_s - tracks.until_s < LINGER_S))
        mine, its = self.assign(alive, found)
        shown = torch.zeros(len(alive), dtype=torch.bool).index_fill(0, mine, True)
        expected = self.whole(alive)
        boxes = extend_cut(found.boxes[its], expected[mine], self.view.width)
        complete = shown.index_copy(0, mine, ~are_parts(boxes, expected[mine]).any(-1))
        own = ~(overlaps(expected[~shown & alive.since_s.isfinite()], found.boxes[its]) >= BOTH).any(0)
        alive = self._correct(alive, mine[own], boxes[own], time_s - tracks.time_s)
        score = torch.full_like(alive.score, math.nan).index_copy(0, mine, found.scores[its])
        alive = self._update_scores(alive, shown, score, time_s, time_s - tracks.time_s)
        left = torch.ones(len(found), dtype=torch.bool).index_fill(0, its, False) & (found.scores.amax(-1) >= self.params.start_score)
        known = alive.since_s.isfinite()[:, None] & similar_classes(self.classes)[alive.category][:, found.scores.argmax(-1)]
        solid = torch.tensor([each in SOLID for each in self.classes])[found.scores.argmax(-1)]
        there = self.whole(alive)
        no_more = parts_of(found.boxes, there, complete) | solid & occluders_of(found.boxes, there, complete)
        left &= ~(known & no_more).any(0)
        alive = alive.take(shown | alive.since_s.isfinite())
        started = self._start(tracks.following, Detections(found.boxes[left], found.scores[left]), time_s)
        lost = replace(lost, score=torch.full_like(lost.score, math.nan))
        values: dict[str, Any] = {name: torch.cat([getattr(each, name) for each in (lost, alive, started)]) for name in EACH}
        return replace(started, **values)

    def assign(self, tracks: Tracks, found: Detections) -> tuple[Tensor, Tensor]:
        """Indices `[k]` of tracks and `[k]` of the detections assigned to them."""
        if not len(tracks) or not len(found):
            return torch.zeros(0, dtype=torch.int64), torch.zeros(0, dtype=torch.int64)
        from scipy.optimize import linear_sum_assignment

        expected, px = self.whole(tracks), self._px(tracks)[:, None]
        boxes = extend_cut(found.boxes[None], expected[:, None], self.view.width)
        off = _foot(complete(boxes, expected[:, None])) - tracks.mean[:, None, :, 0]
        spread = tracks.covariance[:, None, :, 0, 0] + spread_of(boxes, expected[:, None])
        far = (_foot(boxes) - tracks.mean[:, None, :, 0]).norm(dim=-1) / px
        likeness = found.scores[:, tracks.category].T / found.scores.amax(-1).clamp(min=1e-9)
        trusted = (found.scores.amax(-1) / self.params.start_score).clamp(max=1)
        cost = (1 - overlaps(expected, found.boxes) + far + OTHER_CLASS * (1 - likeness)) / trusted
        impossible = (off**2 > GATE**2 * spread).any(-1) & (overlaps(expected, found.boxes) < SAME)
        cost = torch.where(impossible, LARGEST_COST, cost.clamp(max=LARGEST_COST))
        rows, columns = (torch.from_numpy(each) for each in linear_sum_assignment(cost.numpy()))
        possible = cost[rows, columns] < LARGEST_COST
        return rows[possible], columns[possible]

    def _standing(self, found: Detections) -> Detections:
        """Detections of sufficient score, by Bayes' rule with their heights, completed to whole boxes."""
        boxes = found.boxes.detach().double().cpu()
        kinds = [self.classes[number] for number in found.scores.argmax(-1).tolist()]
        scores = plausible(found.scores.detach().double().cpu(), boxes, kinds, self.view)
        sure = scores.amax(-1) >= self.params.keeps_score
        names = tuple(self.classes[number] for number in scores[sure].argmax(-1).tolist())
        return Detections(standing(boxes[sure], names, self.view), scores[sure])

    def _correct(self, tracks: Tracks, which: Tensor, boxes: Tensor, dt: float) -> Tracks:
        """The tracks after a Kalman update of some tracks and their sizes by boxes."""
        some = tracks.take(which)
        expected = self.whole(some)
        off = _foot(complete(boxes, expected)) - some.mean[..., 0]
        spread = some.covariance[..., 0, 0] + spread_of(boxes, expected)
        gain = some.covariance[..., 0] / spread[..., None]
        covariance = some.covariance - gain[..., :, None] * gain[..., None, :] * spread[..., None, None]
        mean = some.mean + gain * off[..., None]
        measured = self._size_m(boxes, mean[..., 0])
        settled = (some.frames >= self.params.confirm_frames)[:, None]
        follows = torch.where(settled, _share(dt, FOLLOWS_S), 1 / (some.frames[:, None] + 1))
        size = some.size_m * (measured / some.size_m) ** follows
        least, most = limits_m(self.classes)[some.category].unbind(1)
        return replace(
            tracks,
            mean=tracks.mean.index_copy(0, which, mean),
            covariance=tracks.covariance.index_copy(0, which, covariance),
            size_m=tracks.size_m.index_copy(0, which, torch.minimum(torch.maximum(size, least), most)),
        )

    def _update_scores(self, tracks: Tracks, shown: Tensor, score: Tensor, time_s: float, dt: float) -> Tracks:
        """The tracks with confirmation, loss and class updated from their scores."""
        confidence = tracks.confidence + _share(dt, self.params.confidence_s) * (score.nan_to_num() - tracks.confidence)
        own, frames = confidence.gather(1, tracks.category[:, None])[:, 0], tracks.frames + shown
        category = torch.where(
            confidence.amax(-1) > torch.where(tracks.since_s.isfinite(), SURER, 1.0) * own, confidence.argmax(-1), tracks.category
        )
        likely = (frames >= self.params.confirm_frames) & (confidence.amax(-1) >= self.params.start_score)
        whole = self.whole(tracks)
        away = (whole[:, 2] < 0) | (whole[:, 0] > self.view.width)
        evidence = score.amax(-1).clamp(max=SUREST).logit() - math.log(self.params.start_score / (1 - self.params.start_score))
        odds_s = (tracks.odds_s + dt * torch.where(shown, evidence, -1.0)).clamp(max=self.params.keep_s)
        odds_s = torch.where(shown, odds_s.clamp(min=0), odds_s)
        gone = ~shown & (away | (odds_s < -dt / 2))  # half a frame, for rounded times
        return replace(
            tracks,
            frames=frames,
            category=category,
            confidence=confidence,
            score=score,
            since_s=torch.where(shown & likely & tracks.since_s.isinf(), time_s, tracks.since_s),
            odds_s=odds_s,
            until_s=torch.where(gone, time_s, tracks.until_s),
        )

    def _start(self, following: int, found: Detections, time_s: float) -> Tracks:
        n, at = len(found), _foot(found.boxes)
        px = (found.boxes[:, 2:] - found.boxes[:, :2]).clamp(min=1).prod(-1).sqrt()
        deviations = torch.tensor([MEASURED, STARTS], dtype=torch.float64).T
        now, never = (torch.full((n,), each, dtype=torch.float64) for each in (time_s, math.inf))
        return Tracks(
            time_s,
            number=torch.arange(following, following + n),
            mean=torch.stack([at, torch.zeros_like(at)], -1),
            covariance=torch.diag_embed((px[:, None, None] * deviations) ** 2),
            size_m=self._size_m(found.boxes, at),
            frames=torch.ones(n, dtype=torch.int64),
            odds_s=torch.zeros_like(now),
            since_s=now if self.params.confirm_frames == 1 else never,
            until_s=never,
            category=found.scores.argmax(-1),
            confidence=found.scores,
            score=found.scores,
            following=following + n,
        )

    def _pixels_a_metre(self, u: Tensor, v: Tensor) -> Tensor:
        return self.view.fx * nearness(self.view, u, v)

    def _size_m(self, boxes: Tensor, foot: Tensor) -> Tensor:
        """`[n, 2]`, width and height on the road, of boxes `[n, 4]` px with the foot at `[n, 2]` px."""
        return (boxes[:, 2:] - boxes[:, :2]).clamp(min=1) / self._pixels_a_metre(*foot.unbind(-1))[:, None]

    def _px(self, tracks: Tracks) -> Tensor:
        """Box sizes in px, `[n]`: roots of the box areas."""
        return tracks.size_m.prod(-1).sqrt() * self._pixels_a_metre(*tracks.mean[..., 0].unbind(-1))


def _foot(boxes: Tensor) -> Tensor:
    """`[..., 2]`: u and v of the middle of the foot of boxes `[..., 4]`."""
    return torch.stack([(boxes[..., 0] + boxes[..., 2]) / 2, boxes[..., 3]], -1)


def _share(dt: float, time_constant_s: float) -> float:
    """Share of the difference to the input that a first-order low-pass filter covers in a time dt."""
    return 1.0 if time_constant_s == 0 else -math.expm1(-dt / time_constant_s)
