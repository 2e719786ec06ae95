"""Multi-object tracking: boxes found frame by frame become tracks that keep their identity, with scores filtered over frames.

Each track is four Kalman filters of constant velocity in the image: middle of the foot, u and v in px, and the logarithms of width and
height. Detections are given to tracks by the assignment of least cost (Hungarian method), which counts overlap, distance and class.
Lengths are measured in sizes of the box, the root of its area: for a pedestrian that is about a metre, wherever they are.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from pydantic import Field
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from perception.detection.protocol import Detections
from perception.detection.suppression import overlaps
from world.params import Params
from world.tracked import Category

MEASURED = (0.05, 0.05, 0.1, 0.07)  # standard deviations of a detected box: of its foot in sizes, of its logarithmic width and height
STARTS = (4.0, 1.0, 1.0, 1.0)  # of a new track's rates, a second: 4 m/s across for a pedestrian's size
CHANGES = (2.0, 0.5, 0.5, 0.5)  # of how rates change, in the root of a second
GATE = 4.0  # standard deviations, in u and in v, beyond which a detection is no track's
FARTHEST = 2.0  # sizes, the same
OTHER_CLASS = 0.5  # cost of a detection that is nothing like the track's class
LARGEST_COST = 1.8  # a track rather stays without a detection; the overlap costs 1 at most
LINGER_S = 2.0  # for which a lost track is still told, so that what is drawn about it can fade


class TrackerParams(Params):
    """How detections become objects that keep their identity."""

    start_score: float = Field(
        0.3, ge=0, le=1, description="score of a detection from which on it may be a new object; known ones need none"
    )
    confirm_frames: int = Field(3, ge=1, le=30, description="frames in a row that must show a new object before it is reported")
    keep_s: float = Field(0.7, ge=0, le=10, description="for how long an object that is no longer found is kept, where it ought to be")
    confidence_s: float = Field(0.15, ge=0, le=10, description="time constant of the filter from scores to confidence; 0: none")


@dataclass(frozen=True, eq=False)
class Tracks:
    """All tracks after a frame; n of them, C classes.

    number: `[n]`, the identity. mean: `[n, 4, 2]`, u and v of the foot, log width, log height, and their rates a second. covariance:
    `[n, 4, 2, 2]`. frames: `[n]` that showed it. since_s, seen_s, until_s: `[n]`, when it was confirmed, last found and lost; inf: not
    yet. confidence: `[n, C]`, filtered. score: `[n, C]` in this frame, NaN where it was not found.
    """

    classes: tuple[Category, ...]
    time_s: float
    number: Tensor
    mean: Tensor
    covariance: Tensor
    frames: Tensor
    since_s: Tensor
    seen_s: Tensor
    until_s: Tensor
    confidence: Tensor
    score: Tensor
    following: int = 1

    def __len__(self) -> int:
        return len(self.number)

    def take(self, which: Tensor) -> "Tracks":
        """Those of indices or of a mask."""
        return replace(self, **{name: getattr(self, name)[which] for name in EACH})

    @property
    def known(self) -> "Tracks":
        """Those that are confirmed, the lost ones among them."""
        return self.take(self.since_s.isfinite())

    @property
    def boxes(self) -> Tensor:
        """`[n, 4]` px: left, top, right, bottom."""
        u, v, log_width, log_height = self.mean[..., 0].unbind(-1)
        half, height = log_width.exp() / 2, log_height.exp()
        return torch.stack([u - half, v - height, u + half, v], -1)

    @property
    def category(self) -> Tensor:
        """`[n]`, index of the class of most confidence."""
        return self.confidence.argmax(-1)

    def at(self, time_s: float) -> "Tracks":
        """Where they will be, by their rates; a lost one stays where it was lost."""
        dt = (time_s - self.time_s) * self.until_s.isinf().double()[:, None]
        changes = _noise(self.mean, CHANGES)
        a, b, c = self.covariance[..., 0, 0], self.covariance[..., 0, 1], self.covariance[..., 1, 1]
        ahead = a + 2 * dt * b + dt**2 * c + changes * dt**3 / 3
        both, rate = b + dt * c + changes * dt**2 / 2, c + changes * dt
        covariance = torch.stack([torch.stack([ahead, both], -1), torch.stack([both, rate], -1)], -2)
        mean = torch.stack([self.mean[..., 0] + dt * self.mean[..., 1], self.mean[..., 1]], -1)
        return replace(self, time_s=time_s, mean=mean, covariance=covariance)


EACH = ("number", "mean", "covariance", "frames", "since_s", "seen_s", "until_s", "confidence", "score")


def no_tracks(classes: tuple[Category, ...]) -> Tracks:
    """The state before the first frame."""
    none, each_class = torch.zeros(0, dtype=torch.float64), torch.zeros(0, len(classes), dtype=torch.float64)
    count = torch.zeros(0, dtype=torch.int64)
    mean, covariance = torch.zeros(0, 4, 2, dtype=torch.float64), torch.zeros(0, 4, 2, 2, dtype=torch.float64)
    return Tracks(classes, 0.0, count, mean, covariance, count, none, none, none, each_class, each_class)


def track(tracks: Tracks, found: Detections, time_s: float, params: TrackerParams) -> Tracks:
    """The tracks after a frame at a later time, in which these detections were found."""
    found = Detections(found.boxes.detach().double().cpu(), found.scores.detach().double().cpu())
    alive = tracks.at(time_s).take(tracks.until_s.isinf())
    lost = tracks.take(tracks.until_s.isfinite() & (time_s - tracks.until_s < LINGER_S))
    mine, its = assigned(alive, found)
    score = torch.full_like(alive.score, math.nan).index_copy(0, mine, found.scores[its])
    share = 1.0 if params.confidence_s == 0 else -math.expm1(-(time_s - tracks.time_s) / params.confidence_s)
    confidence = alive.confidence + share * (score.nan_to_num() - alive.confidence)
    alive = replace(_corrected(alive, mine, found.boxes[its]), score=score, confidence=confidence)
    shown = torch.zeros(len(alive), dtype=torch.bool).index_fill(0, mine, True)
    alive = replace(alive, frames=alive.frames + shown, seen_s=torch.where(shown, time_s, alive.seen_s))
    confirmed = shown & (alive.frames >= params.confirm_frames) & alive.since_s.isinf()
    gone = ~shown & (time_s - alive.seen_s > params.keep_s)
    alive = replace(alive, since_s=torch.where(confirmed, time_s, alive.since_s), until_s=torch.where(gone, time_s, alive.until_s))
    alive = alive.take(shown | alive.since_s.isfinite())
    left = torch.ones(len(found), dtype=torch.bool).index_fill(0, its, False) & (found.scores.amax(-1) >= params.start_score)
    return _joined(lost, alive, _started(tracks, Detections(found.boxes[left], found.scores[left]), time_s, params))


def assigned(tracks: Tracks, found: Detections) -> tuple[Tensor, Tensor]:
    """Indices `[k]` of tracks, and `[k]` of the detections that are theirs."""
    if not len(tracks) or not len(found):
        return torch.zeros(0, dtype=torch.int64), torch.zeros(0, dtype=torch.int64)
    off = _measured(found.boxes)[None] - tracks.mean[:, None, :, 0]
    spread = tracks.covariance[:, None, :, 0, 0] + _noise(tracks.mean, MEASURED)[:, None]
    far = (off[..., :2] ** 2).sum(-1).sqrt() / _size(tracks.mean)[:, None]
    likeness = found.scores[:, tracks.category].T / found.scores.amax(-1).clamp(min=1e-9)
    cost = 1 - overlaps(tracks.boxes, found.boxes) + far + OTHER_CLASS * (1 - likeness)
    impossible = (off[..., :2] ** 2 > GATE**2 * spread[..., :2]).any(-1) | (far > FARTHEST)
    cost = torch.where(impossible, LARGEST_COST, cost.clamp(max=LARGEST_COST))
    rows, columns = (torch.from_numpy(each) for each in linear_sum_assignment(cost.numpy()))
    possible = cost[rows, columns] < LARGEST_COST
    return rows[possible], columns[possible]


def _corrected(tracks: Tracks, which: Tensor, boxes: Tensor) -> Tracks:
    """Kalman's step for some of the tracks."""
    before, mean = tracks.covariance[which], tracks.mean[which]
    spread = before[..., 0, 0] + _noise(mean, MEASURED)
    gain = before[..., 0] / spread[..., None]
    off = _measured(boxes) - mean[..., 0]
    after = before - gain[..., :, None] * gain[..., None, :] * spread[..., None, None]
    return replace(
        tracks,
        mean=tracks.mean.index_copy(0, which, mean + gain * off[..., None]),
        covariance=tracks.covariance.index_copy(0, which, after),
    )


