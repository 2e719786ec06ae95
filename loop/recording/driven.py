"""A simulation whose vehicle somebody drives: it goes on along a longer course, and all else stays as it was made."""

from dataclasses import replace

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.simulated import SimulatedPlant, driven_plant
from luxloop.loop.simulation.simulation import Simulation


def driven_on(simulation: Simulation, scenario: Scenario) -> Simulation | None:
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
