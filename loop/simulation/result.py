"""Results of the five acts of a step, the step's result, and the state before the next step."""

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.functions.commands import FunctionCommands
from luxloop.controllers.functions.planner import Plan, States
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.situation import Situation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.scenario.model import only
from luxloop.loop.simulation.controlled import SymbolState
from luxloop.loop.simulation.lamps import LampPower, Lights
from luxloop.loop.simulation.pixel_gain_loop import GainState
from luxloop.loop.simulation.protocol import Arrivals, Exposure, ExposurePair, Frame, Images
from luxloop.perception.detection.detector import Detections
from luxloop.perception.egomotion import Ego, Samples
from luxloop.world.caches import Part, PartialImage
from luxloop.world.frames import View
from luxloop.world.headlight.lamp import Commands

OUTSIDE = ("plant", "look")  # parts of a step that run outside a car


Parts = Mapping[str, Sequence[Primitives]]  # primitives by function
Projections = Mapping[str, ProjectionCommand]  # by symbol shown


@dataclass(frozen=True, eq=False)
class Sense:
    """Inputs of a step. ego: estimated motion. now: situation with commanded modules. view: estimated camera view in the ground frame.
    commands: module commands by function.
    """

    ego: Ego | None
    now: Situation
    view: View
    commands: Mapping[str, FunctionCommands]


@dataclass(frozen=True, eq=False)
class StepPlan:
    """Planned light of a step. functions: states of the lighting functions. symbols: controller states before the step. projections: by
    symbol. drawn: primitives by function.

    measured: names of symbols shown in the first exposure only. plans: with all symbols, and without the measured symbols.
    """

    functions: States
    symbols: Mapping[str, SymbolState]
    projections: Projections
    drawn: Parts
    measured: tuple[str, ...]
    plans: tuple[Plan, ...]


@dataclass(frozen=True, eq=False)
class Drive:
    """Lamp drive of an exposure. projections: symbols in the lights. powers: by lamp side."""

    lights: Lights
    projections: Projections
    commands: Commands
    powers: Mapping[str, LampPower]


@dataclass(frozen=True, eq=False)
class Reception:
    """Exposures of a step and the plant's response. plant: state of the plant. samples: recent ones.

    arrivals: before the first exposure, and by the end of each. powers: step means by lamp side. frames: arrived in this step. unpaired:
    these and earlier frames awaiting their on or off partner.
    """

    plant: Any
    samples: Samples
    exposures: tuple[Exposure, ...]
    arrivals: tuple[Arrivals, ...]
    powers: Mapping[str, LampPower]
    frames: tuple[Frame, ...]
    unpaired: tuple[Frame, ...]


@dataclass(frozen=True, eq=False)
class Perception:
    """State of detector, tracker and learning functions.

    found, image: detections in and pixels of the newest frame, None without a frame. taken_s: time of that frame, else of the step.
    views: estimated camera views of exposures awaiting their frames, by number.
    """

    tracks: Any
    functions: States
    found: Detections | None
    image: Tensor | None
    taken_s: float
    views: Mapping[int, View]


@dataclass(frozen=True, eq=False)
class Control:
    """Symbol control of a step. symbols: controller states. measurements: of symbols shown. awaiting: exposure pairs awaiting frames.

    unpaired: frames awaiting their on or off partner. frames: the newest on and off frame, None without frames. taken_s: time of the on
    frame, NaN without frames. gains: of the lamps' pixels.
    """

    symbols: Mapping[str, SymbolState]
    measurements: Mapping[str, Measurement]
    awaiting: tuple[ExposurePair, ...]
    unpaired: tuple[Frame, ...]
    frames: Images | None
    taken_s: float
    gains: GainState | None


