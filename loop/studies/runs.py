"""Runs of many scenarios at once that differ in numbers alone: with the metrics and trace of a single run."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.symbol.feedback import FeedbackParams
from luxloop.controllers.symbol.sensing.field import cut
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.controllers.symbol.stages import Lifting, StagedParams
from luxloop.loop.scenario.model import Scenario, only
from luxloop.loop.simulation.evaluator import Evaluation, SymbolStep
from luxloop.loop.simulation.lamps import LampPower, mean_powers
from luxloop.loop.simulation.result import Rollout
from luxloop.loop.simulation.simulated import world_plant
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch.copies import Copies, Taken, refuse_first, refuse_scenario, stack
from luxloop.loop.studies.batch.rollouts import loops, stack_laws
from luxloop.loop.studies.metrics import Figures, figures_and_trace, ready, tabulate, with_controllers
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.metrics import Metrics
from luxloop.world.errors import LuxloopError

LAWS = ("open", "thesis_pid", "gauss_newton")
LEAST = 2  # copies

Run = tuple[Figures, Rollout | None]


def kind(scenario: Scenario) -> str | None:
    """A string that is equal for scenarios that can run in one batch; None for a scenario that cannot (`refuse`).

    They may differ in the seed, the controller's numbers, the start of the symbol, and what disturbs the frames.
    """
    try:
        refuse(scenario)
    except LuxloopError:
        return None
    params = scenario.symbol.controller
    numbers: Any = {
        "seed": True,
        "disturbances": {"ambient", "noise", "drops"},
        "functions": {only(scenario.symbols): {"controller", "start"}},
    }
    law = [params and params.name, params.dof if isinstance(params, FeedbackParams) else None]
    return json.dumps([scenario.model_dump_json(exclude=numbers), *law])


def refuse(scenario: Scenario) -> None:
    """Raises LuxloopError with the reason if a scenario's keys exclude it from batches."""
    refuse_scenario(scenario)
    params = scenario.symbol.controller
    assert params is not None
    reasons = {
        f"batches have no controller {params.name}": params.name not in LAWS,
        "batches have no stages: controller.warp and controller.supervisor": isinstance(params, StagedParams)
        and (params.warp or params.supervisor),
        "camera.latency_spread_steps: all frames of a batch are equally late": scenario.camera.latency_spread_steps,
    }
    refuse_first(scenario.name, reasons)


def runs(scenarios: Sequence[Scenario], device: str = "cpu") -> list[Run]:
    """Metrics and trace of each scenario, all of one `kind`, as of a single run up to single-precision rounding.

    A scenario whose symbol is lost, or lies on another road, is run again alone, since a single run then searches the whole image.
    Scenarios that need more than a window of the lamps' light also run alone, since a batch of them is no faster. device: to compute on.
    Raises LuxloopError if a scenario cannot run, or cannot run in a batch.
    """
    if len(scenarios) < LEAST:
        return [figures_and_trace(each, device) for each in scenarios]
    for each in scenarios:
        refuse(each)
    copies = Copies(ready(scenarios[0], device))
    if not copies.windowed:
        return [figures_and_trace(each, device) for each in scenarios]
    simulations = [with_controllers(copies.simulation, each) for each in scenarios]
    steps, searching = _steps(copies, simulations)
    first = copies.simulation.at(0)
    return [
        figures_and_trace(each.scenario, device) if k in searching else tabulate(each, _results(copies, first, steps, k))
        for k, each in enumerate(simulations)
    ]


@dataclass(frozen=True, eq=False)
class _Step:
    """One step of B copies. measurements: of the frames that came, one a copy. cut: `[B, 4]`, see
    `luxloop.controllers.symbol.sensing.field`. sums: `[B, m, 2]`, see `luxloop.loop.studies.batch.copies.Light`. metrics: None in a step
    without evaluation.
    """

    projection: ProjectionCommand
    measurements: Sequence[Measurement]
    cut: Tensor
    sums: Tensor
    metrics: Metrics | None


