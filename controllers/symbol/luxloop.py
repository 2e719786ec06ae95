"""luxloop: finds the road's heights from how the symbol lies on it, and draws for that road where that explains what is seen."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor

from controllers.symbol.drawing import Drawing, warp_onto
from controllers.symbol.memory import Memory
from controllers.symbol.observer import Observer
from controllers.symbol.projector import SymbolParams
from controllers.symbol.protocol import Look, Shown
from controllers.symbol.registration import HEIGHT_M, Heights, Registration
from controllers.symbol.sight import Sight
from controllers.symbol.stance import HERE, Stances
from controllers.symbol.sweep import sweep
from controllers.symbol.swing import TRACK_M, Swing
from perception.birdseye import Region
from perception.camera import camera_view
from perception.egomotion import Ego
from world.frames import inverse, transform
from world.params import Params

LEAST_LIT_PX = 20.0  # fewer lit pixels are no symbol
HEIGHTS = 57  # that a sweep tries
SEEN_BY = 0.05  # of the usual illuminance a node, with which its brightness is no longer a guess
ROAD_M = 4e-3  # how well a track's height is known at best
PITCH_RAD = 5e-4  # usual error of a pitch that is foretold

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


@dataclass(frozen=True)
class LuxloopState:
    """memory: what is known of the road, in the ground frame of time_s. swing: of the body, if it is measured. drawing: shown now.

    level_rad: pitch of the body that the memory's heights are based on.
    """

    memory: Memory
    time_s: float
    drawing: Drawing
    swing: Swing | None = None
    level_rad: float = 0.0


class Luxloop:
    """Registration of the heights of a road that the vehicle may drive over, supervised by the open loop."""

    def __init__(self, params: LuxloopParams, observer: Observer) -> None:
        self.params, self.projector, self.observer = params, observer.projector, observer
        self.region = region_of(self.projector.params, *params.beyond_m)
        self.reach_m = self.projector.params.x_m - self.projector.params.length_m / 4
        self.coarse, self.registration = self._coarse(Stances()), self._fine(Stances())
        lamps = torch.stack([module.T_world_headlight[:3, 3].cpu().double() for module in self.projector.modules])
        self.ends = torch.stack([camera_view(observer.camera).origin, *lamps], 1)  # of the ways of light, in the body
        self.tried = torch.linspace(-params.highest_m, params.highest_m, HEIGHTS, device=self.projector.symbol.device)

    def start(self, pose: Tensor) -> LuxloopState:
        """State that shows the pose `[4]` first, or the symbol for the road that is believed."""
        memory = self._nothing(self.registration)
        if self.params.start_height_m == 0:
            return LuxloopState(memory, 0.0, Drawing(pose))
        mean = memory.heights.mean + self.params.start_height_m
        believed = replace(memory, heights=Heights(mean, torch.eye(len(mean)).to(mean) / HEIGHT_M**2))
        return LuxloopState(believed, 0.0, self._drawn(believed, Stances()))

    def drawing(self, state: LuxloopState) -> Drawing:
        """The symbol for the road as it is known."""
        return state.drawing

    def step(self, state: LuxloopState, look: Look) -> LuxloopState:
        """Register the look; the open loop's drawing, unless heights explain it better than a flat road does.

        What is known of the road tells how the body has pitched since the look before, and what the wheels will come to.
        """
        swing = self._swung(state.swing, look.ego)
        now = None if swing is None else swing.caught_up()
        stances = Stances.of(look, now, state.time_s)
        registration = self.registration if stances.still else self._fine(stances)
        memory = state.memory.moved(stances.since, registration.sight.eye)
        if swing is None or now is None or stances.still or not swing.foretold(stances.time_s):
            if look.frames is not None:
                memory = self._looked(registration, memory, look.frames, look.shown, stances)
        else:
            memory = memory.levelled(now.level_rad - state.level_rad, swing.pivot_x_m)
            if look.frames is not None:
                known, foretold = memory, now.at(stances.time_s).pitch_rad
                memory = self._looked(registration, known.loosened(PITCH_RAD, swing.pivot_x_m), look.frames, look.shown, stances)
                pitched = memory.pitched(known, swing.pivot_x_m)
                swing = swing.looked(stances.time_s, None if pitched is None else foretold + pitched - now.level_rad)
                now = swing.caught_up()
                memory, stances = memory.levelled(now.level_rad - foretold, swing.pivot_x_m), Stances.of(look, now, state.time_s)
        if swing is not None and look.ego is not None:
            swing = _previewed(swing, memory, stances.time_s, look.ego)
        return LuxloopState(memory, stances.time_s, self._drawn(memory, stances), swing, 0.0 if now is None else now.level_rad)

    def _swung(self, before: Swing | None, ego: Ego | None) -> Swing | None:
        """What is known of the body after a measurement, if there is one; one without axles does not swing."""
        if ego is None or ego.pivot_x_m == ego.rear_x_m:
            return before
        return Swing.first(ego, self.reach_m, self.projector.params.x_m) if before is None else before.updated(ego)

    def _looked(self, registration: Registration, memory: Memory, frames: tuple[Tensor, Tensor], shown: Shown, stances: Stances) -> Memory:
        """What is known after a look: nothing, where heights do not explain it."""
        fine, known = registration.sight, memory.heights
        textures = tuple(
            module.pixel_controller.headlight.light_texture(light.u - module.pixel_controller.default)
            for module, light in zip(self.projector.modules, shown.lights, strict=True)
        )
        contrast, limit = fine.observe_symbol(frames, textures)
        seen = fine.symbol(contrast, limit)
        if float(seen.sum()) * fine.step < LEAST_LIT_PX:
            return self._nothing(registration)
        limit = limit / fine.on_pixels(memory.brightness)  # of the light that the assumed road would show
        found = [registration.refine(known.mean, known, seen, textures, limit)]
        if float(registration.residual(found[0].mean[None], seen, textures, limit)[0]) > self.params.sweep_above:
            swept = self._swept(memory, frames, textures, stances)
            found.append(registration.refine(swept, known, seen, textures, limit))
        nodes = torch.stack([*(each.mean for each in found), known.mean, torch.zeros_like(known.mean)])
        *residuals, before, flat = registration.residual(nodes, seen, textures, limit)
        least, best = min(zip(residuals, found, strict=True), key=lambda each: float(each[0]))
        evidence = 0.0 if bool(known.information.any()) else self.params.evidence
        if least > flat - evidence:
            return self._nothing(registration)
        information = known.information + best.information
        gain = best.information.trace() / information.trace().clamp(min=1)  # of this look beside all earlier ones
        brightness = _brightness(fine, best.mean, memory.brightness, contrast, seen, textures)
        share = (least / before).nan_to_num(1.0).clamp(max=1) if stances.still else self.params.memory
        return replace(memory, heights=Heights(best.mean, share * information), brightness=memory.brightness.lerp(brightness, gain))

    def _swept(self, memory: Memory, frames: tuple[Tensor, Tensor], textures: tuple[Tensor, ...], stances: Stances) -> Tensor:
        coarse = self.coarse if stances.still else self._coarse(stances)
        contrast, limit = coarse.observe_symbol(frames, textures)
        return sweep(coarse, coarse.symbol(contrast, limit), textures, limit / coarse.on_pixels(memory.brightness), self.tried)

    def _drawn(self, memory: Memory, stances: Stances) -> Drawing:
        """The symbol for the road as it is known, from where the body will be then."""
        symbol, target = self.projector.params, self.projector.target
        pose, z = laid(target, inverse(stances.following))
        if not memory.heights.information.any():
            return Drawing(pose, z)
        ends = transform(stances.following, self.ends).T.to(target)
        relief = memory.moved(stances.until, ends[0]).relief()
        return Drawing(pose, z, warp_onto(relief, ends[1:], (symbol.x_m, symbol.y_m), symbol.length_m, symbol.width_m))

    def _nothing(self, registration: Registration) -> Memory:
        """Nothing known of the road."""
        heights, sight = registration.unknown(), registration.sight
        return Memory(heights, torch.ones_like(heights.mean), self.region, (sight.rows, sight.cols), sight.eye)

    def _fine(self, stances: Stances) -> Registration:
        return Registration.prepare(self._sight(stances, 2, 3))

    def _coarse(self, stances: Stances) -> Sight:
        return self._sight(stances, 4, 1)

    def _sight(self, stances: Stances, step: int, samples: int) -> Sight:
        """How the body sees the road when the two frames are exposed."""
        seer, cell_m = self.observer, self.params.cell_m
        return Sight.prepare(
            self.projector, seer.camera, seer.params, seer.model.albedo, self.region, cell_m, step, samples, stances.on, stances.off
        )


def _previewed(swing: Swing, memory: Memory, time_s: float, ego: Ego) -> Swing:
    """With the road that the wheels will come to, as it is known at a time when it has left the light."""
    way_m, driven_m = swing.unseen(), swing.way_m + swing.speed_m_s * (time_s - swing.time_s)
    x = (way_m - driven_m).to(memory.eye)
    aside = ego.yaw_rate_rad_s / ego.speed_m_s.clamp(min=1.0) * (x - ego.rear_x_m) ** 2 / 2
    heights, information = memory.tracks(x.expand(2, -1), torch.stack([aside + TRACK_M / 2, aside - TRACK_M / 2]))
    return swing.seen(way_m, heights, ROAD_M**2 + 1 / information.clamp(min=1e-3))


def laid(target: Tensor, T_body_ground: Tensor) -> tuple[Tensor, Tensor | None]:
    """Pose `[4]` and height in m of a rectangle for a body, that lies at a target pose on the ground; its yaw of some 1e-4 is left out."""
    if T_body_ground.equal(HERE):
        return target, None
    T = T_body_ground
    centre = transform(T, T.new_tensor([[float(target[0])], [float(target[1])], [0.0]]))[:, 0]
    angles = torch.stack([torch.atan2(T[2, 1], T[2, 2]), torch.asin(-T[2, 0])])
    return torch.cat([centre[:2], angles]).to(target), centre[2].to(target)


def _brightness(fine: Sight, heights: Tensor, before: Tensor, contrast: Tensor, seen: Tensor, textures: tuple[Tensor, ...]) -> Tensor:
    """Brightness `[n]` of the nodes, from where the light is that falls on such heights."""
    expected = fine.luminance(textures, fine.on_pixels(heights)[None])[0]
    lit = (seen > 0.5) & (expected > 0)
    there, usual = fine.on_nodes(torch.stack([contrast, expected]) * lit)
    guess = SEEN_BY * usual.mean()
    return (there + guess * before) / (usual + guess)


def region_of(symbol: SymbolParams, near_m: float, far_m: float, side_m: float) -> Region:
    """The plane around a symbol at its target."""
    half, left = symbol.length_m / 2, symbol.width_m / 2 + side_m
    return Region(max(symbol.x_m - half - near_m, 1.0), symbol.x_m + half + far_m, symbol.y_m + left, symbol.y_m - left)
