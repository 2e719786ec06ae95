"""Metrics of light on the true road: symbols against their targets, and the sum of all lights against its setpoint."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.functions.planner import Plan
from luxloop.controllers.pixels.primitives import E_V, I_V, U_ABS, U_REL
from luxloop.controllers.pixels.rthc import trace
from luxloop.controllers.pixels.secondary import PotentialLight
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projector import SymbolParams
from luxloop.loop.simulation.lamps import Lights, ShiningModule
from luxloop.loop.simulation.world import LitScene, World
from luxloop.perception.birdseye import BirdsEye, Region, birds_eye, cells, rectify, region_around
from luxloop.perception.metrics import CELL_M, Metrics, Target, evaluate, target
from luxloop.world.frames import View, inverse, transform
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Commands
from luxloop.world.roads.base import Road
from luxloop.world.scene.vehicle import STANDING

AREA: Final = (21, 11)  # points along and across the target, for the mean height of the road
LEAST_LX = 1.0  # on a surface facing the lamps; less is invisible to road users


@dataclass(frozen=True, eq=False)
class SymbolEvaluator:
    """Compares noise-free light with a symbol's target.

    world: the true world. road: surface of the target, unless the target is an appearance. plane: target plane at the start, see
    `plane_at`. view: the view in the ground frame of an observer, in which the symbol is compared with its appearance on a flat road; None:
    the camera's.
    """

    world: World
    symbol: SymbolParams
    road: Road
    plane: BirdsEye
    goal: Target
    view: View | None = None

    @classmethod
    def of(cls, world: World, symbol: SymbolParams, road: Road, flat_luminance: Tensor, view: View | None = None) -> "SymbolEvaluator":
        """flat_luminance: `[height, width]` cd/m^2 of the symbol at its target on a flat road in the view, by default the true camera's."""
        flat = _plane(symbol, view or world.view, None).to(world.device)
        goal = target(flat_luminance, flat, symbol.length_m, symbol.width_m)
        appears = view is not None or symbol.target == "appearance"
        plane = flat if appears else _plane(symbol, world.view, _places(symbol, road, world, 0.0)).to(world.device)
        return cls(world, symbol, road, plane, goal, view)

    def metrics(self, lights: Lights, time_s: float) -> Metrics:
        """Metrics of an on exposure in the dark at a time, in the camera's view."""
        lit = self.world.lit(time_s)
        return evaluate(lit.through_clear_air(lit.luminance(lights)), self.plane_at(time_s), self.goal)

    def evaluate(self, on: Lights, off: Lights, time_s: float, commands: Commands = ()) -> Metrics:
        """Metrics of the symbol at a time. on, off: light with and without it."""
        return evaluate(self.added(on, off, time_s, commands), self.plane_at(time_s), self.goal)

    def from_above(self, on: Lights, off: Lights, time_s: float, commands: Commands = ()) -> Tensor:
        """Luminance `[rows, cols]` in cd/m^2 of the symbol on the cells of the target's plane."""
        return rectify(self.plane_at(time_s), self.added(on, off, time_s, commands))

    def added(self, on: Lights, off: Lights, time_s: float, commands: Commands = ()) -> Tensor:
        """Luminance `[height, width]` in cd/m^2 of the symbol in the view."""
        if self.view is None:
            return self.world.added(time_s, on, off, commands)
        seen = self.world.through(self.view, time_s)
        with_symbol, without = (seen.light([each.u for each in lights], commands)[1] for lights in (on, off))
        return seen.through_clear_air(with_symbol - without)

    @cached_property
    def area(self) -> Tensor:
        """Points `[3, *AREA]` m of the target's area on the plane of the ground."""
        symbol = self.symbol
        along, across = (torch.linspace(-0.5, 0.5, n, dtype=torch.float64) for n in AREA)
        x, y = torch.meshgrid(symbol.x_m + symbol.length_m * along, symbol.y_m + symbol.width_m * across, indexing="ij")
        return torch.stack([x, y, 0 * x])

    def heights(self, time_s: float) -> Tensor:
        """Heights `[1, N]` m of the road above the points of `area` at a time."""
        return _heights(self.area.flatten(1), self.road, self.world, time_s)

    def road_m(self, times_s: Sequence[float]) -> float:
        """Height in m of the road above the ground plane on the target's middle line, of largest magnitude over the times."""
        x_m, half_m = self.symbol.x_m, self.symbol.length_m / 2
        along = torch.tensor([[x_m - half_m, x_m, x_m + half_m], [self.symbol.y_m] * 3, [0.0] * 3], dtype=torch.float64)
        heights = torch.cat(
            [_heights(along, self.road, self.world, time_s)[0] for time_s in (times_s[:1] if self.world.motion is STANDING else times_s)]
        )
        return float(heights[heights.abs().argmax()])

    def plane_at(self, time_s: float) -> BirdsEye:
        """Bird's-eye view of the target at a time: on the ground plane for an appearance, else on the road."""
        view, motion, appears = self.world.view_from_ground(time_s), self.world.motion, self.symbol.target == "appearance"
        if self.view is not None or motion is STANDING or (appears and view.T_world_view.equal(self.world.view.T_world_view)):
            return self.plane
        places = None if appears else _places(self.symbol, self.road, self.world, time_s)
        return _plane(self.symbol, view, places).to(self.world.device)


