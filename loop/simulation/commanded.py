"""Modules moved or dimmed by functions, and functions that move nothing."""

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
    """Notes on functions that only follow the car's motion, if the simulated car stands; else empty."""
    if scenario.vehicle is not None or not isinstance(scenario.plant, SimulatedPlantParams):
        return []
    return [
        f"functions.{name} ({function.kind}) does nothing, for a car that stands neither turns nor pitches; give a [vehicle] that drives"
        for name, function in scenario.functions.items()
        if isinstance(function, BendingParams) or (isinstance(function, LevellingParams) and not function.entries)
    ]


def moved(planner: Planner, modules: Sequence[ShiningModule]) -> list[tuple[str, Movement]]:
    """Commanded modules and their movements. A user's function may command every movement of every module."""

    def of(function: object, module: ShiningModule, movement: Movement) -> bool:
        return not isinstance(function, CommandParams) or (movement in function.movements and function.moves(module))

    functions = planner.commanding.values()
    return [
        (module.name, movement) for module in modules for movement in MOVEMENTS if any(of(each, module, movement) for each in functions)
    ]
