"""What every plant is: it shows light, exposes frames of it and owns time. The loop knows nothing else of the world."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import TrackedObject
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.perception.egomotion import Ego, Sample
from luxloop.world.headlight.lamp import Commands

Objects = tuple[TrackedObject, ...]


@dataclass(frozen=True, eq=False)
class Exposure:
    """Light that is shown for `duration_s` s from `start_s` s on, with one frame of it.

    number: ascending, never used twice. lights: utilisations, one a module, base beams included. projections: of the symbols in these
    lights that controllers hold, by name; a plant has no use for them. commands: how modules are turned and dimmed, one a module; empty
    where all are at rest.
    """

    number: int
    start_s: float
    duration_s: float
    lights: tuple[Utilisation, ...]
    projections: Mapping[str, ProjectionCommand] = field(default_factory=dict)
    commands: Commands = ()


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame that has come, or word that it is lost.

    number: of its exposure. taken_s, arrived_s: times in s. image: digital numbers `[height, width]`, None where it is lost. shown: what it
    shows where that is not what was asked for, None where it is.
    """

    number: int
    taken_s: float
    arrived_s: float
    image: Tensor | None
    shown: Exposure | None = None


@dataclass(frozen=True, eq=False)
class Arrivals:
    """What has come in by `time_s` s, when the next exposure begins.

    frames: by ascending number. samples: of the vehicle's sensors, none of a vehicle that stands. objects: that functions act on where no
    detector finds them, in the ground frame; None where the plant tells nothing of them.
    """

    time_s: float
    frames: tuple[Frame, ...] = ()
    samples: tuple[Sample, ...] = ()
    objects: Objects | None = None


class Plant(Protocol):
    """Its state is a value; a plant of hardware holds the connection and returns what is known of it.

    Frames come in the order of their exposures. Its clock may begin at any time; a scenario's times count from the arrivals of `start`.
    One that knows the truth has an attribute `truth`, a `luxloop.loop.simulation.world.World`, whose time counts from there as well. One
    that holds something open has a method `close`, called at the end of a run.
    """

    def start(self) -> tuple[Any, Arrivals]:
        """State and arrivals before the first exposure."""
        ...

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Show an exposure; what has come in by its end."""
        ...


def close_plant(plant: Plant) -> None:
    """End what a plant holds open, if it does."""
    getattr(plant, "close", lambda: None)()


Images = tuple[Tensor, Tensor]  # of an on and an off frame
LOST = Frame(-1, math.nan, math.nan, None)


@dataclass(frozen=True, eq=False)
class ExposurePair:
    """On and off exposure of a step, and their frames, lost until they come.

    ego: the motion with which symbols were drawn. alone: whether nothing else was drawn or masked.
    """

    on: Exposure
    off: Exposure
    ego: Ego | None
    alone: bool
    frames: tuple[Frame, Frame] = (LOST, LOST)

    @property
    def images(self) -> Images | None:
        """Of on and off frame; None where one is lost."""
        on, off = (frame.image for frame in self.frames)
        return None if on is None or off is None else (on, off)

    @property
    def taken_s(self) -> float:
        """When the on frame was taken; NaN where one is lost."""
        return math.nan if self.images is None else self.frames[0].taken_s

    def measures(self, name: str) -> bool:
        """Whether a symbol is in the on exposure and not in the off exposure."""
        return name in self.on.projections and name not in self.off.projections

    def seen_in(self, on: Frame, off: Frame) -> "ExposurePair":
        """The pair with its frames: exposures as commanded, replaced by what the plant reports."""
        whole = on.shown is not None and off.shown is not None and bool(on.shown.projections)

        def exposure(commanded: Exposure, shown: Exposure | None) -> Exposure:
            if shown is None:
                return commanded
            return shown if whole else replace(commanded, lights=shown.lights)

        alone = self.alone and on.shown is None and off.shown is None
        return replace(self, on=exposure(self.on, on.shown), off=exposure(self.off, off.shown), alone=alone, frames=(on, off))


def pair_frames(
    awaiting: Sequence[ExposurePair], frames: Sequence[Frame]
) -> tuple[list[ExposurePair], tuple[ExposurePair, ...], tuple[Frame, ...]]:
    """Pairs whose frames have come or are lost, at least the oldest; pairs that await frames; frames of those so far.

    Frames come in the order of their exposures: all before the last pair that has come are lost. Where none has come, the oldest pair is
    returned as lost, and goes on waiting.
    """
    came = {frame.number: frame for frame in frames}
    numbers = [(pair.on.number, pair.on.number + 1) for pair in awaiting]
    done = max((k + 1 for k, (on, off) in enumerate(numbers) if on in came and off in came), default=0)
    pairs = [pair.seen_in(came.get(on, LOST), came.get(off, LOST)) for pair, (on, off) in zip(awaiting[:done], numbers, strict=False)]
    left = tuple(awaiting[done:])
    awaited = {number for both in numbers[done:] for number in both}
    return pairs or [left[0]], left, tuple(frame for frame in frames if frame.number in awaited)
