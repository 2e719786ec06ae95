"""luxloop: finds the road's heights from how the symbol lies on it, and draws for that road where that explains what is seen."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor

from controllers.symbol.heights.body_filter import BodyFilter, BodyParams
from controllers.symbol.heights.memory import Memory
from controllers.symbol.heights.patch import drawn_on
from controllers.symbol.heights.registration import HEIGHT_M, Heights, Registration
from controllers.symbol.heights.sight import Sight
from controllers.symbol.heights.stance import AT_REST, Following, Stances, ground_at
from controllers.symbol.heights.sweep import sweep
from controllers.symbol.sensing.aim import aimed, elsewhere
from controllers.symbol.sensing.drawing import Drawing
from controllers.symbol.sensing.observer import Observer
from controllers.symbol.sensing.planes import HERE, placed
from controllers.symbol.sensing.projector import SymbolParams
from controllers.symbol.sensing.protocol import Look
from controllers.symbol.sensing.shape import reached
from perception.birdseye import Region
from perception.camera import camera_view
from perception.egomotion import Ego
from perception.extraction import Loss
from world.frames import inverse, transform
from world.frames import pose as pose_of
from world.params import Params
from world.scene.vehicle import LEARNT_M

LEAST_LIT_PX = 20.0  # fewer lit pixels are no symbol
HEIGHTS = 57  # that a sweep tries
SEEN_BY = 0.05  # of the usual illuminance a node, with which its brightness is no longer a guess
LOW_M = {"appearance": 0.1, "place": 0.03}  # heights up to here are found without an acquired shape, for each target
POOR, SEARCHES = 0.08, 4  # residual above which the whole image is searched again, and how often it is for one road
UNEVEN = 0.03  # residual of what was known, above which heights explain the road better than another search would
SAME_M = 0.05  # between heights under the target that two searches found, if the second shall be the last
FALLEN = (-0.3, -0.03, 0.0, 0.0)  # shape of the road on which a symbol is looked for that is nowhere in the image
FARTHEST = 3.0  # of the way to the plane z = 0: where lines of sight end that meet no acquired road
ROAD_M = 4e-3  # how well a track's height is known at best
PITCH_RAD = 5e-4  # usual error of a pitch that is predicted
ROUNDING_S = 1e-6  # of times that are equal

Cell = Annotated[float, Field(ge=0.02, le=10)]
Reach = Annotated[float, Field(ge=0, le=20)]


class LuxloopParams(Params):
    """Finds the road's heights from how the symbol lies on it, and draws for that road. Where they explain nothing it is the open loop."""

    name: Literal["luxloop"] = "luxloop"
    cell_m: tuple[Cell, Cell] = Field((0.2, 0.15), description="distance of heights on the assumed road, along and across")
    beyond_m: tuple[Reach, Reach, Reach] = Field((1.2, 1.5, 0.6), description="how far heights go beyond the symbol: near, far, sides")
    highest_m: float = Field(0.14, gt=0, le=0.3, description="largest height, up or down, that is looked for")
    memory: float = Field(0.6, ge=0, lt=1, description="share of what is known that a step on the move keeps; the rest may have changed")
    evidence: float = Field(
        0.0025, ge=0, le=1e6, description="share of the symbol that heights have to explain beyond what the flat road does"
    )
    sweep_above: float = Field(
        0.01, ge=0, le=1e6, description="share of the symbol that may stay unexplained before all heights are tried anew"
    )
    start_height_m: float = Field(
        0.0, ge=-0.3, le=0.3, description="height that the whole road is taken to have at first; 0: nothing is known"
    )
    body: BodyParams = Field(BodyParams(), description="what the controller believes of its car's springs and wheels")


@dataclass(frozen=True)
class LuxloopState:
    """memory: what is known of the road, in the ground frame of time_s, which is ground in the level one, None before the first look. body:
    what was known of it then, if it is measured.

    drawing: of a vehicle that stands, None on the move, where it depends on what is measured until it is shown. level_rad: pitch of the
    body that the memory's heights are based on. first: the first drawing for an acquired road; None once a look shows it. sought: the
    symbol has been seen, or a road was guessed to look for it on.
    """

    memory: Memory
    time_s: float
    drawing: Drawing | None
    body: BodyFilter | None = None
    level_rad: float = 0.0
    first: Drawing | None = None
    sought: bool = False
    ground: Tensor | None = None


