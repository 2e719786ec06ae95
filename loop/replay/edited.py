"""A simulation that goes on with other values of keys: functions and their controllers change from one step to the next."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, Final

from torch import Tensor

from controllers.functions.planner import Planner
from loop.lighting.commanded import refuse_commands
from loop.lighting.controlled import controlled_symbols
from loop.lighting.names import check_names
from loop.lighting.result import SimulationState
from loop.lighting.simulation import Simulation
from loop.scenario.model import Scenario
from loop.scenario.shipped import named
from world.errors import located

LIVE: Final = frozenset({"name", "description", "functions", "conditions", "judge_every", "checks"})  # world and lamps stay


def is_live(before: Scenario, after: Scenario) -> bool:
    """Whether a simulation of the one scenario can go on with the other: world, lamps and exposures are the same."""
    painted = {"painted": after.lighting.painted}
    before = before.model_copy(update={"lighting": before.lighting.model_copy(update=painted)})
    same = all(getattr(before, key) == getattr(after, key) for key in Scenario.model_fields.keys() - LIVE)
    return same and before.shares == after.shares and before.metered == after.metered


def edited(simulation: Simulation, state: SimulationState, scenario: Scenario) -> tuple[Simulation, SimulationState]:
    """The simulation with a scenario that `is_live`, and its state before the next step.

    Functions and controllers whose state still fits go on from it; others start. Raises LuxloopError as `Simulation.prepare`.
    """
    with located(scenario.source):
        planner = Planner.prepare(scenario.functions, scenario.lighting, lambda image: named(image, "symbols"))
        check_names(scenario, simulation.modules)
        controlled = controlled_symbols(scenario, simulation.modules, planner, simulation.truth)
        refuse_commands(planner, simulation.modules, controlled)
    held = {name: each.start() for name, each in controlled.items()}
    functions, kept = _kept(planner.start(), state.functions), _kept(held, state.held)
    commanded = {name: each for name, each in state.commanded.items() if name in planner.commanding}
    after = replace(simulation, scenario=scenario, planner=planner, controlled=controlled)
    return after, replace(state, functions=functions, held=kept, commanded=commanded)


def _kept(fresh: Mapping[str, Any], old: Mapping[str, Any]) -> dict[str, Any]:
    return {name: old[name] if name in old and _fits(old[name], each) else each for name, each in fresh.items()}


def _fits(old: Any, fresh: Any) -> bool:
    """Whether a state has the form of a fresh one: what is unknown at first, None, may have become known."""
    if fresh is None or old is None:
        return True
    if type(old) is not type(fresh):
        return False
    if isinstance(old, Tensor):
        return old.shape == fresh.shape
    if is_dataclass(old):
        return all(_fits(getattr(old, each.name), getattr(fresh, each.name)) for each in fields(old))
    if isinstance(old, tuple) and len(old) == len(fresh):
        return all(_fits(*pair) for pair in zip(old, fresh, strict=True))
    return True
