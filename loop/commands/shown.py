"""The light of lighting functions at one moment, for pictures of lamps."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from loop.lighting.simulation import Simulation
from loop.scenario.model import Scenario
from world.errors import LuxloopError


def lights_by_side(scenario: Scenario, lamp: str, time_s: float) -> Mapping[str, Sequence[Tensor]]:
    """Utilisations `[n_p]`, one a module, that a scenario gives a lamp at a time, by side; dark where a module does not shine.

    lamp: preset or lamp file, in place of the scenario's. Raises LuxloopError where the scenario cannot do with it.
    """
    headlight = scenario.headlight.model_copy(update={"model": lamp, "intensity_cd": None})
    try:
        simulation = Simulation.prepare(scenario.model_copy(update={"headlight": headlight}))
    except LuxloopError as error:
        first, *others = error.args
        raise LuxloopError(
            f"{first}; or give --beam, which shows a beam of {lamp} there without what {scenario.name} draws", *others
        ) from error
    found: dict[str, list[Tensor]] = {}
    for module, u in zip(simulation.modules, simulation.lights_at(time_s), strict=True):
        mine = found.setdefault(module.side, [torch.zeros(each.headlight.n_pixels) for each in module.lamp.modules])
        mine[module.number] = u
    return found
