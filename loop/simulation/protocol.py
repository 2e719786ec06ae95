"""What every plant is: it shows light, exposes frames of it and owns time. The loop knows nothing else of the world."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import TrackedObject
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.perception.egomotion import Sample
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


@dataclass(frozen=True, eq=False)
class Showing:
    """An exposure, what had come in before it, and what by its end."""

    before: Arrivals
    exposure: Exposure
    after: Arrivals


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


@contextmanager
def closed(plant: Plant) -> Iterator[None]:
    """Close a plant that can be closed at the end of a block."""
    try:
        yield
    finally:
        getattr(plant, "close", lambda: None)()
