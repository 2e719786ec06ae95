"""luxloop's controller: estimates the road's heights from the image of the symbol, and draws the symbol for the estimated road."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.symbol.heights.body_filter import AT_REST, BodyFilter, BodyParams, BodyPoses, BodyPrediction
from luxloop.controllers.symbol.heights.forward_model import ForwardModel
from luxloop.controllers.symbol.heights.height_map import Belief, body_over
from luxloop.controllers.symbol.heights.overlap import TargetOverlap
from luxloop.controllers.symbol.heights.registration import BLURS, COARSE, FINE, HEIGHT_M, Blur, Heights, Registration, plane_sweep
from luxloop.controllers.symbol.heights.road_map import RoadMap
from luxloop.controllers.symbol.sensing.field import aim, elsewhere
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand, Warp
from luxloop.controllers.symbol.sensing.projector import Projector, SymbolParams
from luxloop.controllers.symbol.sensing.road_shape import HERE, pose_of_rectangle, ray_lengths
from luxloop.controllers.symbol.sensing.symbol_sensor import Observation, SymbolSensor
from luxloop.perception.birdseye import Region
from luxloop.perception.camera import camera_view
from luxloop.perception.egomotion import KEPT_S, Ego
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world.caches import keeping
from luxloop.world.frames import inverse, transform
from luxloop.world.frames import pose as pose_of
from luxloop.world.params import NotNegative, Params
from luxloop.world.scene.vehicle import LEARNT_M, ground_pose

LEAST_LIT_PX = 20.0  # least lit pixels of a symbol
COLUMNS, LINES = 2, 3  # camera columns a column of the registered image, against noise; lines of sight a camera row
HEIGHTS = 57  # number of heights of a plane sweep
LEAST_LIGHT = 0.05  # of the mean expected light: weight of the previous brightness of a node
LOW_M = {"appearance": 0.1, "place": 0.03}  # heights up to here are registered without relocalisation, by kind of target
POOR, SEARCHES = 0.08, 4  # residual above which the whole image is searched again, and most searches for one road
POOR_ROAD = 0.03  # residual of the known road above which registration replaces another search
SAME_M = 0.05  # largest difference of the heights of two searches under the target for the second to be the last
FALLING_ROAD = (-0.3, -0.03, 0.0, 0.0)  # guessed road shape for a symbol that is not in the image
FARTHEST = 3.0  # of the distance to the plane z = 0: end of lines of sight that meet no road
ROAD_M = 4e-3  # least deviation of a track's height
PITCH_RAD = 5e-4  # standard deviation of a predicted pitch
CELLS, FINER = (16, 16), 16  # cells of an opening pattern, along and across, and its resolution in shares of a cell
ROUNDING_S = 1e-6  # tolerance of equal times

Cell = Annotated[float, Field(ge=0.02, le=10)]
Reach = Annotated[float, Field(ge=0, le=20)]


class HeightControllerParams(Params):
    """Estimates the road's heights from the image of the symbol and draws for that road; open loop while heights explain nothing."""

    name: Literal["luxloop"] = "luxloop"
    cell_m: tuple[Cell, Cell] = Field((0.2, 0.15), description="distance of heights on the assumed road, along and across")
    beyond_m: tuple[Reach, Reach, Reach] = Field(
        (1.2, 1.5, 0.6), description="margin of the height map around the symbol: near, far, sides"
    )
    highest_m: float = Field(0.14, gt=0, le=0.3, description="largest height, up or down, that the plane sweep tries")
    memory: float = Field(
        0.6,
        ge=0,
        lt=1,
        description="factor on the information of the height map in each step on the move, since the road may differ from the map",
    )
    evidence: NotNegative = Field(
        0.0025, description="least drop of the residual, as a share of the lit area, by which heights must better a flat road"
    )
    sweep_above: NotNegative = Field(0.01, description="residual, as a share of the lit area, above which a plane sweep tries all heights")
    opening: Literal["symbol", "pattern"] = Field(
        "symbol",
        description="light of a standing vehicle until the first frames arrive: the symbol, or random cells around its target, which show "
        "the road's heights everywhere",
    )
    start_height_m: float = Field(0.0, ge=-0.3, le=0.3, description="initial height of the whole road; 0: unknown")
    body: BodyParams = Field(BodyParams(), description="the controller's model of the car's springs and wheels")


