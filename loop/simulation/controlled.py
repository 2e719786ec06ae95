"""Symbols among the lighting functions that a controller holds straight: what is measured of them, and what is drawn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.controllers.pixels.primitives import Primitives, concatenate
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import LAYERS
from luxloop.controllers.symbol import ControllerParams, build_controller
from luxloop.controllers.symbol.heights.feedforward import OpenLoopParams
from luxloop.controllers.symbol.sensing.field import cut
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import Projector
from luxloop.controllers.symbol.sensing.protocol import Observation, Projection, SymbolController
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement, SymbolSensor
from luxloop.loop.simulation.feasible import brightness
from luxloop.loop.simulation.judging import Judge
from luxloop.loop.simulation.pairing import Arrived
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import Crop, ExtractionStatus
from luxloop.perception.metrics import Metrics

Frames = tuple[Tensor, Tensor]
SAME = 1e-4  # of a utilisation, which more than rounding changes


@dataclass(frozen=True)
class HeldState:
    """controller: its state. turn: step in which it was measured last.

    shape: `[4]` of the road on which it was seen, None for the flat one.
    """

    controller: Any
    turn: int = -1
    shape: Tensor | None = None


@dataclass(frozen=True, eq=False)
class Held:
    """A symbol in one step. projection: what was shown. cut: `[4]`, shares beyond the borders of the lamps' field
    (`luxloop.controllers.symbol.sensing.field`). measurement: what was made of the newest frames. verdict: None where nobody judged.
    """

    projection: ProjectionCommand
    cut: Tensor
    measurement: Measurement
    verdict: Metrics | None

    @property
    def pose(self) -> Tensor:
        """`[4]` = x, y in m, roll, pitch in rad."""
        return self.projection.pose

    @property
    def z(self) -> Tensor:
        """`[]` m, height of its centre above the assumed road."""
        return torch.zeros_like(self.pose[0]) if self.projection.z is None else self.projection.z

    @property
    def aim(self) -> Tensor:
        """`[2]`, x and y in m where it lies in place of its target, NaN for the target."""
        return torch.full_like(self.pose[:2], torch.nan) if self.projection.aim is None else self.projection.aim.to(self.pose)


@dataclass(frozen=True, eq=False)
class Moment:
    """What was shown in a step. projections: of the symbols, by name. measured: names of those that are off in the off exposure.

    on, off: lights of all modules. ego: the motion with which they were drawn. alone: whether nothing else was drawn or masked.
    """

    projections: Mapping[str, ProjectionCommand]
    measured: tuple[str, ...]
    on: tuple[Utilisation, ...]
    off: tuple[Utilisation, ...]
    ego: Ego | None
    alone: bool

    def as_shown(self, arrived: Arrived["Moment"]) -> "Moment":
        """As asked for, unless a frame says otherwise."""
        on, off = arrived.on.shown, arrived.off.shown
        moment = self if off is None else replace(self, off=off.lights, alone=False)
        if on is None:
            return moment
        moment = replace(moment, on=on.lights, alone=False)
        if off is None or not on.projections:
            return moment
        measured = tuple(name for name in on.projections if name not in off.projections)
        return replace(moment, projections=on.projections, measured=measured)


@dataclass(frozen=True, eq=False)
class ControlledSymbol:
    """A symbol that is held.

    drawn_by: indices of the car's modules that draw it. judge: None where the plant does not know the truth.
    """

    function: SymbolFunctionParams
    drawn_by: tuple[int, ...]
    sensor: SymbolSensor
    controller: SymbolController
    judge: Judge | None

    @property
    def params(self) -> ControllerParams:
        """Of its controller."""
        assert self.function.controller is not None
        return self.function.controller

    @property
    def projector(self) -> Projector:
        """What draws it."""
        return self.sensor.projector

    @cached_property
    def brightness(self) -> Tensor:
        """Median luminance `[]` in cd/m^2 at its target on a flat road."""
        return brightness(self.sensor, self.judge)

    def in_open_loop(self) -> "ControlledSymbol":
        """The same without control: drawn at its target for a flat road."""
        return replace(self, controller=build_controller(OpenLoopParams(), self.sensor))

    def start(self) -> HeldState:
        """Before anything is seen."""
        return HeldState(self.controller.start(self.function.start_pose.pose.to(self.projector.target)))

    def command(self, projection: ProjectionCommand, T_ground_body: Tensor | None) -> tuple[Primitives, ...]:
        """What a projection asks of the modules, in the ground frame; nothing of one that is all pixels.

        T_ground_body: `[4, 4]`, None of a body that stands level.
        """
        if projection.raw is not None:
            return ()
        function, parts = self.function, []
        for module, primitive in zip(self.projector.modules, self.projector.primitives(projection, clear=True), strict=True):
            drawn = replace(
                primitive,
                weight=torch.full_like(primitive.weight, function.weight),
                forced=torch.full_like(primitive.forced, function.forced),
                priority=torch.full_like(primitive.priority, function.priority * LAYERS),
                modules=((module.name,),),
                shared=torch.zeros_like(primitive.shared),
            )
            parts.append(drawn if T_ground_body is None else drawn.transform(T_ground_body))
        return (concatenate(*parts),)

    def light(self, on: Sequence[Utilisation], off: Sequence[Utilisation]) -> tuple[Utilisation, ...]:
        """What the symbol adds to the base beams that its controller believes in, one a module that draws it.

        on, off: of all modules with the symbol and without it.
        """
        beams = zip(self.drawn_by, self.projector.resting, strict=True)  # the same as off where nothing else shines
        return tuple(on[k] if off[k].u is beam.u else Utilisation(beam.u + on[k].u - off[k].u) for k, beam in beams)

    def step(self, state: HeldState, name: str, moment: Moment, images: Frames | None, ego: Ego | None) -> tuple[HeldState, Measurement]:
        """Measure the frames of a moment that shows it, None where they are lost, and control. name: its own."""
        shown = Projection(moment.projections[name], self.light(moment.on, moment.off), moment.ego)
        frames = images if name in moment.measured else None
        taken = None if moment.alone or frames is None else self._taken(shown)
        if taken is not None and not bool(taken.isfinite().all()):
            frames, seen = None, replace(self.sensor.lost(shown.projection.pose, ExtractionStatus.COVERED), shape=state.shape)
        else:
            seen = self.sensor.measure(frames, shown.projection, shown.lights, state.shape if ego is None or ego.stands else None)
            if taken is not None and seen.code == ExtractionStatus.SEEN:
                errors = seen.errors - taken
                seen = replace(seen, errors=errors, pose_error=self.sensor.pose_error(errors))
        return HeldState(self.controller.step(state.controller, Observation(seen, frames, shown, ego)), state.turn, seen.shape), seen

    def _taken(self, shown: Projection) -> Tensor | None:
        """By how much other functions move the features `[4]` of the symbol where they take of its light or lay theirs over it, NaN where
        they leave too little of it to be measured; None where they do not, or where the flat road would not show it anyway.
        """
        alone = self.projector.draw(shown.projection)
        if all(torch.allclose(a.u, b.u, rtol=0, atol=SAME) for a, b in zip(shown.lights, alone, strict=True)):
            return None
        left, whole = (self.sensor.render(shown.projection, lights) for lights in (shown.lights, alone))
        return left - whole if bool(whole.isfinite().all()) else None

    def held(self, projection: ProjectionCommand, seen: Measurement | None, verdict: Metrics | None) -> Held:
        """What is recorded of a step; seen: None where no frame shows it yet."""
        seen = self.sensor.lost(projection.pose, ExtractionStatus.NO_FRAME) if seen is None else seen
        return Held(projection, cut(self.projector, projection), seen, verdict)

    def footprint(self, projection: ProjectionCommand) -> Crop:
        """Where the camera may see a projection."""
        return self.projector.footprint(projection, self.sensor.model.eye.view, self.sensor.params.footprint_margin_m)


def turn(
    symbols: Mapping[str, ControlledSymbol], states: Mapping[str, HeldState], projections: Mapping[str, ProjectionCommand]
) -> tuple[str, ...]:
    """Names of the symbols to be measured together: those that have waited longest, no two in one part of the image."""
    if len(projections) < 2:
        return tuple(projections)
    taken: dict[str, Crop] = {}
    for name in sorted(projections, key=lambda name: (states[name].turn, name)):
        where = symbols[name].footprint(projections[name])
        if not any(_meet(where, other) for other in taken.values()):
            taken[name] = where
    return tuple(taken)


def _meet(a: Crop, b: Crop) -> bool:
    return a.u_start < b.u_stop and b.u_start < a.u_stop and a.v_start < b.v_stop and b.v_start < a.v_stop
