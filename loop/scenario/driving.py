"""A scenario whose vehicle is driven by hand: its course grows step by step."""

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
    """The scenario for a driver who takes over at a step: with a road all around, the course so far, and the traffic along the old course.

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
    """The scenario with one more step of the course, and the overrides for it. Raises LuxloopError at the largest number of steps."""
    added = drive_on(_vehicle(scenario), step / scenario.rate_hz, (step + 1) / scenario.rate_hz, controls)
    return _longer(scenario, added, _steps(step))


def end_drive(scenario: Scenario, step: int, steps: int) -> tuple[Scenario, tuple[str, ...]]:
    """The scenario without a driver from a step on, and the overrides for it: the vehicle goes straight on at its speed.

    steps: least number of steps.
    """
    return _longer(scenario, let_go(_vehicle(scenario), step / scenario.rate_hz), max(scenario.steps, steps))


def with_drive(scenario: Scenario, now: Scenario) -> Scenario:
    """A scenario with the driven course of another scenario; unchanged without a driven course."""
    if now.vehicle is None or scenario.vehicle is None or not now.vehicle.roams:
        return scenario
    vehicle, traffic = scenario.vehicle.model_copy(update={"course": now.vehicle.course, "roams": True}), scenario.traffic
    if traffic is not None and now.traffic is not None:
        traffic = traffic.model_copy(update={"drive": now.traffic.drive})
    return scenario.model_copy(update={"vehicle": vehicle, "traffic": traffic, "steps": now.steps})


def repeat(scenario: Scenario, edit: Edit) -> Scenario:
    """A scenario after an edit. Modules that the edit names may run, but not by a driver's edit.

    Raises LuxloopError as `luxloop.validate`, and where a driver's edit changes anything but course and steps.
    """
    if not edit.driven:
        return with_overrides(scenario, edit.overrides)
    course, steps = _vehicle(scenario).course, scenario.steps
    for override in edit.overrides:
        match tables(override):
            case {"steps": int(value), **others} if 1 <= value <= MOST_STEPS and not others:
                steps = value
            case {"vehicle": {"course": dict(places), **rest}, **others} if [*places] == [f"[{len(course)}]"] and not (rest or others):
                (following,) = places.values()
                course = (*course, validate_model(CourseParams, following, "record the run again"))
            case _:
                raise LuxloopError(f"edits: {override.partition('=')[0]} is not set by a driver; record the run again")
    return _longer(scenario, course[len(_vehicle(scenario).course) :], steps)[0]


def _vehicle(scenario: Scenario) -> VehicleParams:
    if scenario.vehicle is None:
        raise LuxloopError("drive: the vehicle stands in this scenario; set vehicle.course=[{speed_m_s=0.0}], which starts the run anew")
    return scenario.vehicle


def _steps(step: int) -> int:
    """Number of steps of a run that continues after a step."""
    if step + 2 > MOST_STEPS:
        raise LuxloopError(f"drive: a run has {MOST_STEPS} steps at most; start anew")
    return step + 2


def _longer(scenario: Scenario, added: tuple[CourseParams, ...], steps: int) -> tuple[Scenario, tuple[str, ...]]:
    vehicle = _vehicle(scenario)
    texts = [f"steps={steps}", *(f"vehicle.course[{k}]={toml(each)}" for k, each in enumerate(added, len(vehicle.course)))]
    longer = vehicle.model_copy(update={"course": (*vehicle.course, *added)}) if added else vehicle
    return scenario.model_copy(update={"vehicle": longer, "steps": steps}), tuple(texts)
