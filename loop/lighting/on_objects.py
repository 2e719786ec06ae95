"""The lamps' light on each object that the camera sees."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from torch import Tensor

from loop.lighting.sight import Recognised, name_of
from loop.plant.world import LitScene


@dataclass(frozen=True)
class OnObject:
    """The lamps' light on what the camera sees of an object: pixels, and lx that are NaN where there are none. masked: it must be dark."""

    pixels: int
    lx_min: float
    lx_mean: float
    lx_max: float
    masked: bool


def told_as(watched: Mapping[str, int], recognised: Mapping[str, Recognised] | None) -> Mapping[str, int]:
    """Ids of objects by the names under which functions are told of them: their own, with a detector those of their tracks."""
    if recognised is None:
        return watched
    tracks = {name: each.track for name, each in recognised.items()}
    return {name_of(track): number for name, number in watched.items() if (track := tracks.get(name)) is not None}


def on_objects(watched: Mapping[str, int], dark: frozenset[int], view: LitScene, illuminance: Tensor) -> Mapping[str, OnObject]:
    """By name. watched: ids of those that are meant. dark: ids of those that must be. illuminance: `[height, width]` lx."""
    found = {}
    for name, number in watched.items():
        lx = illuminance.flatten()[view.pixels[number - 1]]
        low, mean, high = (float(value) for value in (lx.min(), lx.mean(), lx.max())) if len(lx) else [math.nan] * 3
        found[name] = OnObject(len(lx), low, mean, high, number in dark)
    return found
