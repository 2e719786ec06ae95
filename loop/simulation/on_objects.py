"""The lamps' light on each object that the camera sees."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from luxloop.controllers.functions.objects import GlareFreeParams
from luxloop.controllers.pixels.rthc import masks
from luxloop.controllers.situation import Situation, TrackedObject
from luxloop.loop.simulation.detection import LEAST_PX, Recognised, name_of
from luxloop.loop.simulation.protocol import Showing
from luxloop.loop.simulation.world import LitScene, ObjectLight, World
from luxloop.world.traffic.objects import ObjectParams
from luxloop.world.traffic.tracked import ROAD_USERS

DRIVEN = ROAD_USERS - {"pedestrian"}
DUE_S = 0.3 - 1e-6  # the time that it has for that, less the rounding of clocks


@dataclass(frozen=True)
class OnObject:
    """The lamps' light on what the camera sees of an object: pixels, and lx that are NaN where there are none. masked: it must be dark.

    lx_min, lx_mean, lx_max: means over the exposures of a step. lx_peak: the highest lx_max of one.
    """

    pixels: int
    lx_min: float
    lx_mean: float
    lx_max: float
    lx_peak: float
    masked: bool


def light_on_objects(world: World, showings: Sequence[Showing]) -> list[ObjectLight]:
    """In each exposure, if somebody asks for it."""
    shown = ((each.before.time_s, each.exposure.lights, each.exposure.commands) for each in showings)
    return [world.on_objects(*each) for each in shown] if world.metered else []


def told_as(watched: Mapping[str, int], recognised: Mapping[str, Recognised] | None) -> Mapping[str, int]:
    """Ids of objects by the names under which functions are told of them: their own, with a detector those of their tracks."""
    if recognised is None:
        return watched
    tracks = {name: each.track for name, each in recognised.items()}
    return {name_of(track): number for name, number in watched.items() if (track := tracks.get(name)) is not None}


def on_objects(
    watched: Mapping[str, int], dark: frozenset[int], metered: Sequence[ObjectLight], shares: Sequence[float]
) -> Mapping[str, OnObject]:
    """By name. watched: ids of those that are meant. dark: ids of those that must be. metered: of each exposure, with its share of time."""
    found = {}
    for name, number in watched.items():
        lights = [each.on(number) for each in metered]
        low = mean = high = peak = math.nan
        if all(map(len, lights)):
            each = ([float(what(lx)) for lx in lights] for what in (Tensor.min, Tensor.mean, Tensor.max))
            low, mean, high = (sum(share * lx for share, lx in zip(shares, values, strict=True)) for values in each)
            peak = max(float(lx.max()) for lx in lights)
        found[name] = OnObject(len(lights[0]), low, mean, high, peak, number in dark)
    return found


def near_enough(seen: LitScene, since_s: Mapping[str, float], now_s: float) -> Mapping[str, float]:
    """Since when the drivers and riders who come towards the camera have been LEAST_PX tall and half visible, by name; since_s: as known
    before.
    """
    heading = {placed.body.name: placed.T_world_body[:3, 0].double() for placed in seen.triangles.placed if placed.object_id > 0}
    ahead = seen.view.T_world_view[:3, 2].double()
    near = (
        each.name
        for each in seen.objects
        if seen.given[each.object_id - 1].category in DRIVEN
        and each.whole[3] - each.whole[1] >= LEAST_PX
        and each.visible >= 0.5
        and float(heading[each.name] @ ahead) < 0
    )
    return {name: since_s.get(name, now_s) for name in near}


def on_eyes(
    given: Sequence[ObjectParams], due: Collection[str], metered: Sequence[ObjectLight], shares: Sequence[float]
) -> tuple[float | None, float | None, float | None]:
    """Most light in lx on heads and windscreens of road users, mean over the exposures and highest, and the mean on those that are due.

    None where none is seen in any exposure. given: parameters of the objects 1, 2, ... due: names of some.
    """
    users = {each.name: number for number, each in enumerate(given, 1) if each.category in ROAD_USERS}
    mean, highest = _most(users.values(), metered, shares)
    return mean, highest, _most([users[name] for name in due], metered, shares)[0]


def _most(numbers: Collection[int], metered: Sequence[ObjectLight], shares: Sequence[float]) -> tuple[float | None, float | None]:
    """Most light in lx on heads and windscreens of objects, mean over the exposures and highest; None where none is seen in any."""
    lights = [each.on_eyes(numbers) for each in metered]
    if not any(map(len, lights)):
        return None, None
    most = [float(lx.max()) if len(lx) else 0.0 for lx in lights]
    return sum(share * lx for share, lx in zip(shares, most, strict=True)), max(most)


def must_be_dark(functions: Mapping[str, Any], each: TrackedObject, now: Situation) -> bool:
    """Whether a glare-free function keeps all light off an object: its own mask is there, and not fading."""
    alone = replace(now, objects=(each,))
    there = each.since_s <= now.time_s < each.until_s
    glare_free = (function for function in functions.values() if isinstance(function, GlareFreeParams))
    return there and any(any(masks(part)) for function in glare_free for part in function.primitives(alone))
