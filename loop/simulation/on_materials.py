"""What zones and materials get that are to have a light of their own, beside what was wanted."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.functions.material import MaterialLightParams, MaterialParams, MaterialState, Quantity
from luxloop.controllers.functions.zone import ZoneParams, region_of
from luxloop.controllers.situation import Situation
from luxloop.loop.simulation.world import LitScene, World
from luxloop.world.frames import View, inverse, transform


@dataclass(frozen=True)
class InZone:
    """One zone in one step. lx: asked for. luminance, target: cd/m^2, the mean without the camera's noise, None out of its sight and
    where nobody knows it, and the one wanted.
    """

    lx: float
    luminance: float | None
    target: float


def in_zones(functions: Mapping[str, Any], states: Mapping[str, Any], luminance: Tensor | None, view: View) -> Mapping[str, InZone]:
    """The zones among a scenario's functions, by name; luminance: `[height, width]` cd/m^2, None where nobody knows it."""
    found = {}
    for name, function in functions.items():
        if isinstance(function, ZoneParams):
            mean = None
            if luminance is not None and len(seen := luminance[region_of(function, view).to(luminance.device)]):
                mean = float(seen.mean())
            found[name] = InZone(states[name].lx, mean, function.luminance_cd_m2)
    return found


@dataclass(frozen=True)
class OnMaterial:
    """A material in one step, in lx or cd/m^2 as its light says. median: of its pixels, without the camera's noise, None out of sight."""

    quantity: Quantity
    median: float | None
    wanted: float


def quantities(functions: Mapping[str, Any]) -> Mapping[str, Quantity]:
    """Requested quantity by function and material, or range of albedo; where several lights share both, that of the first."""
    found: dict[str, Quantity] = {}
    for name, function in functions.items():
        if isinstance(function, MaterialParams):
            for light in function.lights:
                for label, _ in _named(light):
                    found.setdefault(f"{name}.{label}", light.quantity)
    return found


def on_materials(
    functions: Mapping[str, Any],
    states: Mapping[str, Any],
    now: Situation,
    told: Mapping[str, int],
    world: World,
    illuminance: Tensor,
    luminance: Tensor,
) -> Mapping[str, OnMaterial]:
    """All that have a quantity, where their function asks for it: on objects that it selects, and on its part of the road.

    Of several lights of one label the first is recorded, as in `quantities`.
    states: None of a function that has seen nothing yet. told: ids of objects by their names in the situation. illuminance, luminance:
    `[height, width]` now.
    """
    found: dict[str, OnMaterial] = {}
    for called, function in functions.items():
        if isinstance(function, MaterialParams):
            state, view = states[called], world.lit(now.time_s)
            picture, names = view.materials
            asked = torch.zeros_like(picture, dtype=torch.bool) if state is None else _asked(function, state, now, told, view)
            for number, light in enumerate(function.lights):
                arriving = illuminance if light.quantity == "lx" else luminance
                mine = asked if state is None else asked & (state.light == number)
                for label, name in _named(light):
                    of_it = mine & (picture == names.index(name)) if name in names else mine & (name == "")
                    median = float(arriving[of_it].median()) if bool(of_it.any()) else None
                    found.setdefault(f"{called}.{label}", OnMaterial(light.quantity, median, light.value))
    return found


def _named(light: MaterialLightParams) -> Iterator[tuple[str, str]]:
    """Labels, and the materials that they are of; "" is any."""
    chosen = "" if light.materials and light.albedo == (0.0, 1.0) else "albedo {:g} to {:g}".format(*light.albedo)
    yield from ((f"{name} {chosen}".strip(), name) for name in light.materials or ("",))


def _asked(function: MaterialParams, state: MaterialState, now: Situation, told: Mapping[str, int], view: LitScene) -> Tensor:
    """Where a function asks for light, `[height, width]` bool."""
    surfaces = view.surfaces
    ids = torch.tensor([told[each.name] for each in function.select(now) if each.name in told])
    standing = torch.isin(surfaces.object_id, ids.to(surfaces.object_id)) & ~state.ground
    if function.road_m is None:
        return standing
    T_ground_world = inverse(view.vehicle.T_world_ground).to(surfaces.position)
    x, y, _ = transform(T_ground_world, surfaces.position.flatten(1)).unflatten(1, state.ground.shape)
    near, far = function.road_m
    return standing | state.ground & (x >= near) & (x <= far) & (y.abs() <= function.road_width_m / 2)
