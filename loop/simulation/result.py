"""Values of a step's acts, the step's result, and the state before the next step."""

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from torch import Tensor

from luxloop.controllers.functions.commands import FunctionCommands
from luxloop.controllers.functions.planner import Plan, States
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import Situation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.scenario.model import only
from luxloop.loop.simulation.controlled import SymbolState
from luxloop.loop.simulation.lamps import LampPower
from luxloop.loop.simulation.protocol import Arrivals, Exposure, ExposurePair, Frame, Images
from luxloop.perception.detection.detector import Detections
from luxloop.perception.egomotion import Ego, Samples
from luxloop.world.caches import Part, PartialImage
from luxloop.world.frames import View

OUTSIDE = ("plant", "look")  # parts of a step that no car computes


Lights = tuple[Utilisation, ...]  # of all modules
Parts = Mapping[str, Sequence[Primitives]]  # that functions draw, by name
Projections = Mapping[str, ProjectionCommand]  # of the symbols that are shown, by name


@dataclass(frozen=True, eq=False)
class Sense:
    """Before a step: the car's motion, the situation with commanded modules, the view of the camera from the ground frame as the car
    believes, and what functions command, by name.
    """

    ego: Ego | None
    now: Situation
    view: View
    commands: Mapping[str, FunctionCommands]


@dataclass(frozen=True, eq=False)
class StepPlan:
    """Light of a step. functions: states of the functions that plan it. projections: by symbol. drawn: primitives by function.

    measured: names of the symbols that are off in all exposures but the first. plans: with all symbols, and without the measured ones.
    """

    functions: States
    projections: Projections
    drawn: Parts
    measured: tuple[str, ...]
    plans: tuple[Plan, ...]


@dataclass(frozen=True, eq=False)
class Drive:
    """exposures: utilisations of each. projections: symbols in each. powers: means over the step, by the lamps' sides."""

    exposures: tuple[Lights, ...]
    projections: tuple[Projections, ...]
    powers: Mapping[str, LampPower]


@dataclass(frozen=True, eq=False)
class Reception:
    """The exposures of a step, and what the plant gave for them. plant: its state. samples: the newest of each sensor.

    arrivals: before the first exposure, and by the end of each. frames: that came in this step. unpaired: those and all that wait for
    their partner.
    """

    plant: Any
    samples: Samples
    exposures: tuple[Exposure, ...]
    arrivals: tuple[Arrivals, ...]
    frames: tuple[Frame, ...]
    unpaired: tuple[Frame, ...]


@dataclass(frozen=True, eq=False)
class Perception:
    """What detector, tracker and learning functions know.

    found, image: of the newest frame, None where none came; taken_s: its time, else that of the step. views: as the car believes, of the
    exposures that await their frames, by number.
    """

    tracks: Any
    functions: States
    found: Detections | None
    image: Tensor | None
    taken_s: float
    views: Mapping[int, View]


@dataclass(frozen=True, eq=False)
class Control:
    """symbols: states of their controllers. measurements: of the symbols that are shown. awaiting, unpaired: exposures and frames without
    their partners.

    frames: the newest on and off frame, taken at taken_s, None and NaN where none came.
    """

    symbols: Mapping[str, SymbolState]
    measurements: Mapping[str, Measurement]
    awaiting: tuple[ExposurePair, ...]
    unpaired: tuple[Frame, ...]
    frames: Images | None
    taken_s: float


@dataclass(frozen=True, eq=False)
class SimulationState:
    """What the car knows before a step. tracks: the tracker's state, None without a detector. functions: what each of them has learnt.

    plant: its state. arrivals: what has come in by its beginning. samples: the newest of each of the vehicle's sensors.
    symbols: of each symbol that a controller holds. views: from the ground frame of the exposures that await their frames, by number.
    awaiting: exposures without frames. unpaired: frames without the other one of their pair. commanded: what functions commanded last, by
    name.
    """

    step: int
    tracks: Any
    functions: States
    plant: Any
    arrivals: Arrivals
    samples: Samples
    symbols: Mapping[str, SymbolState]
    views: Mapping[int, View] = field(default_factory=dict)
    awaiting: tuple[ExposurePair, ...] = ()
    unpaired: tuple[Frame, ...] = ()
    commanded: Mapping[str, FunctionCommands] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class StepResult:
    """What happened in a step, by its acts.

    lights: utilisations `[n_p]` of the first exposure, one a module. powers: by the lamps' sides. timings: ms by part. processing_ms: see
    `Clock`. Figures that need the truth are an `luxloop.loop.simulation.evaluator.Evaluation`.
    """

    step: int
    sense: Sense
    planning: StepPlan
    lights: tuple[Tensor, ...]
    powers: Mapping[str, LampPower]
    reception: Reception
    perception: Perception
    control: Control
    timings: Mapping[str, float]
    processing_ms: float

    @property
    def now(self) -> Situation:
        """What was known when the light was planned."""
        return self.sense.now

    @property
    def time_s(self) -> float:
        """Time since the start of the scenario."""
        return self.sense.now.time_s

    @property
    def plan(self) -> Plan:
        """The light of the first exposure, with all symbols."""
        return self.planning.plans[0]

    @property
    def exposures(self) -> tuple[Exposure, ...]:
        """Those of the step, in their order."""
        return self.reception.exposures

    @property
    def frame(self) -> Tensor | None:
        """Digital numbers `[height, width]` of the newest frame that came in this step, None where none came."""
        return self.perception.image

    @property
    def frames(self) -> Images | None:
        """The newest on and off frame that controllers got, None where none came."""
        return self.control.frames

    @property
    def measurement(self) -> Measurement:
        """Of the only symbol that is shown and held. Raises LuxloopError where there are several or none."""
        return self.control.measurements[only(self.control.measurements)]


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
    """Time by part. ms: so far by the clock on the wall, by name. processing_ms: of the parts that the car computes, on the processor."""

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}
        self.processing_ms = 0.0
        self._last, self._of_plant = _now_ms(), np.zeros(2)

    def watch(self, frames: Iterable[Frame]) -> None:
        """Count what is computed of frames where they are read as time of the plant."""
        for frame in frames:
            if isinstance(frame.image, PartialImage):
                frame.image.part_of = partial(self._compute, frame.image.part_of)

    def lap(self, part: str) -> None:
        """Count the time since the last lap as that of a part."""
        now, of_plant = _now_ms(), self._of_plant
        wall, worked = (now - self._last - of_plant).tolist()
        for name, ms in ((part, wall), ("plant", float(of_plant[0]))):
            self.ms[name] = self.ms.get(name, 0.0) + ms
        self.processing_ms += 0.0 if part in OUTSIDE else worked
        self._last, self._of_plant = now, np.zeros(2)

    def _compute(self, part_of: Callable[[Part], Tensor], part: Part) -> Tensor:
        began = _now_ms()
        pixels = part_of(part)
        self._of_plant += _now_ms() - began
        return pixels


def _now_ms() -> np.ndarray:
    """`[2]`: by the clock on the wall, and on the processor in this thread."""
    return 1e3 * np.array([time.perf_counter(), time.thread_time()])


def without(drawn: Parts, names: Collection[str]) -> dict[str, Sequence[Primitives]]:
    """What the other functions draw."""
    return {name: each for name, each in drawn.items() if name not in names}
