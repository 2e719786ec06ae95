"""The light of lighting functions at one moment, for pictures of lamps."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from loop.lighting.simulation import Simulation
from loop.scenario.model import Scenario
from world.errors import LuxloopError
from world.headlight.lamp import REST, Commands, ModuleCommand


def lights_by_side(scenario: Scenario, lamp: str, time_s: float) -> tuple[Mapping[str, Sequence[Tensor]], Mapping[str, Commands]]:
    """Utilisations `[n_p]` and commands, one a module, that a scenario gives a lamp at a time, by side; dark where a module does not shine.

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
    lights, commands = simulation.lights_at(time_s)
    found: dict[str, list[Tensor]] = {}
    turned: dict[str, list[ModuleCommand]] = {}
    for module, u, command in zip(simulation.modules, lights, commands or (REST,) * len(lights), strict=True):
        mine = found.setdefault(module.side, [torch.zeros(each.headlight.n_pixels) for each in module.lamp.modules])
        mine[module.number] = u
        turned.setdefault(module.side, [REST] * len(mine))[module.number] = command
    return found, {side: tuple(each) for side, each in turned.items()}
