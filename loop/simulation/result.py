"""What the acts of a step hand on, what happened in it, and what is known before the next."""

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from luxloop.controllers.functions.commands import FunctionCommands
from luxloop.controllers.functions.planner import Plan, States
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import Situation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.scenario.model import only
from luxloop.loop.simulation.controlled import Frames, Held, HeldState, Moment
from luxloop.loop.simulation.detection import Recognised
from luxloop.loop.simulation.lamps import LampPower
from luxloop.loop.simulation.observed import ObservedSymbol
from luxloop.loop.simulation.on_materials import InZone, OnMaterial
from luxloop.loop.simulation.on_objects import OnObject
from luxloop.loop.simulation.pairing import UnderWay
from luxloop.loop.simulation.protocol import Arrivals, Frame, Showing
from luxloop.perception.detection.detector import Detections
from luxloop.perception.egomotion import Ego, Samples
from luxloop.perception.tracking import TrackedBoxes
from luxloop.world.frames import View
from luxloop.world.partial import PartialImage

OUTSIDE = ("plant", "look")  # parts of a step that no car computes


Lights = tuple[Utilisation, ...]  # of all modules
Parts = Mapping[str, Sequence[Primitives]]  # that functions draw, by name
Projections = Mapping[str, ProjectionCommand]  # of the symbols that are shown, by name


@dataclass(frozen=True, eq=False)
class StepPlan:
    """What is to be lit. ego, now: motion and situation. projections: by symbol. drawn: primitives by function.

    measured: names of the symbols that are off in all exposures but the first. plans: with all symbols, and without the measured ones.
    """

    ego: Ego | None
    now: Situation
    projections: Projections
    drawn: Parts
    measured: tuple[str, ...]
    plans: tuple[Plan, ...]


@dataclass(frozen=True, eq=False)
class StepDrive:
    """exposures: utilisations of each. projections: symbols that each shows. powers: of each plan, by the lamps' sides."""

    exposures: tuple[Lights, ...]
    projections: tuple[Projections, ...]
    powers: tuple[Mapping[str, LampPower], ...]


@dataclass(frozen=True, eq=False)
class Reception:
    """What the plant gave for the exposures of a step. plant: its state. samples: the newest of each sensor.

    frames: all that wait for their partner, of which `new` came in this step.
    """

    plant: Any
    arrivals: Arrivals
    samples: Samples
    frames: tuple[Frame, ...]
    new: tuple[Frame, ...]
    showings: tuple[Showing, ...]


@dataclass(frozen=True, eq=False)
class Perception:
    """What detector, tracker and learning functions know. view: of the camera from the ground frame, as the car believes.

    found, image: of the newest frame, None where none came; taken_s: its time, else that of the step. believed: views of the exposures
    whose frames have not come yet, by their number.
    """

    view: View
    tracks: Any
    functions: States
    found: Detections | None
    image: Tensor | None
    taken_s: float
    believed: Mapping[int, View]


@dataclass(frozen=True, eq=False)
class Control:
    """held: states of the controllers. measurements: of the symbols whose frames came. under_way, unpaired: exposures and frames that wait.

    frames: the newest on and off frame, taken at taken_s, None and NaN where none came.
    """

    held: Mapping[str, HeldState]
    measurements: Mapping[str, Measurement]
    under_way: UnderWay[Moment]
    unpaired: tuple[Frame, ...]
    frames: Frames | None
    taken_s: float


@dataclass(frozen=True, eq=False)
class SimulationState:
    """What the car knows before a step. tracks: the tracker's state, None without a detector. functions: what each of them has learnt.

    plant: its state. arrivals: what has come in by its beginning. samples: the newest of each of the vehicle's sensors.
    held: of each symbol that a controller holds. believed: views from the ground frame of the exposures whose frames have not come yet, by
    their number. under_way: what was shown whose frames have not come. frames: that have come without the other one of their pair.
    commanded: what functions commanded last, by name. oncoming_s: since when those who come towards the car have been near enough.
    """

    step: int
    tracks: Any
    functions: States
    plant: Any
    arrivals: Arrivals
    samples: Samples
    held: Mapping[str, HeldState]
    believed: Mapping[int, View] = field(default_factory=dict)
    under_way: UnderWay[Moment] = ()
    frames: tuple[Frame, ...] = ()
    commanded: Mapping[str, FunctionCommands] = field(default_factory=dict)
    oncoming_s: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FrameDetections:
    """What was found in the frame that came, nothing where none did, and the tracks at its time that are not lost.

    recognised: what is made of each object in sight, by its name. false_positives: detections of none that may be new objects, None where
    nobody knows. eyes_lx_max, eyes_lx_peak: most light of the lamps on heads and windscreens of road users, mean over time and
    highest, None where none are seen. oncoming_lx_max: mean over time, of those that come towards the car and are near enough (`oncoming`).
    """

    found: Detections
    tracks: TrackedBoxes
    recognised: Mapping[str, Recognised]
    false_positives: int | None
    eyes_lx_max: float | None
    eyes_lx_peak: float | None
    oncoming_lx_max: float | None


