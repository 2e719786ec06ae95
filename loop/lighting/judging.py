"""How the light lies on the true road, which only a plant that knows the truth can say."""

from dataclasses import dataclass

import torch
from torch import Tensor

from controllers.pixels.ssc import Utilisation
from controllers.symbol.sensing.projector import SymbolParams
from loop.plant.world import World
from perception.birdseye import BirdsEye, Region, birds_eye, cells, region_around
from perception.judge import CELL_M, Target, Verdict, judge, target
from world.frames import inverse, transform
from world.roads.base import Road
from world.scene.vehicle import STANDING
from world.view import View


@dataclass(frozen=True, eq=False)
class Judge:
    """Compares light with the target, without noise.

    world: what is true. road: whose places the target's are, None where the target is an appearance. plane: of the vehicle as it stands at
    first, see `plane_at`.
    """

    world: World
    symbol: SymbolParams
    road: Road | None
    plane: BirdsEye
    goal: Target

    @classmethod
    def of(cls, world: World, symbol: SymbolParams, road: Road, flat_luminance: Tensor) -> "Judge":
        """flat_luminance: `[height, width]` cd/m^2 of the symbol at its target on a flat road, as the true camera sees it."""
        given = None if symbol.target == "appearance" else road
        flat = _plane(symbol, world.view, None).to(world.device)
        goal = target(flat_luminance, flat, symbol.length_m, symbol.width_m)
        plane = flat if given is None else _plane(symbol, world.view, _places(symbol, given, world, 0.0)).to(world.device)
        return cls(world, symbol, given, plane, goal)

    def verdict(self, lights: tuple[Utilisation, ...], time_s: float) -> Verdict:
        """lights: utilisations, one a module, of the on exposure."""
        return self.judged(self.world.lit(time_s).luminance(lights), time_s)

    def judged(self, luminance: Tensor, time_s: float) -> Verdict:
        """luminance: `[height, width]` cd/m^2 that the symbol adds."""
        return judge(luminance, self.plane_at(time_s), self.goal)

    def plane_at(self, time_s: float) -> BirdsEye:
        """Where the target lies, as the camera sees it at a time: the plane of the ground, or the road itself."""
        view, motion = self.world.view_from_ground(time_s), self.world.motion
        if motion is STANDING or (self.road is None and view.T_world_view.equal(self.world.view.T_world_view)):
            return self.plane
        places = None if self.road is None else _places(self.symbol, self.road, self.world, time_s)
        return _plane(self.symbol, view, places).to(self.world.device)


def _plane(symbol: SymbolParams, view: View, places: Tensor | None) -> BirdsEye:
    return birds_eye(_region(symbol), view, places)


def _region(symbol: SymbolParams) -> Region:
    return region_around(symbol.x_m, symbol.y_m, symbol.length_m, symbol.width_m, CELL_M)


def _places(symbol: SymbolParams, road: Road, world: World, time_s: float) -> Tensor:
    """Places `[3, rows, cols]` m of the road in the ground frame of a time."""
    flat, T_world_ground = cells(_region(symbol)), world.motion.at(time_s).T_world_ground
    x, y, _ = transform(T_world_ground, flat.flatten(1))
    there = torch.stack([x, y, torch.from_numpy(road.z(x.numpy(), y.numpy()))])
    return torch.cat([flat[:2], transform(inverse(T_world_ground), there)[2:].view_as(flat[2:])])