class Luxloop:
    """Registration of the heights of a road that the vehicle may drive over, supervised by the open loop."""

    def __init__(self, params: LuxloopParams, observer: Observer) -> None:
        self.params, self.projector, self.observer = params, observer.projector, observer
        self.region = region_of(self.projector.params, *params.beyond_m)
        self.reach_m = self.projector.params.x_m - self.projector.params.length_m / 4
        self.standing = lru_cache(maxsize=2)(self._standing)
        self.registration = self.over(HERE)[1]
        lamps = torch.stack([module.T_world_headlight[:3, 3].cpu().double() for module in self.projector.modules])
        self.ends = torch.stack([camera_view(observer.camera).origin, *lamps], 1)  # of the ways of light, in the body
        self.in_flight = observer.camera.latency_steps + observer.camera.latency_spread_steps + 2
        self.tried = torch.linspace(-params.highest_m, params.highest_m, HEIGHTS, device=self.projector.symbol.device)

    def start(self, pose: Tensor) -> LuxloopState:
        """State that shows the pose `[4]` first, or the symbol for the road that is believed."""
        memory = self._nothing(self.registration)
        if self.params.start_height_m == 0:
            return LuxloopState(memory, 0.0, Drawing(pose))
        mean = memory.heights.mean + self.params.start_height_m
        believed = _believed(memory, mean)
        return LuxloopState(believed, 0.0, self._drawn(believed))

    def drawing(self, state: LuxloopState, ego: Ego | None) -> Drawing:
        """The symbol for the road as it is known, from where the body will be by what is measured now."""
        if state.drawing is not None:
            return state.drawing
        body = self._filtered(state.body, ego)
        assert ego is not None and body is not None  # or it would stand
        now = body.caught_up()
        memory = state.memory.levelled(now.level_rad - state.level_rad, body.pivot_x_m)
        ground = ground_at(ego, state.time_s) if state.ground is None else state.ground
        return self._drawn(memory, Following.of(ego, now, state.time_s, ground))

    def step(self, state: LuxloopState, look: Look) -> LuxloopState:
        """Register the look; the open loop's drawing, unless heights explain it better than a flat road does.

        What is known of the road tells how the body has pitched since the look before, and what the wheels will come to.
        """
        body, then = state.body, look.shown.ego
        for ego in (then, look.ego):  # a measurement that is newer than the look tells more once the look is taken in
            if ego is not None and then is not None and ego.told_s[-1] < then.time_s + ROUNDING_S:
                body = self._filtered(body, ego)
        now = None if body is None else body.caught_up()
        stances = Stances.of(look, now, state.time_s, state.ground)
        memory, first, sought = state.memory, state.first, state.sought or bool(look.seen.code == Loss.SEEN)
        if anew := look.frames is not None and first is not None and look.shown.drawing.shows(first):
            first = None
        if stances.still:
            registration = self.over(memory.T_ground_plane)[1]
        else:
            memory = memory if memory.T_ground_plane.equal(HERE) else self._nothing(self.registration)
            registration = self._fine(stances)
        memory = memory.moved(stances.since, registration.sight.eye)
        if not stances.still and then is not None and body is not None:
            memory = memory.over(self._heights(self._bent(then, body), memory))
        if body is None or now is None or stances.still:
            memory = self._looked(registration, memory, look, stances, anew)
            if stances.still and not bool(memory.heights.information.any()) and (guess := self._guessed(state, look)) is not None:
                memory, sought = guess, True
        else:
            memory = memory.levelled(now.level_rad - state.level_rad, body.pivot_x_m)
            if look.frames is not None:
                known, predicted = memory, now.at(stances.time_s).pitch_rad
                memory = self._looked(registration, known.loosened(PITCH_RAD, body.pivot_x_m), look, stances)
                pitched = memory.pitched(known, body.pivot_x_m)
                body = body.looked(stances.time_s, None if pitched is None else predicted + pitched - now.level_rad)
                now = body.caught_up()
                memory = memory.levelled(now.level_rad - predicted, body.pivot_x_m)
        if body is not None and look.ego is not None and memory.T_ground_plane.equal(HERE):
            body = _previewed(body, memory, stances, look.ego)
        drawing, level_rad = self._drawn(memory) if stances.still else None, 0.0 if now is None else now.level_rad
        if drawing is not None and drawing.warp is not None:
            memory = memory.showing(drawing, self.in_flight)
        if memory.shape is not state.memory.shape:
            first = None if memory.shape is None else drawing
        return LuxloopState(memory, stances.time_s, drawing, body, level_rad, first, sought, stances.ground)

    def _filtered(self, before: BodyFilter | None, ego: Ego | None) -> BodyFilter | None:
        """What is known of the body after a measurement, if there is one; one without axles has no filter."""
        if ego is None or ego.pivot_x_m == ego.rear_x_m:
            return before
        return BodyFilter.first(self.params.body, ego, self.reach_m, self.projector.params.x_m) if before is None else before.updated(ego)

    def _looked(self, registration: Registration, memory: Memory, look: Look, stances: Stances, anew: bool = False) -> Memory:
        """What is known after a look: nothing, where heights do not explain it. anew: it is the first at light for an acquired road."""
        if look.frames is None:
            return memory
        frames, textures, searched = look.frames, self.projector.textures(look.shown.lights), memory.searched
        nothing = self._nothing(self.registration) if stances.still else self._nothing(registration).over(memory.heights.base)
        fine, known = registration.sight, memory.heights
        informed = bool(known.information.any())
        contrast, limit = fine.observe_symbol(frames, textures)
        seen = fine.symbol(contrast, limit)
        lit = float(seen.sum()) * fine.step >= LEAST_LIT_PX
        limit = limit / fine.on_pixels(memory.brightness)  # of the light that the assumed road would show
        drawn = memory.shown(look.shown.drawing)
        late = [] if drawn is None or drawn.heights is known else [drawn.heights.mean]
        roads = torch.stack([nothing.heights.mean, *[known.mean] * informed, *late])
        leaves = registration.residual(roads, seen, textures, limit).tolist()
        flat_leaves, before = leaves[0], leaves[informed]
        if lit and not informed and flat_leaves <= self.params.evidence:
            return nothing  # for no heights can explain so much more
        unsure = not informed or (anew and not memory.settled and searched < SEARCHES)
        if stances.still and unsure and (acquired := self._acquired(memory, look)) is not None:
            return self._looked(self.over(acquired.T_ground_plane)[1], acquired, look, stances)
        if not lit:
            there = fine.symbol(fine.luminance(textures, fine.on_pixels(known.mean)[None])[0], limit) * fine.inside
            return memory if float(there.sum()) * fine.step < LEAST_LIT_PX else nothing
        if drawn is not None:
            residual = leaves[-1] if late else before
            memory = memory.judged(drawn, residual if residual < flat_leaves else math.inf)
            if memory.kept is not None and memory.kept.done:
                return replace(memory, heights=memory.kept.best.heights, brightness=memory.kept.best.brightness)
        least, best = self._refined(registration, known, known.mean, seen, textures, limit)
        if least > self.params.sweep_above:
            swept = self._swept(memory, frames, textures, stances)
            again = self._refined(registration, known, swept, seen, textures, limit)
            least, best = min((least, best), again, key=lambda each: each[0])
        memory = replace(memory, settled=memory.settled or before > UNEVEN)
        if least > POOR and stances.still and memory.searched == searched < SEARCHES:
            if (acquired := self._acquired(memory, look)) is not None:
                return acquired
            memory = replace(memory, searched=searched + 1)
        if least > flat_leaves - (0.0 if informed else self.params.evidence):
            return nothing
        information = known.information + best.information
        gain = best.information.trace() / information.trace().clamp(min=1)  # of this look beside all earlier ones
        brightness = _brightness(fine, best.mean, memory.brightness, contrast, seen, textures)
        share = (least / before if least < before else 1.0) if stances.still else self.params.memory
        return replace(memory, heights=replace(best, information=share * information), brightness=memory.brightness.lerp(brightness, gain))

    def _refined(
        self, registration: Registration, known: Heights, nodes: Tensor, seen: Tensor, textures: tuple[Tensor, ...], limit: Tensor
    ) -> tuple[float, Heights]:
        """Heights from nodes `[n]` on, and what they leave unexplained."""
        found = registration.refine(nodes, known, seen, textures, limit)
        return float(registration.residual(found.mean[None], seen, textures, limit)[0]), found

    def _acquired(self, memory: Memory, look: Look) -> Memory | None:
        """The road that explains where in the whole image the symbol is; None where a road near the plane may, which looks find without."""
        assert look.frames is not None
        symbol = self.projector.params
        found = look.seen.acquired or self.observer.acquire(look.frames, look.shown.lights)
        if not found.found or float(self._heights(found.shape, self._nothing(self.registration)).abs().max()) < LOW_M[symbol.target]:
            return None
        return self._shaped(memory, found.shape)

    def _guessed(self, state: LuxloopState, look: Look) -> Memory | None:
        """A road to look for the symbol on that is not in the image, though it is shown for the road that was believed.

        Half as high or low as that; after a flat road one that falls, unless the symbol has been seen before, so that something hides it.
        """
        lost, before = look.seen.acquired, state.memory.shape
        if lost is None or lost.found or state.drawing is None or not look.shown.drawing.shows(state.drawing):
            return None
        if before is not None:
            return self._shaped(state.memory, before / 2) if state.memory.searched < SEARCHES else None
        return None if state.sought or lost.match else self._shaped(state.memory, self.projector.target.new_tensor(FALLEN))

    def _shaped(self, before: Memory, shape: Tensor) -> Memory:
        """A road of shape `[4]`, over the plane on which the symbol is aimed there."""
        symbol = self.projector.params
        rise = float((shape - (0 if before.shape is None else before.shape)) @ shape.new_tensor([1.0, 0.0, symbol.y_m, 0.0]))
        plane = aimed(shape, symbol, self.projector.modules, self.ends[:, 0])
        nothing = replace(self._nothing(self.over(plane)[1]), T_ground_plane=plane)
        believed = _believed(nothing, self._heights(shape, nothing))
        return replace(believed, shape=shape, searched=before.searched + 1, settled=abs(rise) < SAME_M)

    def _bent(self, ego: Ego, body: BodyFilter) -> Tensor:
        """Shape `[4]` of a road that bends on as the ground does, which turns by its slope's rate over the speed each m; flat until the
        vehicle has driven so far that the ground follows the road.
        """
        if body.way_m < LEARNT_M:
            return torch.zeros_like(self.projector.target)
        ahead_m, curvature = self.projector.params.x_m - ego.rear_x_m, -ego.ground[3] / ego.speed_m_s.clamp(min=1.0)
        return torch.stack([curvature * ahead_m**2 / 2, curvature * ahead_m, 0 * curvature, curvature]).to(self.projector.target)

    def _heights(self, shape: Tensor, memory: Memory) -> Tensor:
        """Heights `[n]` of a road of shape `[4]` at the nodes of a memory."""
        T, eye = memory.T_ground_plane.to(shape), memory.eye
        origin, ways = transform(T, eye[:, None])[:, 0], T[:3, :3] @ (memory.nodes() - eye[:, None])
        share = reached(shape[None], self.projector.params.x_m, origin, ways)[0].clamp(max=FARTHEST)
        return eye[2] * (1 - share)

    def _swept(self, memory: Memory, frames: tuple[Tensor, Tensor], textures: tuple[Tensor, ...], stances: Stances) -> Tensor:
        coarse = self.over(memory.T_ground_plane)[0] if stances.still else self._coarse(stances)
        contrast, limit = coarse.observe_symbol(frames, textures)
        seen, limit = coarse.symbol(contrast, limit), limit / coarse.on_pixels(memory.brightness)
        return sweep(coarse, seen, textures, limit, self.tried, memory.heights.base)

    def _drawn(self, memory: Memory, following: Following = AT_REST) -> Drawing:
        """The symbol for the road as it is known, from where the body will be then."""
        symbol, plane = self.projector.params, memory.T_ground_plane
        T_plane_body = following.body if plane.equal(HERE) else inverse(plane) @ following.body
        T_body_plane = inverse(T_plane_body)
        if not (memory.heights.information.any() or memory.heights.base.any()):
            return laid(self.projector.target, T_body_plane)
        ends = transform(T_plane_body, self.ends).T.to(memory.eye)
        relief = memory.relief_from(following.until, ends[0])
        drawing = drawn_on(relief, ends[1:], symbol, T_body_plane, symbol.target == "place" or not plane.equal(HERE))
        return replace(drawing, aim=elsewhere(plane, symbol))

    def _nothing(self, registration: Registration) -> Memory:
        """Nothing known of the road."""
        heights, sight = registration.unknown(), registration.sight
        return Memory(heights, torch.ones_like(heights.mean), self.region, (sight.rows, sight.cols), sight.eye)

    def over(self, T_ground_plane: Tensor) -> tuple[Sight, Registration]:
        """What heights over a plane `[4, 4]` are swept and refined with while the vehicle stands."""
        return self.standing(tuple(T_ground_plane.flatten().tolist()))

    def _standing(self, plane: tuple[float, ...]) -> tuple[Sight, Registration]:
        stances = Stances() if plane == tuple(HERE.flatten().tolist()) else Stances().over(HERE.new_tensor(plane).view(4, 4))
        return self._coarse(stances), self._fine(stances)

    def _fine(self, stances: Stances) -> Registration:
        return Registration.prepare(self._sight(stances, 2, 3))

    def _coarse(self, stances: Stances) -> Sight:
        return self._sight(stances, 4, 1)

    def _sight(self, stances: Stances, step: int, samples: int) -> Sight:
        """How the body sees the road when the two frames are exposed."""
        return Sight.prepare(self.observer, self.region, self.params.cell_m, step, samples, stances.on, stances.off)


