"""The trackers that a scenario can name."""

from dataclasses import dataclass
from typing import Annotated, Any

import torch
from pydantic import Field
from torch import Tensor

from luxloop.perception.detection.detector import Detections
from luxloop.perception.tracking import ObjectTracker, TrackedBoxes, Tracker, TrackerParams
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import View
from luxloop.world.params import PositiveShare
from luxloop.world.plugin import KnownOrOwn
from luxloop.world.traffic.tracked import Category

KEY = "tracker.kind"
METHODS = ("start", "follow", "report")


class OwnTracker(plugin.OwnPart):
    """A user-defined tracker: `Name(classes, view, **options)`."""

    start_score: PositiveShare = Field(
        0.5, description="score from which a detection without an object counts as false positive in reports"
    )


AnyTracker = Annotated[
    TrackerParams | OwnTracker,
    KnownOrOwn("kind", "kalman"),
]


def tracker(params: TrackerParams | OwnTracker, classes: tuple[Category, ...], view: View) -> ObjectTracker:
    """The tracker of a scenario. Raises LuxloopError if a user-defined one cannot be made."""
    if isinstance(params, TrackerParams):
        return Tracker(classes, view, params)
    return own_tracker(plugin.load(params.kind, KEY, METHODS), params, classes, view)


def own_tracker(made_by: type, params: OwnTracker, classes: tuple[Category, ...], view: View) -> "CheckedTracker":
    """A user-defined tracker of a class with the methods. Raises LuxloopError if it cannot be made."""
    return CheckedTracker(plugin.construct(made_by, params.kind, KEY, {"classes": classes, "view": view}, params.options), classes)


@dataclass(frozen=True)
class CheckedTracker:
    """A user-defined tracker whose reports are checked. classes: the detector's."""

    own: plugin.Guard
    classes: tuple[Category, ...]

    def start(self) -> Any:
        """The tracker's state."""
        return self.own.start()

    def follow(self, state: Any, found: Detections, frame: Tensor, time_s: float) -> Any:
        """The tracker's state after a frame."""
        return self.own.follow(state, found, frame, time_s)

    def report(self, state: Any, time_s: float) -> TrackedBoxes:
        """The tracker's report on the CPU in double precision. Raises LuxloopError for an invalid report."""
        return self.check(self.own.report(state, time_s))

    def check(self, told: Any) -> TrackedBoxes:
        """A report on the CPU in double precision. Raises LuxloopError for an invalid report."""
        where, all_classes = f"{KEY}: {self.own.name}: report", len(self.classes)
        if not isinstance(told, TrackedBoxes):
            raise LuxloopError(f"{where} gives a {type(told).__name__}; it must give luxloop.TrackedBoxes")
        n = len(told)
        shapes = dict.fromkeys(("number", "category", "since_s", "until_s"), (n,)) | {"boxes": (n, 4)}
        for name, shape in {**shapes, "confidence": (n, all_classes), "score": (n, all_classes)}.items():
            if tuple(getattr(told, name).shape) != shape:
                raise LuxloopError(
                    f"{where} gives {name} {list(getattr(told, name).shape)} for {n} tracks and {all_classes} classes; give {list(shape)}"
                )
        for name in ("number", "category"):
            if (dtype := getattr(told, name).dtype) != torch.int64:
                raise LuxloopError(f"{where} gives {name} as {dtype}; give torch.int64, with dtype=torch.int64 or to(torch.int64)")
        if n and int(told.number.min()) < 1:
            raise LuxloopError(f"{where} gives the numbers {told.number.tolist()}; number tracks from 1 on")
        if bool(told.since_s.isnan().any() or told.until_s.isnan().any()):
            raise LuxloopError(f"{where} gives NaN as a time; give since_s in s, and until_s = inf for a track that is not lost")
        if not all(bool(each.isfinite().all()) for each in (told.boxes, told.confidence)):
            raise LuxloopError(f"{where} gives boxes or confidence that are not finite; only score may be NaN, where nothing was found")
        if len(set(told.number.tolist())) < n:
            raise LuxloopError(f"{where} gives the same number to several tracks, {told.number.tolist()}; number each new one higher")
        if n and not 0 <= int(told.category.min()) <= int(told.category.max()) < all_classes:
            raise LuxloopError(f"{where} gives category {told.category.tolist()}; give indices of its {all_classes} classes, from 0 on")
        values = (each.detach().cpu() for each in vars(told).values())
        return TrackedBoxes(*(each.double() if each.is_floating_point() else each for each in values))
