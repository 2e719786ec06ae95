"""A scenario whose vehicle somebody drives: its course goes on step by step."""

from loop.scenario.model import Scenario
from world.errors import LuxloopError
from world.scene.driver import Controls, driven, taken_over


def begun(scenario: Scenario, step: int) -> Scenario:
    """The scenario for somebody who drives from a step on: the road is there all around, the course stays as it is from then on, and what
    traffic was made along it so far are objects, whose ways do not depend on it.

    Raises LuxloopError where the vehicle cannot be driven.
    """
    vehicle = scenario.vehicle
    if vehicle is None:
        raise LuxloopError("drive: the vehicle stands in this scenario; set vehicle.course=[{speed_m_s=0.0}], which starts the run anew")
    if scenario.plant.kind != "simulated":
        raise LuxloopError(f'drive: the plant {scenario.plant.kind} cannot be driven; set plant.kind = "simulated"')
    course = taken_over(vehicle.course, step / scenario.rate_hz)
    vehicle = vehicle.model_copy(update={"course": course, "roams": True})
    return scenario.model_copy(update={"vehicle": vehicle, "traffic": None, "objects": scenario.all_objects})


def driven_a_step(scenario: Scenario, step: int, controls: Controls) -> tuple[Scenario, tuple[str, ...]]:
    """The scenario that goes on for a step and for the one after it, with what has begun, and the overrides that make it of the one before."""
    assert scenario.vehicle is not None
    course = scenario.vehicle.course
    added = driven(scenario.vehicle, step / scenario.rate_hz, (step + 1) / scenario.rate_hz, controls)
    texts = [
        f"vehicle.course[{k}]={{time_s={each.time_s!r}, speed_m_s={each.speed_m_s!r}, curvature_1_m={each.curvature_1_m!r}}}"
        for k, each in enumerate(added, len(course))
    ]
    vehicle = scenario.vehicle.model_copy(update={"course": (*course, *added)}) if added else scenario.vehicle
    return scenario.model_copy(update={"vehicle": vehicle, "steps": step + 2}), (f"steps={step + 2}", *texts)
