"""The light of a scenario's functions at one time, for pictures of lamps."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import REST, Commands, ModuleCommand


def lights_by_side(scenario: Scenario, lamp: str, time_s: float) -> tuple[Mapping[str, Sequence[Tensor]], Mapping[str, Commands]]:
    """Utilisations `[n_p]` and commands of a lamp's modules in a scenario at a time, by side; zero for modules that are off.

    lamp: preset or lamp file that replaces the scenario's. Raises LuxloopError where the scenario cannot use it.
    """
    headlight = scenario.headlight.model_copy(update={"model": lamp, "intensity_cd": None})
    try:
        simulation = Simulation.prepare(scenario.model_copy(update={"headlight": headlight}))
    except LuxloopError as error:
        first, *others = error.args
        raise LuxloopError(
            f"{lamp} cannot show what {scenario.name} draws; give --beam for a beam of {lamp} there, or correct this: {first}", *others
        ) from error
    lights, commands = simulation.lights_at(time_s)
    found: dict[str, list[Tensor]] = {}
    turned: dict[str, list[ModuleCommand]] = {}
    for module, u, command in zip(simulation.modules, lights, commands or (REST,) * len(lights), strict=True):
        mine = found.setdefault(module.side, [torch.zeros(each.headlight.n_pixels) for each in module.lamp.modules])
        mine[module.number] = u
        turned.setdefault(module.side, [REST] * len(mine))[module.number] = command
    return found, {side: tuple(each) for side, each in turned.items()}
