"""Stages around a controller with feedback: optional warp and supervisor, and drawing on the relocalised road.

Also user-defined controllers: `package.module:Name`.
"""

from dataclasses import dataclass, replace
from typing import Any, cast

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.symbol.alignment import Alignment, Kind, Placement
from luxloop.controllers.symbol.sensing.projection import CELLS, ProjectionCommand, Warp
from luxloop.controllers.symbol.sensing.symbol_sensor import Observation, SymbolController, SymbolSensor
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world import plugin
from luxloop.world.params import Params, PositiveShare, Share

BEYOND = (0.4, 0.15)  # margin of a warp's rectangle on every side, in lengths and widths of the symbol
LEAST_SHARE = 0.2  # least share of a placement to undo; below it no gain is expected


class WarpParams(Params):
    """Warp of the symbol, once the controller has brought it near its target."""

    kind: Kind = Field("homography+mesh", description="homography, and heights of a mesh, which move the symbol along epipolar lines")
    takes_over: PositiveShare = Field(0.3, description="largest residual, 1 minus IoU, after the first registration")
    least_drop: float = Field(0.005, ge=0, lt=1, description="least drop of the residual for a change of the warp")


@dataclass(frozen=True)
class WarpState:
    """State of the warp stage.

    inner: the controller's state. residual: 1 minus IoU of the best projection, or of the controller's last. best: projection with the
    lowest residual, None while the controller draws. projection: projection on trial. share: share of a placement that one step undoes,
    zero when no gain is expected.
    """

    inner: Any
    residual: float = 1.0
    best: ProjectionCommand | None = None
    projection: ProjectionCommand | None = None
    share: float = 1.0


class WarpStage:
    """Draws the controller's projection until its residual stops falling, then warps the symbol by successive registrations."""

    def __init__(self, params: WarpParams, inner: SymbolController, sensor: SymbolSensor) -> None:
        self.params, self.inner, self.projector = params, inner, sensor.projector
        self.alignment = Alignment.prepare(sensor)

    def start(self, pose: Tensor) -> WarpState:
        """The initial state, whose command shows the pose `[4]`."""
        return WarpState(self.inner.start(pose))

    def projection(self, state: WarpState, ego: Ego | None) -> ProjectionCommand:
        """The projection on trial, or the controller's."""
        return state.projection or self.inner.projection(state.inner, ego)

    def step(self, state: WarpState, observation: Observation) -> WarpState:
        """Keep a warp that lowers the residual, else halve the step; hand a lost symbol back to the controller."""
        code = observation.measurement.code
        lost = code != ExtractionStatus.SEEN
        if state.projection is None or (lost and code != ExtractionStatus.NO_FRAME):
            return self._follow(state, observation, bool(lost))
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
        return self._try(seen, self.alignment.register(image, self.params.kind), image)

    def _follow(self, state: WarpState, observation: Observation, lost: bool) -> WarpState:
        following = WarpState(self.inner.step(state.inner, observation))
        if lost:
            return following
        image = self.alignment.image(observation.measurement)
        residual = float(self.alignment.residual(image))
        following = replace(following, residual=residual)
        if residual < state.residual - self.params.least_drop:
            return following
        placement = self.alignment.register(image, self.params.kind)
        if float(self.alignment.residual(self.alignment.undo(image, placement))) > self.params.takes_over:
            return following
        return self._try(replace(following, best=observation.shown.projection), placement, image)

    def _try(self, state: WarpState, placement: Placement, image: Tensor) -> WarpState:
        assert state.best is not None
        drop = state.residual - float(self.alignment.residual(self.alignment.undo(image, placement)))
        if drop < self.params.least_drop:
            return replace(state, projection=state.best, share=0.0)
        warp = state.best.warp or self._whole()
        placed = torch.stack([placement.of(source) for source in warp.source])
        warp = replace(warp, source=torch.lerp(warp.source, placed, state.share))
        return replace(state, projection=replace(state.best, warp=warp))

    def _whole(self) -> Warp:
        """The undistorted symbol on a warp's rectangle."""
        p, margins = self.projector.params, [1 + 2 * beyond for beyond in BEYOND]
        centres = [(2 * torch.arange(n, device=self.projector.symbol.device) + 1) / n - 1 for n in CELLS]
        v, u = (centre * margin for centre, margin in zip(centres, margins, strict=True))
        source = torch.stack([u.expand(*CELLS), v[:, None].expand(*CELLS)])[None]
        return Warp(source, torch.ones_like(source[:, 0]), (p.length_m * margins[0], p.width_m * margins[1]))