def _previewed(body: BodyFilter, memory: Memory, stances: Stances, ego: Ego) -> BodyFilter:
    """With the road that the wheels will come to, as it is known after a look when it has left the light."""
    way_m, driven_m = body.unseen(), body.way_m + body.speed_m_s * (stances.time_s - body.time_s)
    x = (way_m - driven_m).to(memory.eye)
    aside = ego.yaw_rate_rad_s / ego.speed_m_s.clamp(min=1.0) * (x - ego.rear_x_m) ** 2 / 2
    half_m = body.params.track_m / 2
    heights, information = memory.tracks(x.expand(2, -1), torch.stack([aside + half_m, aside - half_m]))
    level_m = transform(stances.ground.to(x), torch.stack([x, 0 * x, 0 * x]))[2]  # of the ground
    return body.seen(way_m, level_m + heights, ROAD_M**2 + 1 / information.clamp(min=1e-3))


def _believed(memory: Memory, heights: Tensor) -> Memory:
    """A road whose heights `[n]` are taken for granted until something is seen of it."""
    return replace(memory, heights=Heights(heights, torch.eye(len(heights)).to(heights) / HEIGHT_M**2, heights))


def laid(target: Tensor, T_body_ground: Tensor) -> Drawing:
    """The symbol as it is, for a body, at a target pose `[4]` that lies flat on the ground."""
    if T_body_ground.equal(HERE):
        return Drawing(target)
    centre = T_body_ground.new_tensor([float(target[0]), float(target[1]), 0.0])
    pose, z = placed(T_body_ground @ pose_of(centre, torch.eye(3).to(centre)))
    return Drawing(pose.to(target), z.to(target))


def _brightness(fine: Sight, heights: Tensor, before: Tensor, contrast: Tensor, seen: Tensor, textures: tuple[Tensor, ...]) -> Tensor:
    """Brightness `[n]` of the nodes, from where the light is that falls on such heights."""
    expected = fine.luminance(textures, fine.on_pixels(heights)[None])[0]
    lit = (seen > 0.5) & (expected > 0)
    there, usual = fine.on_nodes(torch.stack([contrast, expected]) * lit)
    guess = SEEN_BY * usual.mean()
    return torch.where(usual + guess > 0, (there + guess * before) / (usual + guess), before)


def region_of(symbol: SymbolParams, near_m: float, far_m: float, side_m: float) -> Region:
    """The plane around a symbol at its target."""
    half, left = symbol.length_m / 2, symbol.width_m / 2 + side_m
    return Region(max(symbol.x_m - half - near_m, 1.0), symbol.x_m + half + far_m, symbol.y_m + left, symbol.y_m - left)