def _started(tracks: Tracks, found: Detections, time_s: float, params: TrackerParams) -> Tracks:
    n = len(found)
    at = _measured(found.boxes)
    mean = torch.stack([at, torch.zeros_like(at)], -1)
    covariance = torch.diag_embed(torch.stack([_noise(mean, MEASURED), _noise(mean, STARTS)], -1))
    now, never = (torch.full((n,), each, dtype=torch.float64) for each in (time_s, math.inf))
    return Tracks(
        tracks.classes,
        time_s,
        torch.arange(tracks.following, tracks.following + n),
        mean,
        covariance,
        torch.ones(n, dtype=torch.int64),
        now if params.confirm_frames == 1 else never,
        now,
        never,
        found.scores,
        found.scores,
        tracks.following + n,
    )


def _joined(lost: Tracks, alive: Tracks, started: Tracks) -> Tracks:
    lost = replace(lost, score=torch.full_like(lost.score, math.nan))
    values: dict[str, Any] = {name: torch.cat([getattr(each, name) for each in (lost, alive, started)]) for name in EACH}
    return replace(started, **values)


def _measured(boxes: Tensor) -> Tensor:
    """`[n, 4]`: u and v of the foot, log width and log height of boxes `[n, 4]`."""
    left, top, right, bottom = boxes.unbind(-1)
    return torch.stack([(left + right) / 2, bottom, (right - left).clamp(min=1).log(), (bottom - top).clamp(min=1).log()], -1)


def _size(mean: Tensor) -> Tensor:
    return (mean[..., 2:, 0].sum(-1) / 2).exp()


def _noise(mean: Tensor, deviations: tuple[float, ...]) -> Tensor:
    """Variances `[n, 4]`, of u and v in px^2; deviations are in sizes."""
    size = _size(mean)
    one = torch.ones_like(size)
    return (torch.tensor(deviations, dtype=torch.float64) * torch.stack([size, size, one, one], -1)) ** 2