@dataclass(frozen=True, eq=False)
class SimulationState:
    """State before a step. tracks: state of the tracker, None without a detector. functions: states of the lighting functions.

    plant: state of the plant. arrivals: the newest arrivals. samples: recent ones of the vehicle's sensors. symbols: states of the
    closed-loop symbols. views: estimated camera views in the ground frame of exposures awaiting frames, by number. awaiting: exposure
    pairs awaiting frames. unpaired: frames awaiting their on or off partner. commanded: last module commands by function. gains: of the
    lamps' pixels, None unless they are estimated.
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
    gains: GainState | None = None


@dataclass(frozen=True, eq=False)
class StepResult:
    """Result of a step, by act.

    lights: utilisations `[n_p]` of the first exposure, one a module. timings: wall-clock ms by part. processing_ms:
    see `Clock`. Metrics that need the truth are in `luxloop.loop.simulation.evaluator.Evaluation`.
    """

    step: int
    sense: Sense
    planning: StepPlan
    lights: tuple[Tensor, ...]
    reception: Reception
    perception: Perception
    control: Control
    timings: Mapping[str, float]
    processing_ms: float

    @property
    def now(self) -> Situation:
        """The situation for which the light was planned."""
        return self.sense.now

    @property
    def time_s(self) -> float:
        """Time in s since the start of the scenario."""
        return self.sense.now.time_s

    @property
    def plan(self) -> Plan:
        """The light of the first exposure, with all symbols."""
        return self.planning.plans[0]

    @property
    def exposures(self) -> tuple[Exposure, ...]:
        """Exposures of the step, in order."""
        return self.reception.exposures

    @property
    def powers(self) -> Mapping[str, LampPower]:
        """Means over the step by lamp side."""
        return self.reception.powers

    @property
    def off(self) -> Exposure:
        """The exposure of the last frame, without the measured symbols."""
        return [each for each in self.exposures if each.frame][-1]

    @property
    def frame(self) -> Tensor | None:
        """Digital numbers `[height, width]` of the newest frame of this step, None without a frame."""
        return self.perception.image

    @property
    def frames(self) -> Images | None:
        """The newest on and off frame for the controllers, None without frames."""
        return self.control.frames

    @property
    def measurement(self) -> Measurement:
        """Measurement of the only closed-loop symbol shown. Raises LuxloopError if there are several or none."""
        return self.control.measurements[only(self.control.measurements)]


def mean_lights(result: StepResult, shares: Sequence[float]) -> list[Tensor]:
    """Utilisations `[n_p]` of each module that an eye sees in a step: the mean over its exposures. shares: of time, of each exposure."""
    modules = zip(*(each.lights for each in result.exposures), strict=True)
    return [sum((share * each.u for share, each in zip(shares, lights, strict=True)), torch.zeros(())) for lights in modules]


@dataclass(frozen=True)
class Rollout:
    """B runs of a closed-loop symbol.

    poses: `[B, steps, 4]`, shown poses (x, y in m, roll, pitch in rad). errors: `[B, steps, 4]`, measured pose errors in the same units,
    0 for a lost symbol. seen: `[B, steps]` bool, whether the symbol was measured.
    """

    poses: Tensor
    errors: Tensor
    seen: Tensor


class Clock:
    """Times of a step's parts. ms: wall-clock time by part. processing_ms: CPU time of the parts that run in the car."""

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}
        self.processing_ms = 0.0
        self._last, self._of_plant = _now_ms(), np.zeros(2)

    def watch(self, frames: Iterable[Frame]) -> None:
        """Count the lazy computation of these frames as time of the plant."""
        for frame in frames:
            if isinstance(frame.image, PartialImage):
                frame.image.part_of = partial(self._compute, frame.image.part_of)

    def lap(self, part: str) -> None:
        """Add the time since the last lap to a part."""
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
    """Wall-clock time and CPU time of this thread in ms, `[2]`."""
    return 1e3 * np.array([time.perf_counter(), time.thread_time()])


def without(drawn: Parts, names: Collection[str]) -> dict[str, Sequence[Primitives]]:
    """Primitives without those of the named functions."""
    return {name: each for name, each in drawn.items() if name not in names}
