"""Runs as rows of plain figures without files, one by one or in batches, for campaigns and tuning; and the response of a held symbol."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.controllers.symbol.sensing.field import cut
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.controllers.symbol.stages import RoadStage, StagedParams
from luxloop.loop.recording.functions_summary import summary_of
from luxloop.loop.recording.manifest import digests, table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.recording.summary import AXES, LEAST_START_PERCENT, Summary, column, steps_with_metrics
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import Scenario, only
from luxloop.loop.scenario.plant import SimulatedPlantParams
from luxloop.loop.simulation.columns import of_one
from luxloop.loop.simulation.controlled import build_symbol_controller
from luxloop.loop.simulation.evaluator import Evaluation, SymbolStep
from luxloop.loop.simulation.lamps import LampPower, mean_powers
from luxloop.loop.simulation.result import Rollout
from luxloop.loop.simulation.simulated import SimulatedPlant, world_plant
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch.copies import Conditions, Copies, refuse_first, refuse_scenario, stack
from luxloop.loop.studies.batch.rollouts import loops, stack_laws
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.metrics import Metrics
from luxloop.world.errors import LuxloopError

RISEN = 0.1  # share of the initial error at which a response has risen
LEAST_WAY_M = 0.05  # of a pose whose effort counts
DARK_PERCENT = 100.0  # error on the road in a step without light


def response(table: pa.Table) -> Summary:
    """Figures of one symbol's columns (`luxloop.loop.simulation.columns.of_one`): None where a value does not exist.

    road: of the centroid's distance from its target in % of the symbol's size, in evaluated steps; 100 in those without light. camera: of
    the measured distance in m (`pose_error_x_m`, `pose_error_y_m`), in steps with a measurement. Each has iae, itae and ise, the integrals
    of |e|, t |e| and e^2 over time in s; rise_s, the time until |e| is at most a tenth of that of the first step; and peak, the largest |e|
    from then on.
    """
    evaluated = steps_with_metrics(table)
    away = np.hypot(*(column(evaluated, axis) for axis in AXES))
    measured = np.hypot(column(table, "pose_error_x_m"), column(table, "pose_error_y_m"))
    seen = np.isfinite(measured)
    return {
        "road": _of_error(column(evaluated, "time_s"), np.nan_to_num(away, nan=DARK_PERCENT), LEAST_START_PERCENT),
        "camera": _of_error(column(table, "time_s")[seen], measured[seen], 0.0),
    }


def effort(table: pa.Table) -> float | None:
    """Length of the path of a symbol's pose along x and y, relative to the way from its first to its last pose; None without a way."""
    places = np.stack([column(table, "x_m"), column(table, "y_m")], -1)
    way = float(np.linalg.norm(places[-1] - places[0])) if len(places) else 0.0
    return float(np.linalg.norm(np.diff(places, axis=0), axis=-1).sum()) / way if way > LEAST_WAY_M else None


def _of_error(times_s: NDArray[np.floating], error: NDArray[np.floating], least_start: float) -> Summary:
    """Figures of an error `[steps]` >= 0. least_start: initial error up to which there is no rise."""
    if not len(error):
        return dict.fromkeys(("iae", "itae", "ise", "rise_s", "peak"))
    since_s = times_s - times_s[0]
    risen = np.flatnonzero(error <= RISEN * error[0])
    rises = len(risen) > 0 and error[0] > least_start
    return {
        "iae": float(np.trapezoid(error, since_s)),
        "itae": float(np.trapezoid(since_s * error, since_s)),
        "ise": float(np.trapezoid(error**2, since_s)),
        "rise_s": float(since_s[risen[0]]) if rises else None,
        "peak": float(error[risen[0] :].max()) if rises else None,
    }


Figures = dict[str, float | str | None]
WORST = {  # figures of held symbols, with the function that picks the worst of several
    "settle_step": max,
    "overshoot_percent": max,
    "residual_percent": max,
    "effort": max,
    "iou_open": min,
    "iou_final": min,
    "iou_mean": min,
}


Run = tuple[Figures, Rollout | None, pa.Table]


def figures(scenario: Scenario, device: str = "auto") -> Figures:
    """Figures of a scenario's run: its summary, flat, such as `lamps.left.flux_lm_mean`; None for a value that does not exist.

    flux_lm_mean is that of all lamps, utilisation_mean that of all pixels over all steps. Of each held symbol, residual_percent is the
    final centroid error in percent of the symbol's size, response and effort are as in `luxloop.loop.studies.runs`; the figures in
    `WORST` also exist without a name, for the worst symbol. With a detector there are confidence_final_mean and confidence_final_min, over
    the objects in sight at the end. Times are left out, so that a scenario always gives the same figures. Raises LuxloopError if the
    scenario cannot run.
    """
    return figures_and_trace(scenario, device)[0]