@dataclass(frozen=True)
class HeightControllerState:
    """State after an observation.

    road_map: heights in the ground frame of time_s. projection: command of a standing vehicle; None on the move, where the command depends
    on later measurements. body: body filter, None without measurements. level_rad: body pitch to which the heights of the road map refer.
    first: first command for a relocalised road, None after its observation. sought: whether the symbol was seen or a road was guessed.
    ground: `T_level_ground` `[4, 4]` at time_s.
    """

    road_map: RoadMap
    time_s: float
    projection: ProjectionCommand | None
    body: BodyFilter | None = None
    level_rad: float = 0.0
    first: ProjectionCommand | None = None
    sought: bool = False
    ground: Tensor | None = None


class HeightController:
    """Estimates the heights of a road at rest and on the move, and falls back to the open loop."""

    def __init__(self, params: HeightControllerParams, sensor: SymbolSensor) -> None:
        self.params, self.projector, self.sensor = params, sensor.projector, sensor
        self.region = region_of(self.projector.params, *params.beyond_m)
        self.reach_m = self.projector.params.x_m - self.projector.params.length_m / 4
        self.standing = keeping(2, self._standing)
        self.cached_draw = keeping(1, self._draw)
        self.registration = self.over(HERE)[1]
        self.nothing = self._nothing(self.registration)  # the empty road map of a standing vehicle
        target_light = self.projector.textures(self.projector.light(self.projector.target))
        self.overlap = TargetOverlap.of(self.registration.forward_model, target_light, self.projector.params)
        self.pattern = opening_pattern(self.projector, self.region)
        self.eye = camera_view(sensor.camera).origin  # in the body frame
        self.tried = torch.linspace(-params.highest_m, params.highest_m, HEIGHTS, device=self.projector.symbol.device)

    def start(self, pose: Tensor) -> HeightControllerState:
        """Initial state. pose: `[4]`, first pose of the symbol unless a pattern opens or the road has a start height."""
        road_map = self.nothing
        if self.params.opening == "pattern":
            return HeightControllerState(road_map, 0.0, self.pattern)
        if self.params.start_height_m == 0:
            road_map = road_map.showing(ProjectionCommand(self.projector.target))  # look there first
            return HeightControllerState(road_map, 0.0, ProjectionCommand(pose))
        mean = road_map.heights.mean + self.params.start_height_m
        believed = _assume_heights(road_map, mean)
        return HeightControllerState(believed, 0.0, self._draw(believed))

    def projection(self, state: HeightControllerState, ego: Ego | None) -> ProjectionCommand:
        """The command for the estimated road and the predicted pose of the body."""
        return self._draw(*self._predict(state, ego)) if state.projection is None else state.projection

    def belief(self, state: HeightControllerState, ego: Ego | None) -> Belief:
        """The estimated road and the predicted pose of the body at the next exposure."""
        return self._belief(*self._predict(state, ego))

    def _predict(self, state: HeightControllerState, ego: Ego | None) -> tuple[RoadMap, BodyPrediction]:
        """Road map and body at the next exposure."""
        if state.projection is not None:
            return state.road_map, AT_REST
        body = self._filter(state.body, ego)
        assert ego is not None and body is not None  # or it would stand
        now = body.at_last_observation()
        road_map = state.road_map.tilt(now.level_rad - state.level_rad, body.pivot_x_m)
        ground = ground_pose(body.ground(ego, state.time_s)[:2]) if state.ground is None else state.ground
        return road_map, BodyPrediction.of(ego, now, state.time_s, ground)

    def step(self, state: HeightControllerState, observation: Observation) -> HeightControllerState:
        """Update body filter and road map. The open loop stays unless heights explain the image better than a flat road.

        The road map yields the body's pitch since the previous observation, and the road ahead of the wheels. On the move the estimate
        begins anew after a gap in which samples were lost.
        """
        body, then = state.body, observation.shown.ego
        if then is not None:
            if observation.ego is not None and not then.stands and observation.ego.time_s - then.time_s > KEPT_S:
                return replace(self.start(self.projector.target), time_s=then.time_s)
            for ego in (then, observation.ego):  # process measurements newer than the observation after it
                body = self._filter(body, ego, then.time_s + ROUNDING_S)
        now = None if body is None else body.at_last_observation()
        body_poses = BodyPoses.of(observation, now, state.time_s, state.ground)
        road_map, first, sought = state.road_map, state.first, state.sought or bool(observation.measurement.code == ExtractionStatus.SEEN)
        if anew := observation.frames is not None and first is not None and observation.shown.projection.shows(first):
            first = None
        if body_poses.still:
            registration = self.over(road_map.T_ground_plane)[1]
        else:
            road_map = road_map if road_map.T_ground_plane.equal(HERE) else self.nothing
            registration = self._fine(body_poses)
        road_map = road_map.move(body_poses.since, registration.forward_model.eye)
        if not body_poses.still and then is not None and body is not None and not then.stands:
            road_map = road_map.over(self._heights(self._curved_shape(then, body), road_map))
        if body is None or now is None or body_poses.still:
            road_map = self._observe(registration, road_map, observation, body_poses, anew)
            lost = body_poses.still and not road_map.heights.any_information and road_map.choice() is None
            if lost and (guess := self._guess_road(state, observation)) is not None:
                road_map, sought = guess, True
        else:
            road_map = road_map.tilt(now.level_rad - state.level_rad, body.pivot_x_m)
            if observation.frames is not None:
                known, predicted = road_map, now.at(body_poses.time_s).pitch_rad
                road_map = self._observe(registration, known.loosen(PITCH_RAD, body.pivot_x_m), observation, body_poses)
                pitched = road_map.pitch_between(known, body.pivot_x_m)
                body = body.with_observation(body_poses.time_s, None if pitched is None else predicted + pitched - now.level_rad)
                now = body.at_last_observation()
                road_map = road_map.tilt(now.level_rad - predicted, body.pivot_x_m)
        if body is not None and observation.ego is not None and road_map.T_ground_plane.equal(HERE):
            body = _preview(body, road_map, body_poses, observation.ego)
        projection, level_rad = self.cached_draw(road_map.bare()) if body_poses.still else None, 0.0 if now is None else now.level_rad
        if projection is not None:
            opens = observation.frames is None and state.projection is not None and state.projection.shows(self.pattern)
            projection, road_map = (self.pattern, road_map) if opens else (projection, road_map.showing(projection))
        if road_map.shape is not state.road_map.shape:
            first = None if road_map.shape is None else projection
        return HeightControllerState(road_map, body_poses.time_s, projection, body, level_rad, first, sought, body_poses.ground)

    def _filter(self, before: BodyFilter | None, ego: Ego | None, by_s: float = math.inf) -> BodyFilter | None:
        """The body filter after the measurements up to by_s; unchanged without measurements or axle positions, and anew after a gap."""
        if ego is None or ego.pivot_x_m == ego.rear_x_m:
            return before
        if before is None or ego.samples[-1].measured_s - before.time_s > KEPT_S:
            before = BodyFilter.first(self.params.body, ego, self.reach_m, self.projector.params.x_m)
        return before.update(ego, by_s)

    def _observe(
        self, registration: Registration, road_map: RoadMap, observation: Observation, body_poses: BodyPoses, anew: bool = False
    ) -> RoadMap:
        """The road map after an observation; empty if heights do not explain the image. anew: first observation for a relocalised road."""
        if observation.frames is None:
            return road_map
        frames, textures, searched = observation.frames, self.projector.textures(observation.shown.lights), road_map.searched
        nothing = self.nothing if body_poses.still else self._nothing(registration).over(road_map.heights.base)
        fine, known = registration.forward_model, road_map.heights
        informed = known.any_information
        roads = torch.stack([nothing.heights.mean, *[known.mean] * informed])
        expected = fine.luminance(textures, fine.on_pixels(roads))
        contrast, limit = fine.observe_symbol(frames, expected[0])
        seen, least_seen = fine.symbol(contrast, limit), limit
        lit = float(seen.sum()) * fine.step >= LEAST_LIT_PX
        limit = limit / fine.on_pixels(road_map.brightness)  # relative to the assumed road's brightness
        leaves = registration.residual(expected, seen, limit).tolist()
        flat_leaves, before = leaves[0], leaves[informed]
        drawn = road_map.drawn if body_poses.still else None
        new = drawn is not None and drawn.projection.shows(observation.shown.projection)
        if new and lit:
            if self._rates_overlap(road_map):
                residual = self.overlap.residual(contrast, least_seen)
            else:
                residual = before if before < flat_leaves else math.inf
            road_map = road_map.rate(residual, observation.latency_steps + 1)
            if (choice := road_map.choice()) is not None:
                return choice
            nothing = self._keep(nothing, road_map)
        if lit and not informed and flat_leaves <= self.params.evidence:
            return nothing  # since no heights can explain so much more
        unsure = not informed or (anew and not road_map.settled and searched < SEARCHES)
        if body_poses.still and unsure and (acquired := self._relocalise(road_map, observation)) is not None:
            return self._observe(self.over(acquired.T_ground_plane)[1], acquired, observation, body_poses)
        if not lit:
            there = fine.symbol(expected[int(informed)], limit) * fine.inside
            return road_map if float(there.sum()) * fine.step < LEAST_LIT_PX else nothing
        explained = body_poses.still and informed and before <= self.params.evidence and self._rates_overlap(road_map)
        if explained or (drawn is not None and not new):
            return road_map  # since it explains the image, or until the newest candidate is observed
        # The next observation corrects the rest; more steps fit noise.
        blurs = BLURS if not informed else (COARSE, FINE) if before > self.params.evidence else (FINE,)
        least, best, light = self._refine(registration, known, known.mean, seen, textures, limit, blurs)
        if least > self.params.sweep_above:
            swept = self._sweep(road_map, frames, textures, body_poses)
            again = self._refine(registration, known, swept, seen, textures, limit)
            least, best, light = min((least, best, light), again, key=lambda each: each[0])
        road_map = replace(road_map, settled=road_map.settled or (anew and before > POOR_ROAD))
        if least > POOR and body_poses.still and road_map.searched == searched < SEARCHES:
            if (acquired := self._relocalise(road_map, observation)) is not None:
                return acquired
            road_map = replace(road_map, searched=searched + 1)
        if least > flat_leaves - (0.0 if informed else self.params.evidence):
            return nothing
        information = known.information + best.information
        gain = best.information.sum() / information.sum().clamp(min=1)  # weight of this observation against all earlier ones
        brightness = _brightness(fine, light, road_map.brightness, contrast, seen, least_seen)
        share = (least / before if least < before else 1.0) if body_poses.still else self.params.memory
        return replace(
            road_map, heights=replace(best, information=information * share), brightness=road_map.brightness.lerp(brightness, gain)
        )

    def _refine(
        self,
        registration: Registration,
        known: Heights,
        nodes: Tensor,
        seen: Tensor,
        textures: tuple[Tensor, ...],
        limit: Tensor,
        blurs: Sequence[Blur] = BLURS,
    ) -> tuple[float, Heights, Tensor]:
        """Heights refined from nodes `[n]`, their residual, and the luminance `[h, w]` that they predict."""
        found = registration.refine(nodes, known, seen, textures, limit, blurs)
        light = registration.forward_model.luminance(textures, registration.forward_model.on_pixels(found.mean[None]))
        return float(registration.residual(light, seen, limit)), found, light[0]

    def _relocalise(self, road_map: RoadMap, observation: Observation) -> RoadMap | None:
        """The road from the symbol's place in the whole image; None where nothing is found, or where its heights are small enough for
        registration alone. Then a relocalised road gives way to a flat one.
        """
        assert observation.frames is not None
        symbol = self.projector.params
        found = observation.measurement.acquired or self.sensor.relocalise(observation.frames, observation.shown.lights)
        if not found.found:
            return None
        if float(self._heights(found.shape, self.nothing).abs().max()) < LOW_M[symbol.target]:
            return None if road_map.shape is None else self._keep(replace(self.nothing, searched=road_map.searched + 1), road_map)
        return self._road_of_shape(road_map, found.shape)

    def _guess_road(self, state: HeightControllerState, observation: Observation) -> RoadMap | None:
        """A guessed road for a drawn symbol that is not in the image.

        Its heights are half those of the assumed road. For a flat assumed road the guess is a falling road, or None if the symbol was seen
        before, since it is then hidden.
        """
        lost, before = observation.measurement.acquired, state.road_map.shape
        if lost is None or lost.found or state.projection is None or not observation.shown.projection.shows(state.projection):
            return None
        if before is not None:
            return self._road_of_shape(state.road_map, before / 2) if state.road_map.searched < SEARCHES else None
        return None if state.sought or lost.match else self._road_of_shape(state.road_map, self.projector.target.new_tensor(FALLING_ROAD))

    def _road_of_shape(self, before: RoadMap, shape: Tensor) -> RoadMap:
        """The road map of a road of shape `[4]`, relative to the plane of the symbol on that road."""
        symbol = self.projector.params
        rise = float((shape - (0 if before.shape is None else before.shape)) @ shape.new_tensor([1.0, 0.0, symbol.y_m, 0.0]))
        plane = aim(shape, symbol, self.projector.modules, self.eye, self.projector.observer)
        nothing = replace(self._nothing(self.over(plane)[1]), T_ground_plane=plane)
        believed = _assume_heights(nothing, self._heights(shape, nothing))
        found = replace(believed, shape=shape, searched=before.searched + 1, settled=abs(rise) < SAME_M)
        return self._keep(found, before)

    def _keep(self, road_map: RoadMap, before: RoadMap) -> RoadMap:
        """A road map that keeps the best candidate of another one, if all are rated alike."""
        alike = self._rates_overlap(road_map) and self._rates_overlap(before)
        return replace(road_map, kept=before.kept) if alike else road_map

    def _rates_overlap(self, road_map: RoadMap) -> bool:
        """Whether candidates are rated by their overlap with the target: where it can be lit, and appear so on a flat road."""
        return self.projector.params.target == "appearance" and road_map.T_ground_plane.equal(HERE)

    def _curved_shape(self, ego: Ego, body: BodyFilter) -> Tensor:
        """Shape `[4]` of a road with the ground's vertical curvature, the slope rate over the speed; flat before the vehicle has driven
        LEARNT_M.
        """
        if body.way_m < LEARNT_M:
            return torch.zeros_like(self.projector.target)
        ahead_m, curvature = self.projector.params.x_m - ego.rear_x_m, -body.ground(ego, ego.time_s)[2].to(self.projector.target)
        return torch.stack([curvature * ahead_m**2 / 2, curvature * ahead_m, 0 * curvature, curvature]).to(self.projector.target)

    def _heights(self, shape: Tensor, road_map: RoadMap) -> Tensor:
        """Heights `[n]` of a road of shape `[4]` at the nodes of a road map."""
        T, eye = road_map.T_ground_plane.to(shape), road_map.eye
        origin, ways = transform(T, eye[:, None])[:, 0], T[:3, :3] @ (road_map.nodes() - eye[:, None])
        share = ray_lengths(shape[None], self.projector.params.x_m, origin, ways)[0].clamp(max=FARTHEST)
        return eye[2] * (1 - share)

    def _sweep(self, road_map: RoadMap, frames: tuple[Tensor, Tensor], textures: tuple[Tensor, ...], body_poses: BodyPoses) -> Tensor:
        coarse = self.over(road_map.T_ground_plane)[0] if body_poses.still else self._coarse(body_poses)
        base = road_map.heights.base
        contrast, limit = coarse.observe_symbol(frames, coarse.luminance(textures, coarse.on_pixels(base[None]))[0])
        seen, limit = coarse.symbol(contrast, limit), limit / coarse.on_pixels(road_map.brightness)
        return plane_sweep(coarse, seen, textures, limit, self.tried, base)

    def _draw(self, road_map: RoadMap, prediction: BodyPrediction = AT_REST) -> ProjectionCommand:
        """The command for the estimated road and the predicted pose of the body."""
        symbol, plane = self.projector.params, road_map.T_ground_plane
        if not (road_map.heights.any_information or road_map.heights.base.any()):
            return flat_command(self.projector.target, inverse(body_over(plane, prediction.body)))
        away = elsewhere(plane, symbol) if self.projector.observer is None else None
        return replace(self._belief(road_map, prediction).draw(self.projector), aim=away)

    def _belief(self, road_map: RoadMap, prediction: BodyPrediction) -> Belief:
        plane = road_map.T_ground_plane
        eye = transform(body_over(plane, prediction.body), self.eye[:, None])[:, 0].to(road_map.eye)
        return Belief(road_map.relief_from(prediction.until, eye), plane, prediction.body)

    def _nothing(self, registration: Registration) -> RoadMap:
        """The empty road map."""
        heights, forward_model = registration.unknown(), registration.forward_model
        return RoadMap(heights, torch.ones_like(heights.mean), self.region, (forward_model.rows, forward_model.cols), forward_model.eye)

    def over(self, T_ground_plane: Tensor) -> tuple[ForwardModel, Registration]:
        """Registrations for sweep and refinement of heights over a plane `[4, 4]` while the vehicle stands."""
        return self.standing(tuple(T_ground_plane.flatten().tolist()))

    def _standing(self, plane: tuple[float, ...]) -> tuple[ForwardModel, Registration]:
        body_poses = BodyPoses() if plane == tuple(HERE.flatten().tolist()) else BodyPoses().over(HERE.new_tensor(plane).view(4, 4))
        return self._coarse(body_poses), self._fine(body_poses)

    def _fine(self, body_poses: BodyPoses) -> Registration:
        return Registration.prepare(self._forward_model(body_poses, COLUMNS, LINES))

    def _coarse(self, body_poses: BodyPoses) -> ForwardModel:
        return self._forward_model(body_poses, 2 * COLUMNS, 1)

    def _forward_model(self, body_poses: BodyPoses, step: int, samples: int) -> ForwardModel:
        """Forward model for the body's poses at the two frames."""
        return ForwardModel.prepare(self.sensor, self.region, self.params.cell_m, step, samples, body_poses.on, body_poses.off)


