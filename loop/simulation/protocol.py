"""The plant interface: a plant shows light, exposes frames and owns time. The loop knows the world only through its plant."""

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
    """Light captured in one frame.

    number: ascending and unique. start_s, duration_s: start and duration of the light in s. lights: utilisations, one a module, base
    beams included. projections: closed-loop symbols in these lights, by name; a plant ignores them. commands: turn and dimming of each
    module; empty if all are at rest. frame: whether the camera takes a frame.
    """

    number: int
    start_s: float
    duration_s: float
    lights: tuple[Utilisation, ...]
    projections: Mapping[str, ProjectionCommand] = field(default_factory=dict)
    commands: Commands = ()
    frame: bool = True


@dataclass(frozen=True, eq=False)
class Frame:
    """An arrived or lost frame.

    number: of its exposure. taken_s: capture time in s. arrived_s: arrival time in s. image: digital numbers `[height, width]`, None if
    lost. shown: the exposure in the frame, None if it equals the commanded exposure.
    """

    number: int
    taken_s: float
    arrived_s: float
    image: Tensor | None
    shown: Exposure | None = None


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Frames, samples and objects that arrived by the end of an exposure, or before the first one.

    time_s: start of the next exposure in s. frames: by ascending number. samples: of the vehicle's sensors, empty for a
    standing vehicle. objects: reported objects in the ground frame, for lighting functions without a detector; None without a report.
    """

    time_s: float
    frames: tuple[Frame, ...] = ()
    samples: tuple[Sample, ...] = ()
    objects: Objects | None = None


class Plant(Protocol):
    """A plant, with its state as a value. A hardware plant holds the connection and returns the known state.

    Frames arrive in the order of their exposures. The plant's clock may begin at any time; a scenario's times count from the arrivals of
    `start`. A plant that knows the truth has an attribute `truth`, a `luxloop.loop.simulation.world.World` with time from `start`. A plant
    with open resources has a method `close`, called at the end of a run.
    """

    def start(self) -> tuple[Any, Arrivals]:
        """State and arrivals before the first exposure."""
        ...

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Show an exposure; returns state and arrivals at its end."""
        ...


def close_plant(plant: Plant) -> None:
    """Close a plant that has a method `close`."""
    getattr(plant, "close", lambda: None)()


Images = tuple[Tensor, Tensor]  # on and off frame
LOST = Frame(-1, math.nan, math.nan, None)


@dataclass(frozen=True, eq=False)
class ExposurePair:
    """On and off exposure of a step, with their frames, `LOST` until they arrive.

    ego: estimated motion for which symbols were drawn. alone: whether a symbol was the only lighting function.
    """

    on: Exposure
    off: Exposure
    ego: Ego | None
    alone: bool
    frames: tuple[Frame, Frame] = (LOST, LOST)

    @property
    def images(self) -> Images | None:
        """Images of on and off frame; None if either is lost."""
        on, off = (frame.image for frame in self.frames)
        return None if on is None or off is None else (on, off)

    @property
    def taken_s(self) -> float:
        """Time in s of the on frame; NaN if either frame is lost."""
        return math.nan if self.images is None else self.frames[0].taken_s

    def measures(self, name: str) -> bool:
        """Whether a symbol is in the on exposure only."""
        return name in self.on.projections and name not in self.off.projections

    def seen_in(self, on: Frame, off: Frame) -> "ExposurePair":
        """The pair with its frames, and commanded exposures replaced by those that the plant reports."""
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
    """Completed pairs, at least the oldest; pairs awaiting frames; arrived frames of the awaiting pairs.

    Frames arrive in order, so frames missing before the last complete pair are lost. Without a complete pair, the oldest is returned
    without frames and stays in the awaiting pairs.
    """
    came = {frame.number: frame for frame in frames}
    numbers = [(pair.on.number, pair.off.number) for pair in awaiting]
    done = max((k + 1 for k, (on, off) in enumerate(numbers) if on in came and off in came), default=0)
    pairs = [pair.seen_in(came.get(on, LOST), came.get(off, LOST)) for pair, (on, off) in zip(awaiting[:done], numbers, strict=False)]
    left = tuple(awaiting[done:])
    awaited = {number for both in numbers[done:] for number in both}
    return pairs or [left[0]], left, tuple(frame for frame in frames if frame.number in awaited)
