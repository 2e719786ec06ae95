"""Closed-loop symbols among the lighting functions: drawing, measurement and control."""

from collections.abc import Callable, Mapping, Sequence
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
from luxloop.controllers.symbol.heights.height_map import Belief
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import Projector
from luxloop.controllers.symbol.sensing.protocol import Observation, Projection, SymbolController
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement, SymbolSensor
from luxloop.loop.simulation.protocol import ExposurePair
from luxloop.loop.simulation.road_metrics import SymbolEvaluator
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.metrics import THRESHOLD
from luxloop.world.texels import Window

SAME = 1e-4  # difference of utilisations within rounding


@dataclass(frozen=True)
class SymbolState:
    """State of a symbol. controller: controller state. turn: step of the last measurement.

    shape: road shape `[4]` at the last measurement, None for a flat road.
    """

    controller: Any
    turn: int = -1
    shape: Tensor | None = None


@dataclass(frozen=True, eq=False)
class ControlledSymbol:
    """A closed-loop symbol.

    drawn_by: indices of the modules that draw the symbol. evaluator: None without the truth.
    """

    function: SymbolFunctionParams
    drawn_by: tuple[int, ...]
    sensor: SymbolSensor
    controller: SymbolController
    evaluator: SymbolEvaluator | None

    @property
    def params(self) -> ControllerParams:
        """Controller parameters."""
        assert self.function.controller is not None
        return self.function.controller

    @property
    def projector(self) -> Projector:
        """Projector that draws the symbol."""
        return self.sensor.projector

    @cached_property
    def brightness(self) -> Tensor:
        """Median luminance `[]` in cd/m^2 of the symbol at its target on a flat road."""
        return brightness(self.sensor, self.evaluator)

    def in_open_loop(self) -> "ControlledSymbol":
        """The symbol in open loop, drawn at its target for a flat road."""
        return replace(self, controller=build_controller(OpenLoopParams(), self.sensor))

    def belief(self, state: SymbolState, ego: Ego | None) -> Belief | None:
        """What the controller believes about road and body at the next exposure; None without a height map."""
        belief: Callable[[Any, Ego | None], Belief] | None = getattr(self.controller, "belief", None)
        return None if belief is None else belief(state.controller, ego)

    def start(self) -> SymbolState:
        """The state before the first measurement."""
        return SymbolState(self.controller.start(self.function.start_pose.pose.to(self.projector.target)))

    def command(self, projection: ProjectionCommand, T_ground_body: Tensor | None) -> tuple[Primitives, ...]:
        """Primitives of a projection in the ground frame; empty if the projection sets pixels directly.

        T_ground_body: `[4, 4]`, None for a standing, level body.
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
        """Utilisations of the drawing modules with the symbol on the assumed base beams, one a module.

        on, off: utilisations of all modules with and without the symbol.
        """
        beams = zip(self.drawn_by, self.projector.resting, strict=True)  # equal to off without other functions
        return tuple(on[k] if off[k].u is beam.u else Utilisation(beam.u + on[k].u - off[k].u) for k, beam in beams)

    def step(
        self, state: SymbolState, name: str, pair: ExposurePair, ego: Ego | None, latency_steps: int
    ) -> tuple[SymbolState, Measurement]:
        """Measure a pair that shows the symbol, and step its controller. name: of the symbol. ego: newest estimated motion.
        latency_steps: steps since the pair was exposed.
        """
        shown = Projection(pair.on.projections[name], self.light(pair.on.lights, pair.off.lights), pair.ego)
        frames = pair.images if pair.measures(name) else None
        bias = None if pair.alone or frames is None else self._bias(shown)
        if bias is not None and not bool(bias.isfinite().all()):
            frames, seen = None, replace(self.sensor.lost(shown.projection.pose, ExtractionStatus.COVERED), shape=state.shape)
        else:
            seen = self.sensor.measure(frames, shown.projection, shown.lights, state.shape if ego is None or ego.stands else None)
            if bias is not None and seen.code == ExtractionStatus.SEEN:
                errors = seen.errors - bias
                seen = replace(seen, errors=errors, pose_error=self.sensor.pose_error(errors))
        after = self.controller.step(state.controller, Observation(seen, frames, shown, ego, latency_steps))
        return SymbolState(after, state.turn, seen.shape), seen

    def _bias(self, shown: Projection) -> Tensor | None:
        """Feature bias caused by other functions' light, `[4]`; NaN if they leave too little of the symbol to measure. None if they do not
        affect it, or if it could not be measured on a flat road even alone.
        """
        alone = self.projector.draw(shown.projection)
        if all(torch.allclose(a.u, b.u, rtol=0, atol=SAME) for a, b in zip(shown.lights, alone, strict=True)):
            return None
        left, whole = (self.sensor.render(shown.projection, lights) for lights in (shown.lights, alone))
        return left - whole if bool(whole.isfinite().all()) else None

    def footprint(self, projection: ProjectionCommand) -> Window:
        """Image window of a projection in the camera, with a margin."""
        return self.projector.footprint(projection, self.sensor.model.eye.view, self.sensor.params.footprint_margin_m)


def choose_measured(
    symbols: Mapping[str, ControlledSymbol], states: Mapping[str, SymbolState], projections: Mapping[str, ProjectionCommand]
) -> tuple[str, ...]:
    """Symbols to measure together in a step: the longest unmeasured first, with separate image windows."""
    if len(projections) < 2:
        return tuple(projections)
    taken: dict[str, Window] = {}
    for name in sorted(projections, key=lambda name: (states[name].turn, name)):
        where = symbols[name].footprint(projections[name])
        if not any(where.meets(other) for other in taken.values()):
            taken[name] = where
    return tuple(taken)


def brightness(sensor: SymbolSensor, evaluator: SymbolEvaluator | None) -> Tensor:
    """Median luminance `[]` in cd/m^2 of the symbol at its target on a flat road."""
    if evaluator is not None:
        return evaluator.goal.median
    flat = sensor.model.luminance(sensor.projector.light(sensor.projector.target))
    return flat[flat > THRESHOLD * flat.max()].median()