def _preview(body: BodyFilter, road_map: RoadMap, body_poses: BodyPoses, ego: Ego) -> BodyFilter:
    """The body filter after the road map's heights between the wheels and the light."""
    way_m, driven_m = body.unseen_way_m(), body.way_m + body.speed_m_s * (body_poses.time_s - body.time_s)
    x = (way_m - driven_m).to(road_map.eye)
    aside = ego.yaw_rate_rad_s / ego.speed_m_s.clamp(min=1.0) * (x - ego.rear_x_m) ** 2 / 2
    half_m = body.params.track_m / 2
    heights, information = road_map.tracks(x.expand(2, -1), torch.stack([aside + half_m, aside - half_m]))
    level_m = transform(body_poses.ground.to(x), torch.stack([x, 0 * x, 0 * x]))[2]  # of the ground
    return body.with_road(way_m, level_m + heights, ROAD_M**2 + 1 / information.clamp(min=1e-3))


def _assume_heights(road_map: RoadMap, heights: Tensor) -> RoadMap:
    """The road map with assumed heights `[n]` and their usual variance."""
    return replace(road_map, heights=Heights(heights, torch.full_like(heights, 1 / HEIGHT_M**2), heights, torch.zeros_like(heights)))


def flat_command(target: Tensor, T_body_ground: Tensor) -> ProjectionCommand:
    """Command of the undistorted symbol, in the body frame, for a target pose `[4]` flat on the ground."""
    if T_body_ground.equal(HERE):
        return ProjectionCommand(target)
    centre = T_body_ground.new_tensor([float(target[0]), float(target[1]), 0.0])
    pose, z = pose_of_rectangle(T_body_ground @ pose_of(centre, torch.eye(3).to(centre)))
    return ProjectionCommand(pose.to(target), z.to(target))


