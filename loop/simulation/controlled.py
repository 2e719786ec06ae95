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

SAME = 1e-4  # of a utilisation, which more than rounding changes


@dataclass(frozen=True)
class SymbolState:
    """controller: its state. turn: step in which it was measured last.

    shape: `[4]` of the road on which it was seen, None for the flat one.
    """

    controller: Any
    turn: int = -1
    shape: Tensor | None = None


@dataclass(frozen=True, eq=False)
class ControlledSymbol:
    """A symbol that is held.

    drawn_by: indices of the car's modules that draw it. evaluator: None where the plant does not know the truth.
    """

    function: SymbolFunctionParams
    drawn_by: tuple[int, ...]
    sensor: SymbolSensor
    controller: SymbolController
    evaluator: SymbolEvaluator | None

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
        return brightness(self.sensor, self.evaluator)

    def in_open_loop(self) -> "ControlledSymbol":
        """The same without control: drawn at its target for a flat road."""
        return replace(self, controller=build_controller(OpenLoopParams(), self.sensor))

    def start(self) -> SymbolState:
        """Before anything is seen."""
        return SymbolState(self.controller.start(self.function.start_pose.pose.to(self.projector.target)))

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

    def step(self, state: SymbolState, name: str, pair: ExposurePair, ego: Ego | None) -> tuple[SymbolState, Measurement]:
        """Measure the frames of a pair of exposures that shows it, unless they are lost, and control. name: its own."""
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
        return SymbolState(self.controller.step(state.controller, Observation(seen, frames, shown, ego)), state.turn, seen.shape), seen

    def _bias(self, shown: Projection) -> Tensor | None:
        """Feature bias caused by other functions' light, `[4]`, NaN where they leave too little of the symbol to be measured; None where
        they do not touch it, or where the flat road would not show it anyway.
        """
        alone = self.projector.draw(shown.projection)
        if all(torch.allclose(a.u, b.u, rtol=0, atol=SAME) for a, b in zip(shown.lights, alone, strict=True)):
            return None
        left, whole = (self.sensor.render(shown.projection, lights) for lights in (shown.lights, alone))
        return left - whole if bool(whole.isfinite().all()) else None

    def footprint(self, projection: ProjectionCommand) -> Window:
        """Where the camera may see a projection."""
        return self.projector.footprint(projection, self.sensor.model.eye.view, self.sensor.params.footprint_margin_m)


def choose_measured(
    symbols: Mapping[str, ControlledSymbol], states: Mapping[str, SymbolState], projections: Mapping[str, ProjectionCommand]
) -> tuple[str, ...]:
    """Names of the symbols to be measured together: those that have waited longest, no two in one part of the image."""
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