def figures_and_trace(scenario: Scenario, device: str = "auto") -> Run:
    """Figures of a run, the trace of its only symbol as a batch of one (None if several or no symbols are held), and the table of its
    steps. Raises as `figures`.
    """
    simulation = ready(scenario, device)
    return tabulate(simulation, ((result, _utilisation(result)) for result in simulation.evaluations()))


def tabulate(simulation: Simulation, steps: Iterable[tuple[Evaluation, float]]) -> Run:
    """Figures, trace and table from the steps of a run, each with the mean utilisation of all pixels."""
    rows, utilisations, trace = [], list[float](), []
    last = dict[str, Evaluation]()
    name = only(simulation.controlled) if len(simulation.controlled) == 1 else None
    for result, utilisation in steps:  # not stored: a step takes megabytes
        rows.append(row(result))
        utilisations.append(utilisation)
        last |= dict.fromkeys(result.held, result)
        if name is not None:
            trace.append(_trace(result.held.get(name), simulation.symbol.projector.target))
    table = table_of(rows, schema(simulation))
    summary = summary_of(simulation, table, last)
    flux_lm = sum(each["flux_lm_mean"] for each in summary["lamps"].values())
    values = {**summary, "flux_lm_mean": flux_lm, "utilisation_mean": float(np.mean(utilisations))}
    sure = [each["confidence_final"] for each in summary["objects"].values() if each.get("confidence_final") is not None]
    values |= {"confidence_final_mean": float(np.mean(sure)), "confidence_final_min": min(sure)} if sure else {}
    for name, symbol in summary["functions"].items():
        x, y = symbol["centroid_error_percent"]
        symbol["response"] = response(of_one(table, name))
        symbol["residual_percent"] = None if x is None or y is None else float(np.hypot(x, y))
        symbol["effort"] = effort(of_one(table, name))
    for figure, worst in WORST.items() if summary["functions"] else ():
        of_all = [symbol[figure] for symbol in summary["functions"].values()]
        values[figure] = None if None in of_all else worst(of_all)
    rollout = Rollout(*(torch.stack(part)[None] for part in zip(*trace, strict=True))) if trace else None
    return _flat(values), rollout, table


def _utilisation(result: Evaluation) -> float:
    return sum(float(u.sum()) for u in result.lights) / sum(u.numel() for u in result.lights)