def opening_pattern(projector: Projector, region: Region) -> ProjectionCommand:
    """Random cells as bright as the symbol, half of them lit, on a rectangle around the target that is as large as a region."""
    symbol = projector.symbol
    lit = torch.rand(CELLS, generator=torch.Generator().manual_seed(0)) < 0.5
    lit = lit.repeat_interleave(FINER, 0).repeat_interleave(FINER, 1).to(symbol.device)
    row, col = divmod(int(symbol.argmax()), symbol.shape[1])  # white, as (u, v) of the symbol; beyond 1 it is dark
    white = [(2 * k + 1) / n - 1 for k, n in ((col, symbol.shape[1]), (row, symbol.shape[0]))]
    source = torch.where(lit, symbol.new_tensor(white)[:, None, None], 2.0)[None]  # [1, 2, h, w]
    size_m = (region.x_far_m - region.x_near_m, region.y_left_m - region.y_right_m)
    return ProjectionCommand(projector.target, warp=Warp(source, torch.ones_like(source[:, 0]), size_m))


def _brightness(fine: ForwardModel, expected: Tensor, before: Tensor, contrast: Tensor, seen: Tensor, limit: Tensor) -> Tensor:
    """Brightness `[n]` of the nodes: measured contrast over expected luminance, `[h, w]` each.

    limit: `[h, w]` cd/m^2, least expected luminance of a pixel that counts.
    """
    lit = (seen > 0.5) & (expected > limit)
    there, usual = fine.on_nodes(torch.stack([contrast, expected]) * lit)
    guess = LEAST_LIGHT * usual.mean()
    return torch.where(usual + guess > 0, (there + guess * before) / (usual + guess), before)


def region_of(symbol: SymbolParams, near_m: float, far_m: float, side_m: float) -> Region:
    """Region of the plane around a symbol at its target, with margins in m."""
    half, left = symbol.length_m / 2, symbol.width_m / 2 + side_m
    return Region(max(symbol.x_m - half - near_m, 1.0), symbol.x_m + half + far_m, symbol.y_m + left, symbol.y_m - left)