def _plane(symbol: SymbolParams, view: View, places: Tensor | None) -> BirdsEye:
    return birds_eye(_region(symbol), view, places)


def _region(symbol: SymbolParams) -> Region:
    return region_around(symbol.x_m, symbol.y_m, symbol.length_m, symbol.width_m, CELL_M)


def _places(symbol: SymbolParams, road: Road, world: World, time_s: float) -> Tensor:
    """Points `[3, rows, cols]` m of the road in the ground frame at a time."""
    flat = cells(_region(symbol))
    return torch.cat([flat[:2], _heights(flat.flatten(1), road, world, time_s).view_as(flat[2:])])


def _heights(flat: Tensor, road: Road, world: World, time_s: float) -> Tensor:
    """Heights `[1, N]` m of the road above points `[3, N]` m on the ground plane at a time."""
    T_world_ground = world.motion.at(time_s).T_world_ground
    x, y, _ = transform(T_world_ground, flat)
    there = torch.stack([x, y, torch.from_numpy(road.z(x.numpy(), y.numpy()))])
    return transform(inverse(T_world_ground), there)[2:]


def over_setpoint(modules: Sequence[ShiningModule], plan: Plan, lights: Sequence[Utilisation], seen: LitScene) -> float | None:
    """Largest ratio of illuminance to setpoint on the visible road; None without a lit road point or without functions.

    modules: as aimed, in the ground frame. Light and setpoint are illuminances of surfaces facing the lamps, so a stone's slope does not
    count. The setpoint is the largest of base beam and functions within the light of one pixel (`_spread`), the resolution of the lamp.
    Setpoints in cd or lx apply to all modules together; relative setpoints of modules add up.
    """
    road = seen.surfaces.position[:, seen.surfaces.object_id == 0]
    points = transform(inverse(seen.vehicle.T_world_ground), road.double()).float()
    if not points.shape[1] or plan.primitives is None:
        return None
    lit, base, added, together = (torch.zeros_like(points[0]) for _ in range(4))
    for module, light in zip(modules, lights, strict=True):
        lamp = module.headlight

        def on_road(texture: Tensor, module: ShiningModule = module) -> Tensor:
            return PotentialLight(module.headlight, texture, module.T_world_module, module.intensity).possible(points)

        beam = lamp.light_texture(module.base(plan))
        full = lamp.light_texture(torch.ones_like(module.flux))
        lit += on_road(lamp.light_texture(light.u))
        base += on_road(_spread(beam, lamp))
        asked = trace(plan.primitives.for_module(module.name).to(beam.device), lamp, module.T_world_module)
        rows, cols = asked.window.slices
        shares, in_cd = torch.zeros_like(beam), torch.zeros_like(beam)
        quantity = torch.full_like(asked.value, asked.quantities[0]) if asked.quantity is None else asked.quantity
        per_share = torch.where(quantity == U_REL, beam[rows, cols], full[rows, cols])
        is_share = (quantity == U_REL) | (quantity == U_ABS)
        shares[rows, cols] = torch.where(is_share, asked.value * per_share, 0.0)
        in_cd[rows, cols] = torch.where((quantity == I_V) | (quantity == E_V), asked.value, 0.0)
        added += on_road(_spread(shares, lamp))
        together = torch.maximum(together, on_road(_spread(in_cd, lamp)))
    most = torch.stack([base, added, together]).amax(0)
    ratios = (lit / most.clamp(min=LEAST_LX))[lit >= LEAST_LX]
    return float(ratios.max()) if len(ratios) else None


def _spread(texture: Tensor, lamp: Headlight) -> Tensor:
    """Largest setpoint `[rows, cols]` of all pixels whose light reaches a texel.

    A pixel averages setpoints over its light, so a setpoint at one edge of the pixel also lights the other edge.
    """
    up, aside = lamp.pixel_extent
    return torch.from_numpy(cv2.dilate(texture.cpu().numpy(), np.ones((2 * up + 1, 2 * aside + 1), np.uint8))).to(texture)
