"""A stage on top of any controller: the symbol is registered to the target, and drawn where the registration says that it has to be."""

from dataclasses import dataclass, replace
from typing import Any

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.symbol.laws.alignment import Alignment, Kind, Placement
from luxloop.controllers.symbol.sensing.projection import CELLS, ProjectionCommand, Warp
from luxloop.controllers.symbol.sensing.protocol import Observation, SymbolController
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world.params import Params

BEYOND = (0.4, 0.15)  # of the symbol's length and width, by which a warp's rectangle is larger on every side
LEAST_SHARE = 0.2  # of a placement: after a few that did not help there is nothing more to be had


class WarpParams(Params):
    """How the symbol is warped once the controller has brought it near its place."""

    kind: Kind = Field("homography+mesh", description="a homography, and heights of a mesh, which move the symbol along epipolar lines")
    takes_over: float = Field(0.3, gt=0, le=1, description="largest residual, 1 minus IoU, that the first registration may leave")
    least_drop: float = Field(0.005, ge=0, lt=1, description="drop of the residual below which nothing is changed")


@dataclass(frozen=True)
class WarpingState:
    """inner: the controller's state. residual: 1 minus IoU of the best symbol seen so far, or of the controller's last.

    best: what was shown then, None while the controller draws. projection: what is tried now. share: of a placement that is undone at once,
    zero when there is nothing more to be had.
    """

    inner: Any
    residual: float = 1.0
    best: ProjectionCommand | None = None
    projection: ProjectionCommand | None = None
    share: float = 1.0


class Warping:
    """The controller's own projection until that gets no better; from then on a warp, composed exactly with each registration."""

    def __init__(self, params: WarpParams, inner: SymbolController, sensor: SymbolSensor) -> None:
        self.params, self.inner, self.projector = params, inner, sensor.projector
        self.alignment = Alignment.prepare(sensor)

    def start(self, pose: Tensor) -> WarpingState:
        """State that shows the pose `[4]` first."""
        return WarpingState(self.inner.start(pose))

    def projection(self, state: WarpingState, ego: Ego | None) -> ProjectionCommand:
        """What is tried, or what the controller draws."""
        return state.projection or self.inner.projection(state.inner, ego)

    def step(self, state: WarpingState, observation: Observation) -> WarpingState:
        """Keep a warp whose symbol lies better than any before, else go half as far; give a lost symbol back to the controller."""
        lost = observation.measurement.code != ExtractionStatus.SEEN
        if state.projection is None or (lost and observation.measurement.code != ExtractionStatus.NO_FRAME):
            return self._led(state, observation, bool(lost))
        if lost or not observation.shown.projection.shows(state.projection):
            return state
        image = self.alignment.image(observation.measurement)
        residual = float(self.alignment.residual(image))
        if state.projection is not state.best and residual > state.residual:
            return replace(state, projection=state.best, share=state.share / 2)
        changed = residual > state.residual + self.params.least_drop
        if state.share < LEAST_SHARE and not changed:
            return state
        seen = replace(state, residual=residual, best=state.projection, share=1.0 if changed else state.share)
        return self._tried(seen, self.alignment.register(image, self.params.kind), image)

    def _led(self, state: WarpingState, observation: Observation, lost: bool) -> WarpingState:
        following = WarpingState(self.inner.step(state.inner, observation))
        if lost:
            return following
        image = self.alignment.image(observation.measurement)
        residual = float(self.alignment.residual(image))
        following = replace(following, residual=residual)
        if residual < state.residual - self.params.least_drop:
            return following
        placement = self.alignment.register(image, self.params.kind)
        if float(self.alignment.residual(self.alignment.undone(image, placement))) > self.params.takes_over:
            return following
        return self._tried(replace(following, best=observation.shown.projection), placement, image)

    def _tried(self, state: WarpingState, placement: Placement, image: Tensor) -> WarpingState:
        assert state.best is not None
        drop = state.residual - float(self.alignment.residual(self.alignment.undone(image, placement)))
        if drop < self.params.least_drop:
            return replace(state, projection=state.best, share=0.0)
        warp = state.best.warp or self._whole()
        placed = torch.stack([placement.of(source) for source in warp.source])
        warp = replace(warp, source=torch.lerp(warp.source, placed, state.share))
        return replace(state, projection=replace(state.best, warp=warp))

    def _whole(self) -> Warp:
        """The symbol as it is, on a warp's rectangle."""
        p, margins = self.projector.params, [1 + 2 * beyond for beyond in BEYOND]
        centres = [(2 * torch.arange(n, device=self.projector.symbol.device) + 1) / n - 1 for n in CELLS]
        v, u = (centre * margin for centre, margin in zip(centres, margins, strict=True))
        source = torch.stack([u.expand(*CELLS), v[:, None].expand(*CELLS)])[None]
        return Warp(source, torch.ones_like(source[:, 0]), (p.length_m * margins[0], p.width_m * margins[1]))