@dataclass(frozen=True)
class StepResult:
    """What happened in one step.

    now: what was known, and functions: what they had learnt, when the light was planned. view: of the camera from the ground frame then, as
    the car believed. masked: names of objects that must be dark. lights: utilisations `[n_p]`, one a module. powers: by the lamps' sides.
    illuminance: `[height, width]` lx from the lamps alone, and luminance: in cd/m^2 with all other light, as the camera sees them, computed
    where they are read; None where the plant does not know the truth, and the illuminance where nobody asks for it.
    frame: digital numbers of the newest frame that came in this step, None where none came. frames: the newest on and off frame that
    controllers got, taken at taken_s, NaN where none came. objects: by name, those that are there and have
    a category. look: None without a detector. symbols: those that are meant for an observer, from their eyes. held: those that controllers
    hold; zones, materials: all by name. road_lx_ratio_max: see `luxloop.loop.simulation.judging`, None where nobody judged. showings: the
    exposures. timings: ms by part. processing_ms: see `Clock`.
    """

    step: int
    time_s: float
    now: Situation
    view: View
    functions: States
    masked: frozenset[str]
    plan: Plan
    lights: tuple[Tensor, ...]
    powers: Mapping[str, LampPower]
    illuminance: Tensor | None
    luminance: Tensor | None
    frame: Tensor | None
    frames: Frames | None
    taken_s: float
    objects: Mapping[str, OnObject]
    look: FrameDetections | None
    symbols: tuple[ObservedSymbol, ...]
    held: Mapping[str, Held]
    zones: Mapping[str, InZone]
    materials: Mapping[str, OnMaterial]
    road_lx_ratio_max: float | None
    showings: tuple[Showing, ...]
    timings: Mapping[str, float]
    processing_ms: float

    @property
    def symbol(self) -> Held:
        """The only symbol that is shown and held. Raises LuxloopError where there are several or none."""
        return self.held[only(self.held)]

    @property
    def dark_lx_max(self) -> float | None:
        """The most light on any object that must be dark; None where nothing of any is in sight."""
        found = [each.lx_max for each in self.objects.values() if each.masked and each.pixels]
        return max(found, default=None)

    @property
    def symbol_iou_min(self) -> float | None:
        """The least overlap of a symbol with what its observer shall see; None where there is no such symbol."""
        return min((each.iou for each in self.symbols), default=None)


@dataclass(frozen=True)
class Rollout:
    """B runs of a symbol that is held.

    poses: `[B, steps, 4]` that were shown (x, y in m, roll, pitch in rad). errors: `[B, steps, 4]`, how far the symbol was seen to be
    off in the same units, 0 where it was lost. seen: `[B, steps]` bool, whether it was not.
    """

    poses: Tensor
    errors: Tensor
    seen: Tensor


class Clock:
    """Time by part. taken_ms: ms so far by the clock on the wall, by name. processing_ms: of the parts that the car computes, on the
    processor. What the plant computes of frames where they are read is its own time.
    """

    def __init__(self) -> None:
        self.taken_ms: dict[str, float] = {}
        self.processing_ms = 0.0
        self._last = _times_s()

    def lap(self, part: str) -> None:
        """Count the time since the last lap as that of a part."""
        times_s = _times_s()
        taken, worked, of_plant, worked_by_plant = (1e3 * (now - last) for now, last in zip(times_s, self._last, strict=True))
        for name, ms in ((part, taken - of_plant), ("plant", of_plant)):
            self.taken_ms[name] = self.taken_ms.get(name, 0.0) + ms
        self.processing_ms += 0.0 if part in OUTSIDE else worked - worked_by_plant
        self._last = times_s


def _times_s() -> tuple[float, ...]:
    return time.perf_counter(), time.thread_time(), *PartialImage.spent_s


def without(drawn: Parts, names: Collection[str]) -> dict[str, Sequence[Primitives]]:
    """What the other functions draw."""
    return {name: each for name, each in drawn.items() if name not in names}