class SupervisorParams(Params):
    """Conditions under which a controller takes over from the open loop, and hands back."""

    grace_steps: int = Field(
        8, ge=1, le=1_000_000, description="observations of the controller's symbol after which it must be better than the open loop"
    )
    explained: Share = Field(0.3, description="least share of the residual that registration must explain; obstacles explain less")
    changed: PositiveShare = Field(0.05, description="change of the open loop's residual, 1 minus IoU, that is worth another try")


@dataclass(frozen=True)
class SupervisorState:
    """State of the supervisor.

    inner: state of the controller in charge, None for the open loop. opened: last residual of the open loop. observations: number of
    observations of the controller's symbol. failed: residual of the open loop that the controller could not reduce, or None.
    """

    inner: Any = None
    opened: float = 1.0
    observations: int = 0
    failed: float | None = None


class Supervisor:
    """Begins with the open loop; the controller takes over on uneven roads while its residual is lower."""

    def __init__(self, params: SupervisorParams, inner: SymbolController, sensor: SymbolSensor) -> None:
        self.params, self.inner, self.target = params, inner, sensor.projector.target
        self.alignment = Alignment.prepare(sensor)
        self.flat = ProjectionCommand(self.target)

    def start(self, pose: Tensor) -> SupervisorState:
        """The open loop, whatever the pose `[4]`."""
        return SupervisorState()

    def projection(self, state: SupervisorState, ego: Ego | None) -> ProjectionCommand:
        """The projection of the open loop or of the controller."""
        return self.flat if state.inner is None else self.inner.projection(state.inner, ego)

    def step(self, state: SupervisorState, observation: Observation) -> SupervisorState:
        """Compare the residuals, then step the controller in charge."""
        seen = observation.measurement
        if seen.code == ExtractionStatus.NO_FRAME:
            return state if state.inner is None else replace(state, inner=self.inner.step(state.inner, observation))
        image = self.alignment.image(seen) if seen.code == ExtractionStatus.SEEN else torch.zeros_like(self.alignment.target)
        residual = float(self.alignment.residual(image))
        opened = observation.shown.projection.shows(self.flat)
        if state.inner is None:
            return self._try(residual, image, state, observation) if opened else state
        if opened:
            return replace(state, opened=residual, inner=self.inner.step(state.inner, observation))
        if state.observations >= self.params.grace_steps and residual >= state.opened:
            return SupervisorState(failed=state.opened)
        return replace(state, observations=state.observations + 1, inner=self.inner.step(state.inner, observation))

    def _try(self, residual: float, image: Tensor, state: SupervisorState, observation: Observation) -> SupervisorState:
        """Hand over to the controller, unless it failed at this residual or registration explains too little."""
        if observation.measurement.code != ExtractionStatus.SEEN or (
            state.failed is not None and abs(residual - state.failed) < self.params.changed
        ):
            return state
        placement = self.alignment.register(image, "homography+mesh")
        left = float(self.alignment.residual(self.alignment.undo(image, placement)))
        if left > (1 - self.params.explained) * residual:
            return SupervisorState(failed=residual)
        return SupervisorState(self.inner.step(self.inner.start(self.target), observation), residual)


SURE = 0.85  # correlation above which a new road shape is accepted although the symbol is seen on the present one; on grades it exceeds 0.9
LOSSES = 4  # losses in a row after which a road shape is dropped: more than controllers need to show their target again


@dataclass(frozen=True)
class RoadStageState:
    """State. inner: of the controller. shape: `[4]` of the assumed road, None for z = 0. losses: losses in a row."""

    inner: Any
    shape: Tensor | None = None
    losses: int = 0


