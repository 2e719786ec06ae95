"""A run in one row of plain figures, without files: what campaigns tabulate and tuning minimises."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.loop.recording.functions_summary import summary_of
from luxloop.loop.recording.manifest import digests, table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.recording.summary import column, steps_with_metrics
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import Scenario, only
from luxloop.loop.scenario.plant import SimulatedPlantParams
from luxloop.loop.simulation.build_symbols import build_symbol_controller
from luxloop.loop.simulation.columns import of_one
from luxloop.loop.simulation.evaluator import Evaluation, SymbolStep
from luxloop.loop.simulation.result import Rollout
from luxloop.loop.simulation.simulated import SimulatedPlant
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.extraction import ExtractionStatus

Figures = dict[str, float | str | None]
WORST = {  # figures of symbols that are held, and which of several is the worst
    "settle_step": max,
    "overshoot_percent": max,
    "residual_percent": max,
    "iou_open": min,
    "iou_final": min,
    "iou_mean": min,
}


def figures(scenario: Scenario, device: str = "auto") -> Figures:
    """Run a scenario and give its summary, flat: `lamps.left.flux_lm_mean`, say; None where a value does not exist.

    flux_lm_mean is that of all lamps, utilisation_mean that of all pixels over all steps. Where symbols are held, the figures in `WORST`
    are also there without a name, those of the symbol that comes off worst; iou_mean is then that of all judged steps, and residual_percent
    is how far off the centroid ends, of the symbol's size. With a detector there are confidence_final_mean and _min, over the objects in
    sight at the end. Times are left out, so that the same scenario gives the same figures.
    Raises LuxloopError where the scenario cannot run.
    """
    return figures_and_trace(scenario, device)[0]


def figures_and_trace(scenario: Scenario, device: str = "auto") -> tuple[Figures, Rollout | None]:
    """The figures of a run, and how its only symbol was held, as a batch of one; None where several are held, or none.

    Raises as `figures`.
    """
    simulation = ready(scenario, device)
    return tabulate(simulation, ((result, _utilisation(result)) for result in simulation.evaluations()))


def tabulate(simulation: Simulation, steps: Iterable[tuple[Evaluation, float]]) -> tuple[Figures, Rollout | None]:
    """The same from the steps of a run, each with the mean utilisation of all pixels."""
    rows, utilisations, trace = [], list[float](), []
    last = dict[str, Evaluation]()
    name = only(simulation.controlled) if len(simulation.controlled) == 1 else None
    for result, utilisation in steps:  # which are not kept: a step is megabytes
        rows.append(row(result))
        utilisations.append(utilisation)
        last |= dict.fromkeys(result.held, result)
        if name is not None:
            trace.append(_trace(result.held.get(name), simulation.symbol.projector.target))
    table = table_of(rows, schema(simulation))
    told = summary_of(simulation, table, last)
    flux_lm = sum(each["flux_lm_mean"] for each in told["lamps"].values())
    values = {**told, "flux_lm_mean": flux_lm, "utilisation_mean": float(np.mean(utilisations))}
    sure = [each["confidence_final"] for each in told["objects"].values() if each.get("confidence_final") is not None]
    values |= {"confidence_final_mean": float(np.mean(sure)), "confidence_final_min": min(sure)} if sure else {}
    for name, symbol in told["functions"].items():
        x, y = symbol["centroid_error_percent"]
        symbol["residual_percent"] = None if x is None or y is None else float(np.hypot(x, y))
        ious = column(steps_with_metrics(of_one(table, name)), "iou")
        symbol["iou_mean"] = float(ious.mean()) if len(ious) else None
    for figure, worst in WORST.items() if told["functions"] else ():
        of_all = [symbol[figure] for symbol in told["functions"].values()]
        values[figure] = None if None in of_all else worst(of_all)
    return _flat(values), Rollout(*(torch.stack(part)[None] for part in zip(*trace, strict=True))) if trace else None


def _utilisation(result: Evaluation) -> float:
    return sum(float(u.sum()) for u in result.lights) / sum(u.numel() for u in result.lights)


def _trace(held: SymbolStep | None, target: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Pose, error of the pose, and whether it was seen; the target, unseen, while it is not shown."""
    if held is None:
        return target, torch.zeros_like(target), torch.zeros_like(target[0], dtype=torch.bool)
    usable = (held.measurement.code == ExtractionStatus.SEEN) & held.measurement.pose_error.isfinite().all()
    return held.pose, torch.where(usable, held.measurement.pose_error, 0.0), usable


def ready(scenario: Scenario, device: str) -> Simulation:
    """A simulation of the scenario; all but controllers and noise is taken from one that is ready where there is one."""
    if not isinstance(scenario.plant, SimulatedPlantParams):
        return prepare(scenario, device)
    functions = {name: {"controller"} for name in scenario.symbols}
    decisive = scenario.model_dump_json(exclude={"seed": True, "functions": functions})
    like = _prepare(_WorldKey(scenario, device, decisive, (*digests(scenario).items(),)))
    assert isinstance(like.plant, SimulatedPlant)
    return replace(with_controllers(like, scenario), plant=replace(like.plant, seed=scenario.seed))


def with_controllers(simulation: Simulation, scenario: Scenario) -> Simulation:
    """The same world and plant with the controllers of another scenario, whose symbols are the same."""
    held = {}
    for name, symbol in simulation.controlled.items():
        function = scenario.functions[name]
        assert isinstance(function, SymbolFunctionParams) and function.controller is not None
        held[name] = replace(symbol, function=function, controller=build_symbol_controller(function.controller, symbol.sensor))
    return replace(simulation, scenario=scenario, controlled=held)


@dataclass(frozen=True)
class _WorldKey:
    """What runs share whose scenarios differ by controller or seed alone. decisive: the rest as JSON. files: digests of the files read."""

    scenario: Scenario = field(compare=False)
    device: str
    decisive: str
    files: tuple[tuple[str, str], ...]


@lru_cache(1)  # half a gigabyte; runs of a campaign that share one follow each other
def _prepare(shared: _WorldKey) -> Simulation:
    return prepare(shared.scenario, shared.device)


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        flat |= {f"{key}.{inner}": each for inner, each in _flat(value).items()} if isinstance(value, dict) else {key: value}
    return {key: value for key, value in flat.items() if "_ms_" not in key and key != "times_real_time"}