def _steps(copies: Copies, simulations: Sequence[Simulation]) -> tuple[list[_Step], frozenset[int]]:
    """All steps of the copies, and those of them that would search the whole image."""
    like, target = copies.simulation.scenario, copies.projector.target
    symbols, plant = [each.symbol for each in simulations], world_plant(copies.simulation.plant, "a batch")
    plants = [replace(plant, seed=each.scenario.seed, disturbances=each.scenario.disturbances) for each in simulations]
    lifted = any(isinstance(each.controller, Lifting) for each in symbols)
    looks, shown, searching = list[list[Measurement]](), list[tuple[Tensor, Metrics | None]](), set[int]()

    def look(projection: ProjectionCommand, step: int) -> Measurement:
        light, frames = copies.show(projection), [Taken(each.seed, step, each.disturbances) for each in plants]
        seen = copies.measure(light, frames)
        for k, each in enumerate(plants):
            if each.loses(step):
                seen[k] = copies.sensor.lost(projection.pose[k], ExtractionStatus.NO_FRAME)
            elif k not in searching and (
                seen[k].code != ExtractionStatus.SEEN
                or (lifted and copies.sensor.at_ends(seen[k]) and copies.finds_another_road(light, k, frames[k]))
            ):
                searching.add(k)
        shown.append((light.sums, copies.evaluate(light) if like.judge_every and step % like.judge_every == 0 else None))
        looks.append(seen)
        return stack(seen)

    steps = []
    start = torch.stack([each.function.start_pose.pose for each in symbols]).to(target)
    for step, (projection, _) in enumerate(loops(stack_laws([each.controller for each in symbols]), copies.simulation, start, look)):
        lost = [copies.sensor.lost(pose, ExtractionStatus.NO_FRAME) for pose in projection.pose]
        seen = looks[step - like.camera.latency_steps] if step >= like.camera.latency_steps else lost
        steps.append(_Step(projection, seen, cut(copies.projector, projection), *shown[step]))
    return steps, frozenset(searching)


def _results(copies: Copies, first: Evaluation, steps: Sequence[_Step], k: int) -> Iterator[tuple[Evaluation, float]]:
    """The steps of the k-th copy as of a single run, each with the mean utilisation of all pixels. first: of a single run."""
    simulation, (name,) = copies.simulation, first.held
    pixels = sum(module.flux.numel() for module in simulation.modules)
    resting = [[float(each.u @ module.flux), float(each.u.sum())] for each, module in zip(copies.resting, simulation.modules, strict=True)]
    for number, each in enumerate(steps):
        projection = ProjectionCommand(each.projection.pose[k], None if each.projection.z is None else each.projection.z[k])
        metrics = each.metrics and Metrics(*(value[k] for value in vars(each.metrics).values()))
        held = SymbolStep(projection, each.cut[k], each.measurements[k], metrics)
        on = [*resting]
        for module, drawn in zip(copies.symbol.drawn_by, each.sums[k].tolist(), strict=True):
            on[module] = drawn
        powers = mean_powers([_powers(simulation, lights) for lights in (on, resting)], simulation.scenario.shares)
        time_s = number / simulation.scenario.rate_hz
        sense = replace(first.sense, now=simulation.situation(time_s))
        result = replace(first, step=number, sense=sense, held={name: held}, powers=powers)
        yield result, sum(u for _, u in on) / pixels


def _powers(simulation: Simulation, lights: Sequence[Sequence[float]]) -> Mapping[str, LampPower]:
    """Power by the lamps' sides. lights: flux in lm and sum of utilisations of each module."""
    found = {}
    for side in dict.fromkeys(module.side for module in simulation.modules):
        mine = [(module, lm) for module, (lm, _) in zip(simulation.modules, lights, strict=True) if module.side == side]
        total, most = sum(lm for _, lm in mine), sum(module.flux_lm for module, _ in mine)
        found[side] = LampPower(total, total / most, 1.0, simulation.scenario.headlight.power_w(total), total)
    return found
