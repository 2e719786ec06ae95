"""How bright the zones of a scenario are, beside what was wanted."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from controllers.zones.zone import ZoneParams, region_of
from world.view import View


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
