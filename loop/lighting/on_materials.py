"""What materials get that are to have a light of their own, beside what was wanted."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from controllers.situation import Situation
from controllers.zones.material import MaterialLightParams, MaterialParams, MaterialState, Quantity
from loop.lighting.view import LitScene
from world.frames import inverse, transform


@dataclass(frozen=True)
class OnMaterial:
    """A material in one step, in lx or cd/m^2 as its light says. median: of its pixels, without the camera's noise, None out of sight."""

    quantity: Quantity
    median: float | None
    wanted: float


def quantities(functions: Sequence[Any]) -> Mapping[str, Quantity]:
    """What is asked for, by name of the material, or range of albedo; of several lights that share it the first is told alone."""
    found: dict[str, Quantity] = {}
    for light in (light for function in functions if isinstance(function, MaterialParams) for light in function.lights):
        for label, _ in _named(light):
            found.setdefault(label, light.quantity)
    return found


def on_materials(
    functions: Sequence[Any],
    states: Sequence[Any],
    now: Situation,
    told: Mapping[str, int],
    view: LitScene,
    illuminance: Tensor,
    luminance: Tensor,
) -> Mapping[str, OnMaterial]:
    """All that have a quantity, where their function asks for it: on objects that it selects, and on its part of the road.

    Of several lights of one label the first is told alone, as in `quantities`.
    states: once the view has been seen. told: ids of objects by their names in the situation. illuminance, luminance: `[height, width]`.
    """
    found: dict[str, OnMaterial] = {}
    for function, state in zip(functions, states, strict=True):
        if isinstance(function, MaterialParams):
            asked, (picture, names) = _asked(function, state, now, told, view), view.materials
            for number, light in enumerate(function.lights):
                mine, arriving = asked & (state.light == number), illuminance if light.quantity == "lx" else luminance
                for label, name in _named(light):
                    of_it = mine & (picture == names.index(name)) if name in names else mine & (name == "")
                    median = float(arriving[of_it].median()) if bool(of_it.any()) else None
                    found.setdefault(label, OnMaterial(light.quantity, median, light.value))
    return found


def _named(light: MaterialLightParams) -> Iterator[tuple[str, str]]:
    """Labels, and the materials that they are of; "" is any."""
    chosen = "" if light.materials and light.albedo == (0.0, 1.0) else "albedo {:g} to {:g}".format(*light.albedo)
    yield from ((f"{name} {chosen}".strip(), name) for name in light.materials or ("",))


def _asked(function: MaterialParams, state: MaterialState, now: Situation, told: Mapping[str, int], view: LitScene) -> Tensor:
    """Where a function asks for light, `[height, width]` bool."""
    surfaces = view.surfaces
    ids = torch.tensor([told[each.name] for each in function.selected(now) if each.name in told])
    standing = torch.isin(surfaces.object_id, ids.to(surfaces.object_id)) & ~state.ground
    if function.road_m is None:
        return standing
    x, y, _ = transform(inverse(now.T_world_vehicle).to(surfaces.position), surfaces.position.flatten(1)).unflatten(1, state.ground.shape)
    near, far = function.road_m
    return standing | state.ground & (x >= near) & (x <= far) & (y.abs() <= function.road_width_m / 2)
