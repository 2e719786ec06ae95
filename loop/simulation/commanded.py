"""Modules that functions turn and dim: what is commanded in a step."""

from collections.abc import Mapping, Sequence

from luxloop.controllers.functions.commands import (
    MOVEMENTS,
    BendingParams,
    CommandParams,
    DirectParams,
    FunctionCommands,
    LevellingParams,
    Movement,
    compose,
)
from luxloop.controllers.functions.planner import Planner
from luxloop.controllers.situation import Situation
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.plant import SimulatedPlantParams
from luxloop.loop.simulation.check import at_rest
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.loop.simulation.lamps import ShiningModule
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import REST


def commanded(
    planner: Planner,
    modules: Sequence[ShiningModule],
    controlled: Mapping[str, ControlledSymbol],
    given: Mapping[str, FunctionCommands],
    now: Situation,
) -> tuple[Situation, Mapping[str, FunctionCommands]]:
    """The situation with modules as functions command them, and what each of these commanded. given: the same before.

    Raises LuxloopError where a function of the user's own commands a module that a controller needs at rest.
    """
    given = planner.command(given, now, modules)
    if not given:
        return now, given
    commands = compose(given.values(), modules)
    for symbol, held in controlled.items():
        for k in held.drawn_by:
            if commands[k] != REST:
                raise LuxloopError(at_rest(symbol, modules[k].name, "turned or dimmed"))
    return now.under(commands), given


def unmoved(scenario: Scenario) -> list[str]:
    """A sentence for each function that only follows the car's motion, where the simulated car stands; empty where there is none."""
    if scenario.vehicle is not None or not isinstance(scenario.plant, SimulatedPlantParams):
        return []
    return [
        f"functions.{name} ({function.kind}) does nothing, for a car that stands neither turns nor pitches; give a [vehicle] that drives"
        for name, function in scenario.functions.items()
        if isinstance(function, BendingParams) or (isinstance(function, LevellingParams) and not function.entries)
    ]


def moved(planner: Planner, modules: Sequence[ShiningModule]) -> list[tuple[str, Movement]]:
    """What functions command: names of modules, and how they move, which a function of the user's own says of none."""

    def of(function: object, module: ShiningModule, movement: Movement) -> bool:
        if isinstance(function, DirectParams):
            return function.moves(module)
        return not isinstance(function, CommandParams) or (function.movement == movement and function.moves(module))

    functions = planner.commanding.values()
    return [
        (module.name, movement) for module in modules for movement in MOVEMENTS if any(of(each, module, movement) for each in functions)
    ]
