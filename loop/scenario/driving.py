"""A scenario whose vehicle somebody drives: its course goes on step by step."""

from collections.abc import Iterator
from typing import Any

from luxloop.loop.scenario.edits import Edit, with_overrides
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.overrides import tables
from luxloop.world.errors import LuxloopError
from luxloop.world.scene.driver import Controls, drive_on, let_go, taken_over
from luxloop.world.scene.vehicle import CourseParams, VehicleParams
from luxloop.world.traffic.generator import DriveParams
from luxloop.world.validation import toml, validate_model

MOST_STEPS = 100_000


def begin_drive(scenario: Scenario, step: int) -> Scenario:
    """The scenario for somebody who drives from a step on: the road is there all around, the course stays as it is from then on, and the
    traffic remains that which was met along the course so far.

    Raises LuxloopError where the vehicle cannot be driven.
    """
    vehicle = _vehicle(scenario)
    if scenario.plant.kind != "simulated":
        raise LuxloopError(f'drive: the plant {scenario.plant.kind} cannot be driven; set plant.kind = "simulated"')
    traffic = scenario.traffic
    if traffic is not None and traffic.drive is None:
        met = DriveParams(course=vehicle.course, lasts_s=scenario.steps / scenario.rate_hz)
        traffic = traffic.model_copy(update={"drive": met})
    vehicle = vehicle.model_copy(update={"course": taken_over(vehicle.course, step / scenario.rate_hz), "roams": True})
    return scenario.model_copy(update={"vehicle": vehicle, "traffic": traffic, "steps": _steps(step)})


def continue_drive(scenario: Scenario, step: int, controls: Controls) -> tuple[Scenario, tuple[str, ...]]:
    """The scenario with a course for one step more, and the overrides that make it.

    Raises LuxloopError where it has as many steps as can be.
    """
    added = drive_on(_vehicle(scenario), step / scenario.rate_hz, (step + 1) / scenario.rate_hz, controls)
    return _longer(scenario, added, _steps(step))


def end_drive(scenario: Scenario, step: int, steps: int) -> tuple[Scenario, tuple[str, ...]]:
    """The same where nobody drives any more, with at least as many steps as given: the vehicle goes straight on as fast as it is."""
    return _longer(scenario, let_go(_vehicle(scenario), step / scenario.rate_hz), max(scenario.steps, steps))


def with_drive(scenario: Scenario, now: Scenario) -> Scenario:
    """A scenario with the course that was driven in another one, if that was."""
    if now.vehicle is None or scenario.vehicle is None or not now.vehicle.roams:
        return scenario
    vehicle, traffic = scenario.vehicle.model_copy(update={"course": now.vehicle.course, "roams": True}), scenario.traffic
    if traffic is not None and now.traffic is not None:
        traffic = traffic.model_copy(update={"drive": now.traffic.drive})
    return scenario.model_copy(update={"vehicle": vehicle, "traffic": traffic, "steps": now.steps})


def repeat(scenario: Scenario, edit: Edit) -> Scenario:
    """A scenario after an edit. Modules that it names may run, unless somebody drove. Raises LuxloopError as `changed`."""
    if not edit.driven:
        return with_overrides(scenario, edit.overrides)
    course, steps = _vehicle(scenario).course, scenario.steps
    for key, value in (item for each in edit.overrides for item in _items(tables(each))):
        if key == "steps" and isinstance(value, int) and 1 <= value <= MOST_STEPS:
            steps = value
        elif key == f"vehicle.course[{len(course)}]" and isinstance(value, dict):
            course = (*course, validate_model(CourseParams, value, "record the run again"))
        else:
            raise LuxloopError(f"edits: {key} is nothing that somebody drives; record the run again")
    return _longer(scenario, course[len(_vehicle(scenario).course) :], steps)[0]


def _items(given: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in given.items():
        places = value.get("course") if key == "vehicle" and isinstance(value, dict) and value.keys() == {"course"} else None
        yield from ((f"vehicle.course{place}", each) for place, each in places.items()) if isinstance(places, dict) else [(key, value)]


def _vehicle(scenario: Scenario) -> VehicleParams:
    if scenario.vehicle is None:
        raise LuxloopError("drive: the vehicle stands in this scenario; set vehicle.course=[{speed_m_s=0.0}], which starts the run anew")
    return scenario.vehicle


def _steps(step: int) -> int:
    """The number of steps of a run that goes on after a step."""
    if step + 2 > MOST_STEPS:
        raise LuxloopError(f"drive: a run has {MOST_STEPS} steps at most; start anew")
    return step + 2


def _longer(scenario: Scenario, added: tuple[CourseParams, ...], steps: int) -> tuple[Scenario, tuple[str, ...]]:
    vehicle = _vehicle(scenario)
    texts = [f"steps={steps}", *(f"vehicle.course[{k}]={toml(each)}" for k, each in enumerate(added, len(vehicle.course)))]
    longer = vehicle.model_copy(update={"course": (*vehicle.course, *added)}) if added else vehicle
    return scenario.model_copy(update={"vehicle": longer, "steps": steps}), tuple(texts)