class RoadStage:
    """The controller draws and measures as on z = 0; on every newly relocalised road it restarts at the target."""

    def __init__(self, inner: SymbolController, sensor: SymbolSensor) -> None:
        self.inner, self.sensor, self.projector = inner, sensor, sensor.projector

    def start(self, pose: Tensor) -> RoadStageState:
        """The initial state, whose command shows the pose `[..., 4]`."""
        return RoadStageState(self.inner.start(pose))

    def projection(self, state: RoadStageState, ego: Ego | None) -> ProjectionCommand:
        """The controller's projection on the relocalised road."""
        projection = self.inner.projection(state.inner, ego)
        return projection if state.shape is None else replace(projection, shape=state.shape)

    def step(self, state: RoadStageState, observation: Observation) -> RoadStageState:
        """Step the controller with observations of light for the present road shape; others belong to another plant."""
        if not _same(observation.shown.projection.shape, state.shape):
            return state
        shape, losses = self._road(state, observation)
        if not _same(shape, state.shape):
            return RoadStageState(self.inner.start(self.projector.target), shape)
        if shape is not None:
            projection = replace(observation.shown.projection, shape=None)
            observation = replace(
                observation, shown=replace(observation.shown, projection=projection, lights=self.projector.draw(projection))
            )
        return RoadStageState(self.inner.step(state.inner, observation), shape, losses)

    def _road(self, state: RoadStageState, observation: Observation) -> tuple[Tensor | None, int]:
        """The road shape after an observation, None on the move, and the number of losses in a row."""
        moving = observation.ego is not None and not observation.ego.stands
        seen = observation.measurement
        if seen.code.dim() or moving:
            return None, 0
        if seen.code == ExtractionStatus.SEEN:
            return self._beyond(state.shape, observation) if seen.acquired is None else seen.shape, 0
        losses = state.losses + int(state.shape is not None and seen.code != ExtractionStatus.NO_FRAME)
        return (None, 0) if losses == LOSSES else (state.shape, losses)

    def _beyond(self, known: Tensor | None, observation: Observation) -> Tensor | None:
        """The known shape, or a relocalised shape if the symbol reaches the footprint's ends."""
        if observation.frames is None or not self.sensor.at_ends(observation.measurement):
            return known
        found = self.sensor.relocalise(observation.frames, observation.shown.lights)
        risen = found.shape[0] - (0.0 if known is None else known[0])
        return found.shape if found.match > SURE and found.found and risen.abs() > self.sensor.params.footprint_margin_m else known


def _same(a: Tensor | None, b: Tensor | None) -> bool:
    return a is b or (a is not None and b is not None and a.equal(b))


class StagedParams(Params):
    """Keys of all controllers that can have stages."""

    warp: WarpParams | None = Field(None, description="warp of the symbol once the controller's residual stops falling; left out: none")
    supervisor: SupervisorParams | None = Field(None, description="shows the open loop where control is not better; left out: none")


def with_stages(params: StagedParams, controller: SymbolController, sensor: SymbolSensor) -> SymbolController:
    """The controller with the stages that its parameters name, and with drawing on the relocalised road."""
    if params.warp is not None:
        controller = WarpStage(params.warp, controller, sensor)
    if params.supervisor is not None:
        controller = Supervisor(params.supervisor, controller, sensor)
    return RoadStage(controller, sensor)


KEY = "controller.name"
METHODS = ("start", "projection", "step")


class OwnParams(StagedParams):
    """A user-defined controller: `Name(sensor, **options)`."""

    name: plugin.OwnName
    options: dict[str, Any] = Field({}, description="keyword arguments of Name, beside the sensor")


def own_controller(params: OwnParams, sensor: SymbolSensor) -> SymbolController:
    """Import and construct the controller. Raises LuxloopError if the class does not exist, refuses its options or lacks a method."""
    return cast(SymbolController, plugin.make(params.name, KEY, {"sensor": sensor}, params.options, METHODS))
