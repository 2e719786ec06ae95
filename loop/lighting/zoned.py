"""How bright the zones of a lighting scenario are, beside what was wanted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from controllers.zones.zone import ZoneParams
from perception.regions import box_region
from world.view import View


@dataclass(frozen=True)
class InZone:
    """One zone in one step. lx: asked for. luminance, target: cd/m^2, the mean without the camera's noise, and what is wanted."""

    lx: float
    luminance: float
    target: float


def in_zones(functions: Sequence[Any], states: Sequence[Any], luminance: Tensor, view: View) -> Mapping[str, InZone]:
    """The zones among a scenario's functions, by name, that the view sees; luminance: `[height, width]` cd/m^2."""
    found = {}
    for function, state in zip(functions, states, strict=True):
        if isinstance(function, ZoneParams):
            seen = luminance[box_region(view, *function.box).to(luminance.device)]
            found[function.name] = InZone(state.lx, float(seen.mean()), function.luminance_cd_m2)
    return found
