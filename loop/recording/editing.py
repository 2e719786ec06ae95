"""A simulation that goes on with other values of keys."""

from collections.abc import Collection, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from pydantic import BaseModel
from torch import Tensor

from luxloop.loop.recording.record import refuse_unknown_columns
from luxloop.loop.scenario.edits import acts
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.overrides import TAGS
from luxloop.loop.simulation.result import SimulationState
from luxloop.loop.simulation.simulated import SimulatedPlant, driven_plant
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.errors import LuxloopError


def apply_edit(
    simulation: Simulation, state: SimulationState, scenario: Scenario, reached_by: Scenario | None = None
) -> tuple[Simulation, SimulationState]:
    """The simulation with another scenario, and its state before the next step.

    state: after the last step, which a simulation of `reached_by` has done; None where that is this one's. So edits between two steps act
    as one, whatever came between them.
    Functions and controllers of the same kind whose state still fits go on from it; others start. Frames under way show what was there
    when they were taken. Raises LuxloopError as `luxloop.loop.run.prepare`, and where the scenario needs a simulation that starts anew.
    """
    reached_by = reached_by or simulation.scenario
    if acts(simulation.scenario, scenario) == "restart":
        raise LuxloopError(f"{scenario.source}: a run cannot go on with these values; start it anew")
    driven = continue_course(simulation, scenario)
    if driven is not None and reached_by is simulation.scenario:
        return driven, state
    after = driven or Simulation.prepare(scenario, simulation.device, simulation)
    if scenario.plant.kind != "simulated":
        after = replace(after, plant=simulation.plant)  # which may hold a connection or devices
    if (scenario.checks, scenario.functions) != (simulation.scenario.checks, simulation.scenario.functions):
        refuse_unknown_columns(after)
    symbols = {name: each.start() for name, each in after.controlled.items()}
    same = {name for name, each in scenario.functions.items() if _alike(reached_by.functions.get(name), each)}
    functions, symbols = _continue_states(after.planner.start(), state.functions, same), _continue_states(symbols, state.symbols, same)
    commanded = {name: each for name, each in state.commanded.items() if name in after.planner.commanding}
    return after, replace(state, functions=functions, symbols=symbols, commanded=commanded)


def _continue_states(fresh: Mapping[str, Any], old: Mapping[str, Any], same: Collection[str]) -> dict[str, Any]:
    return {name: old[name] if name in same and name in old and _fits(old[name], each) else each for name, each in fresh.items()}


def _alike(a: Any, b: Any) -> bool:
    """Whether parameters are of the same variants, all tables in them as well."""
    if not (isinstance(a, BaseModel) or isinstance(b, BaseModel)):
        return True
    return type(a) is type(b) and all(each == getattr(b, key) if key in TAGS else _alike(each, getattr(b, key)) for key, each in a)


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


def continue_course(simulation: Simulation, scenario: Scenario) -> Simulation | None:
    """The simulation with another scenario, where that has another course of a vehicle that roams, or other steps, and nothing else."""
    before, plant = simulation.scenario, simulation.plant
    if before.vehicle is None or scenario.vehicle is None or not scenario.vehicle.roams or not isinstance(plant, SimulatedPlant):
        return None
    vehicle = before.vehicle.model_copy(update={"course": scenario.vehicle.course})
    if before.model_copy(update={"vehicle": vehicle, "steps": scenario.steps}) != scenario:
        return None
    cache = simulation.cache.copy()
    plant, controlled = driven_plant(plant, scenario, cache), {}
    for name, each in simulation.controlled.items():
        if (judge := each.judge) is not None:
            judge = replace(judge, world=plant.world)
        controlled[name] = replace(each, judge=judge)
    cache.end()
    return replace(simulation, scenario=scenario, plant=plant, controlled=controlled, cache=cache)