def _trace(held: SymbolStep | None, target: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Pose, pose error and whether the symbol was seen; the target, unseen, while the symbol is not shown."""
    if held is None:
        return target, torch.zeros_like(target), torch.zeros_like(target[0], dtype=torch.bool)
    usable = (held.measurement.code == ExtractionStatus.SEEN) & held.measurement.pose_error.isfinite().all()
    return held.pose, torch.where(usable, held.measurement.pose_error, 0.0), usable


def ready(scenario: Scenario, device: str) -> Simulation:
    """Simulation of a scenario; everything but controllers and noise comes from a prepared one if there is one."""
    if not isinstance(scenario.plant, SimulatedPlantParams):
        return prepare(scenario, device)
    functions = {name: {"controller"} for name in scenario.symbols}
    decisive = scenario.model_dump_json(exclude={"seed": True, "functions": functions})
    like = _prepare(_WorldKey(scenario, device, decisive, (*digests(scenario).items(),)))
    assert isinstance(like.plant, SimulatedPlant)
    return replace(with_controllers(like, scenario), plant=replace(like.plant, seed=scenario.seed))


def with_controllers(simulation: Simulation, scenario: Scenario) -> Simulation:
    """Simulation with the same world and plant, and the controllers of another scenario with the same symbols."""
    held = {}
    for name, symbol in simulation.controlled.items():
        function = scenario.functions[name]
        assert isinstance(function, SymbolFunctionParams) and function.controller is not None
        held[name] = replace(symbol, function=function, controller=build_symbol_controller(function.controller, symbol.sensor))
    return replace(simulation, scenario=scenario, controlled=held)


@dataclass(frozen=True)
class _WorldKey:
    """Key of scenarios that differ by controller or seed alone. decisive: all else as JSON. files: digests of the files read."""

    scenario: Scenario = field(compare=False)
    device: str
    decisive: str
    files: tuple[tuple[str, str], ...]


@lru_cache(1)  # half a gigabyte; runs with the same key are consecutive
def _prepare(shared: _WorldKey) -> Simulation:
    return prepare(shared.scenario, shared.device)


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        flat |= {f"{key}.{inner}": each for inner, each in _flat(value).items()} if isinstance(value, dict) else {key: value}
    return {key: value for key, value in flat.items() if "_ms_" not in key and key != "times_real_time"}


LAWS = ("open", "thesis_pid", "gauss_newton")
LEAST = 2  # copies


def kind(scenario: Scenario) -> str | None:
    """Kind of a scenario, equal for scenarios that can run in one batch; None for a scenario that cannot (`refuse`).

    Scenarios of one kind may differ in the seed, the controller's numbers, the start of the symbol, and disturbances of frames.
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
    law = [params and params.name, *(getattr(params, name, None) for name in ("dof", "gain_schedule"))]
    return json.dumps([scenario.model_dump_json(exclude=numbers), *law])


def refuse(scenario: Scenario) -> None:
    """Raise LuxloopError with the reason if a scenario's keys exclude it from batches."""
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
    """Figures, trace and table of scenarios of one `kind`, equal to those of single runs up to single-precision rounding.

    A scenario whose symbol is lost, or lies on another road, runs again alone, since a single run then searches the whole image. Scenarios
    that need more than a window of the lamps' light run alone, since batches are no faster. device: to compute on. Raises LuxloopError if a
    scenario cannot run, or cannot run in a batch.
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
    """One step of B copies.

    measurements: of the frames that came, one per copy. cut: `[B, 4]`, see `luxloop.controllers.symbol.sensing.field`. sums: `[B, m, 2]`,
    see `luxloop.loop.studies.batch.copies.SymbolLight`. metrics: None in a step without evaluation.
    """

    projection: ProjectionCommand
    measurements: Sequence[Measurement]
    cut: Tensor
    sums: Tensor
    metrics: Metrics | None


def _steps(copies: Copies, simulations: Sequence[Simulation]) -> tuple[list[_Step], frozenset[int]]:
    """All steps of the copies, and the numbers of copies whose single run would search the whole image."""
    like, target = copies.simulation.scenario, copies.projector.target
    symbols, plant = [each.symbol for each in simulations], world_plant(copies.simulation.plant, "a batch")
    plants = [replace(plant, seed=each.scenario.seed, disturbances=each.scenario.disturbances) for each in simulations]
    lifted = any(isinstance(each.controller, RoadStage) for each in symbols)
    looks, shown, searching = list[list[Measurement]](), list[tuple[Tensor, Metrics | None]](), set[int]()

    def look(projection: ProjectionCommand, step: int) -> Measurement:
        light, frames = copies.show(projection), [Conditions(each.seed, step, each.disturbances) for each in plants]
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
    """Steps of the k-th copy as of a single run, each with the mean utilisation of all pixels. first: first step of a single run."""
    simulation, (name,) = copies.simulation, first.held
    pixels = sum(module.flux.numel() for module in simulation.modules)
    resting = [[float(each.u @ module.flux), float(each.u.sum())] for each, module in zip(copies.resting, simulation.modules, strict=True)]
    for number, each in enumerate(steps):
        projection = ProjectionCommand(each.projection.pose[k], None if each.projection.z is None else each.projection.z[k])
        metrics = each.metrics and Metrics(*(value[k] for value in vars(each.metrics).values()))
        held = SymbolStep(projection, each.cut[k], each.measurements[k], metrics)
        if metrics is not None:  # what does not depend on the controller is the same in all steps
            held = replace(held, road_true_m=first.held[name].road_true_m, causes=first.held[name].causes)
        on = [*resting]
        for module, drawn in zip(copies.symbol.drawn_by, each.sums[k].tolist(), strict=True):
            on[module] = drawn
        powers = mean_powers([_powers(simulation, lights) for lights in (on, resting)], simulation.scenario.frame_shares)
        time_s = number / simulation.scenario.rate_hz
        sense = replace(first.sense, now=simulation.situation(time_s))
        result = replace(first, step=number, sense=sense, held={name: held}, reception=replace(first.reception, powers=powers))
        yield result, sum(u for _, u in on) / pixels


def _powers(simulation: Simulation, lights: Sequence[Sequence[float]]) -> Mapping[str, LampPower]:
    """Power by side of the car. lights: flux in lm and sum of utilisations of each module."""
    found = {}
    for side in dict.fromkeys(module.side for module in simulation.modules):
        mine = [(module, lm) for module, (lm, _) in zip(simulation.modules, lights, strict=True) if module.side == side]
        total, most = sum(lm for _, lm in mine), sum(module.flux_lm for module, _ in mine)
        found[side] = LampPower(total, total / most, 1.0, simulation.scenario.headlight.power_w(total), total)
    return found
