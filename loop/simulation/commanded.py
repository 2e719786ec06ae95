"""Modules that functions turn and dim: which they are, and functions that cannot."""

from collections.abc import Sequence

from luxloop.controllers.functions.commands import (
    MOVEMENTS,
    BendingParams,
    CommandParams,
    LevellingParams,
    Movement,
)
from luxloop.controllers.functions.planner import Planner
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.plant import SimulatedPlantParams
from luxloop.loop.simulation.lamps import ShiningModule


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
        return not isinstance(function, CommandParams) or (movement in function.movements and function.moves(module))

    functions = planner.commanding.values()
    return [
        (module.name, movement) for module in modules for movement in MOVEMENTS if any(of(each, module, movement) for each in functions)
    ]
