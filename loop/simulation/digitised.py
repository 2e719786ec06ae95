"""A simulated world with one module's light measured on a real lamp. No lamp is connected here."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import torch
from torch import Tensor

from luxloop.controllers.pixels.primitives import names_module
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.protocol import Arrivals, Exposure
from luxloop.loop.simulation.simulated import SimulatedPlant, simulated_plant
from luxloop.loop.simulation.truth import LampModule
from luxloop.loop.simulation.world import World
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight

KEPT: Final = 8  # number of stored light textures; on and off exposures alternate


class MeasuredTextures:
    """Measured light textures of a real lamp for its last utilisations; computed ones of a headlight for any other utilisation."""

    def __init__(self, headlight: Headlight) -> None:
        self._headlight, self._kept = headlight, deque[tuple[Tensor, Tensor]](maxlen=KEPT)

    def keep(self, utilisation: Tensor, texture: Tensor) -> None:
        """Store a measurement. utilisation: `[n_p]`, as shown. texture: `[rows, cols]` cd, as measured."""
        self._kept.append((utilisation, texture.to(utilisation)))

    def light_texture(self, utilisation: Tensor, band: slice | None = None) -> Tensor:
        """Luminous intensity `[..., rows, cols]` in cd of a utilisation `[..., n_p]`."""
        for shown, texture in reversed(self._kept):
            if shown is utilisation or torch.equal(shown, utilisation):
                return texture
        return self._headlight.light_texture(utilisation, band)


@dataclass(frozen=True, eq=False)
class DigitisedPlant:
    """A simulated world awaiting a lamp from `luxloop run --rig`. It can be inspected, but not started.

    key: of the module in the scenario. number: index of the module. measured: its light textures. late: delay of its light in exposures.
    """

    night: SimulatedPlant
    key: str
    number: int
    measured: MeasuredTextures
    late: int

    @property
    def truth(self) -> World:
        """The true world."""
        return self.night.world

    def start(self) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        raise LuxloopError(needs_rig(self.key))

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        return self.start()


def needs_rig(key: str) -> str:
    """Error text: the scenario needs a rig. key: of the digitised module in the scenario."""
    return f"{key}: is digitised from a real lamp; run it with `luxloop run NAME --rig FILE`, or play a recording of it with --plant"


def digitised_plant(scenario: Scenario, modules: Sequence[LampModule], cache: PartCache | None = None) -> DigitisedPlant:
    """The plant of a scenario with a digitised module. Raises LuxloopError as `digitised_number` and `simulated_plant`."""
    number = digitised_number(scenario, [each.name for each in modules])
    measured = MeasuredTextures(modules[number].headlight)
    shining = [replace(each, measured=measured) if k == number else each for k, each in enumerate(modules)]
    late = max(each.late_steps(scenario.rate_hz) for each in scenario.modules.values()) * len(scenario.shares)
    return DigitisedPlant(simulated_plant(scenario, shining, cache), f"modules.{scenario.digitised_module}", number, measured, late)


def digitised_number(scenario: Scenario, names: Sequence[str]) -> int:
    """Index of the digitised module among the names of shining modules. Raises LuxloopError unless exactly one has its name."""
    name = scenario.digitised_module or ""
    found = [k for k, each in enumerate(names) if names_module([name], each)]
    if len(found) != 1:
        told = f"{len(found)} modules are called {name!r}" if found else f"there is no module {name!r}"
        raise LuxloopError(f"modules.{name}: {told}; name one of {', '.join(names)}")
    return found[0]
