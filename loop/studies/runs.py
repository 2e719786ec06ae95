"""Runs of many scenarios at once that differ in numbers alone: metrics and trace of `luxloop.loop.studies.metrics.traced` for each."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from torch import Tensor

from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.loop.scenario.model import Scenario, only
from luxloop.loop.simulation.build_symbols import build_symbol_controller
from luxloop.loop.simulation.evaluator import Evaluation, SymbolStep
from luxloop.loop.simulation.lamps import LampPower, mean_powers
from luxloop.loop.simulation.result import Rollout
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch.copies import Copies, refuse_scenario
from luxloop.loop.studies.batch.courses import Course, Courses, course_of
from luxloop.loop.studies.batch.laws import refuse_controller, shape_of
from luxloop.loop.studies.metrics import Figures, ready, tabulated, traced
from luxloop.perception.metrics import Metrics
from luxloop.world.errors import LuxloopError

# What may differ within a batch, beside the seed, the controller's numbers and the start of the symbol.
OF_CAMERA = {"latency_steps", "latency_spread_steps", "drop_probability"}
OF_DISTURBANCES = {"ambient", "noise", "drops"}
LEAST = 2  # copies

Run = tuple[Figures, Rollout | None]


def kind(scenario: Scenario) -> str | None:
    """A string that is equal for scenarios that can run in one batch; None for a scenario that cannot (`refuse`)."""
    try:
        refuse(scenario)
    except LuxloopError:
        return None
    held = {only(scenario.symbols): {"controller", "start"}}
    numbers: Any = {"seed": True, "camera": OF_CAMERA, "disturbances": OF_DISTURBANCES, "functions": held}
    return json.dumps([scenario.model_dump_json(exclude=numbers), *shape_of(scenario.symbol.controller)])


def refuse(scenario: Scenario) -> None:
    """Raises LuxloopError with the reason if a scenario's keys exclude it from batches."""
    refuse_scenario(scenario)
    refuse_controller(scenario.symbol.controller, scenario.name)


def runs(scenarios: Sequence[Scenario], device: str = "cpu") -> list[Run]:
    """Metrics and trace of each scenario, all of one `kind`, as of `luxloop.loop.studies.metrics.traced` up to single-precision rounding.

    A scenario whose symbol is lost in a step is run again alone, since a single run then searches the whole image and may draw for
    another road. Scenarios that need more than a window of the lamps' light also run alone, since a batch of them is no faster. device:
    to compute on. Raises LuxloopError if a scenario cannot run, or cannot run in a batch.
    """
    if len(scenarios) < LEAST:
        return [traced(each, device) for each in scenarios]
    for each in scenarios:
        refuse(each)
    copies = Copies(ready(scenarios[0], device))
    if not copies.windowed:
        return [traced(each, device) for each in scenarios]
    simulations = _simulations(copies.simulation, scenarios)
    courses = course_of(copies, [(each.scenario, each.symbol) for each in simulations])
    like = _Like.of(copies)
    return [
        traced(each.scenario, device) if k in courses.left else tabulated(each, like.steps(courses, k))
        for k, each in enumerate(simulations)
    ]


def _simulations(simulation: Simulation, scenarios: Sequence[Scenario]) -> list[Simulation]:
    """The world of all, with the controller of each; equal ones are made once."""
    symbol, controllers, found = simulation.symbol, {}, []
    for each in scenarios:
        params = each.symbol.controller
        assert params is not None
        if (key := params.model_dump_json()) not in controllers:
            controllers[key] = build_symbol_controller(params, symbol.sensor)
        held = {only(each.symbols): replace(symbol, function=each.symbol, controller=controllers[key])}
        found.append(replace(simulation, scenario=each, controlled=held))
    return found


@dataclass(frozen=True, eq=False)
class _Like:
    """What steps of a batch have in common with a single run's. first: its first step."""

    copies: Copies
    first: Evaluation

    @classmethod
    def of(cls, copies: Copies) -> "_Like":
        simulation = copies.simulation
        return cls(copies, simulation.at(0))

    def steps(self, courses: Courses, k: int) -> Iterator[tuple[Evaluation, float]]:
        """The steps of the k-th copy as of a single run, each with the mean utilisation of all pixels."""
        (name,) = self.first.held
        for number, each in enumerate(courses.steps):
            time_s = number / self.copies.simulation.scenario.rate_hz
            powers, utilisation = self._powers(each.sums[k])
            now = self.copies.simulation.situation(time_s)
            sense, held = replace(self.first.sense, now=now), {name: _held(each, k)}
            yield replace(self.first, step=number, sense=sense, held=held, powers=powers), utilisation

    def _powers(self, sums: Tensor) -> tuple[Mapping[str, LampPower], float]:
        """Of the lamps over on and off exposure, and the mean utilisation in the first. sums: `[m, 2]` of the modules that draw."""
        drawn = dict(zip(self.copies.symbol.drawn_by, sums.tolist(), strict=True))
        on = [drawn.get(number, resting) for number, resting in enumerate(self._resting)]
        pixels = sum(module.flux.numel() for module in self.copies.simulation.modules)
        powers = [self._at_once([lm for lm, _ in lights]) for lights in (on, self._resting)]
        return mean_powers(powers, self.copies.simulation.scenario.shares), sum(u for _, u in on) / pixels

    @cached_property
    def _resting(self) -> list[list[float]]:
        """Flux in lm and sum of utilisations of each module without the symbol."""
        modules = self.copies.simulation.modules
        return [[float(each.u @ module.flux), float(each.u.sum())] for each, module in zip(self.copies.resting, modules, strict=True)]

    def _at_once(self, lm: Sequence[float]) -> Mapping[str, LampPower]:
        """Of modules that give so much each."""
        simulation, found = self.copies.simulation, {}
        for side in dict.fromkeys(module.side for module in simulation.modules):
            mine = [(module, each) for module, each in zip(simulation.modules, lm, strict=True) if module.side == side]
            total, most = sum(each for _, each in mine), sum(module.flux_lm for module, _ in mine)
            found[side] = LampPower(total, total / most, 1.0, simulation.scenario.headlight.power_w(total), total)
        return found


def _held(course: Course, k: int) -> SymbolStep:
    """The k-th copy's part of a step."""
    projection, seen = course.projection, course.measurement
    shown = ProjectionCommand(projection.pose[k], None if projection.z is None else projection.z[k])
    values = {name: getattr(seen, name)[k] for name in ("code", "errors", "pose_error", "area_ratio", "symbol")}
    measurement = replace(
        seen, **values, appearance=replace(seen.appearance, **{name: each[k] for name, each in vars(seen.appearance).items()})
    )
    verdict = course.verdict and Metrics(*(each[k] for each in vars(course.verdict).values()))
    return SymbolStep(shown, course.cut[k], measurement, verdict)
