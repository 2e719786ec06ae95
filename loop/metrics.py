"""A run in one row of plain figures, without files: what campaigns tabulate and tuning minimises."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from controllers.functions.symbol import SymbolFunctionParams
from loop.assembly.build import build_symbol_controller
from loop.lighting.batch import Rollout
from loop.lighting.record import row, schema, summary_of
from loop.lighting.result import StepResult
from loop.lighting.simulation import Simulation
from loop.plant.simulated import SimulatedPlant
from loop.recording.columns import of_one
from loop.recording.manifest import digests
from loop.recording.recorder import table_of
from loop.recording.summary import column, judged
from loop.run import prepare
from loop.scenario.model import Scenario, only
from loop.scenario.plant import SimulatedPlantParams
from perception.extraction import Loss

KEPT = 4  # simulations made ready, half a gigabyte each
SHOWN = {  # figures of symbols that are held, and which of several is the worst
    "settle_step": max,
    "overshoot_percent": max,
    "residual_percent": max,
    "iou_open": min,
    "iou_final": min,
    "iou_mean": min,
}


def figures(scenario: Scenario, device: str = "auto") -> dict[str, float | str | None]:
    """Run a scenario and give its summary, flat: `lamps.left.flux_lm_mean`, say; None where a value does not exist.

    flux_lm_mean is that of all lamps, utilisation_mean that of all pixels over all steps. Where symbols are held, the figures in `SHOWN`
    are also there without a name, those of the symbol that comes off worst; iou_mean is then that of all judged steps, and residual_percent
    is how far off the centroid ends, of the symbol's size. With a detector there are confidence_final_mean and _min, over the objects in
    sight at the end. Times are left out, so that the same scenario gives the same figures.
    Raises LuxloopError where the scenario cannot run.
    """
    return _figures(_simulation(scenario, device))[0]


def traced(scenario: Scenario, device: str = "auto") -> tuple[dict[str, float | str | None], Rollout | None]:
    """The figures of a run, and how its only symbol was held, as a batch of one; None where several are held, or none.

    Raises as `figures`.
    """
    simulation = _simulation(scenario, device)
    found, results = _figures(simulation)
    if len(simulation.controlled) != 1:
        return found, None
    name, target = only(simulation.controlled), simulation.symbol.projector.target
    trace = []
    for result in results:
        if name not in result.held:  # it is not shown
            trace.append((target, torch.zeros_like(target), torch.zeros_like(target[0], dtype=torch.bool)))
            continue
        held = result.held[name]
        usable = (held.seen.code == Loss.SEEN) & held.seen.pose_error.isfinite().all()
        trace.append((held.pose, torch.where(usable, held.seen.pose_error, 0.0), usable))
    return found, Rollout(*(torch.stack(column)[None] for column in zip(*trace, strict=True)))


def _figures(simulation: Simulation) -> tuple[dict[str, float | str | None], list[StepResult]]:
    results = list(simulation.run())
    table = table_of([row(result) for result in results], schema(simulation))
    told = summary_of(simulation, table, {name: result for result in results for name in result.held})
    pixels = sum(u.numel() for u in results[0].lights)
    values = {
        **told,
        "flux_lm_mean": sum(each["flux_lm_mean"] for each in told["lamps"].values()),
        "utilisation_mean": float(np.mean([sum(float(u.sum()) for u in result.lights) / pixels for result in results])),
    }
    sure = [each["confidence_final"] for each in told["objects"].values() if each.get("confidence_final") is not None]
    values |= {"confidence_final_mean": float(np.mean(sure)), "confidence_final_min": min(sure)} if sure else {}
    for name, symbol in told["functions"].items():
        x, y = symbol["centroid_error_percent"]
        symbol["residual_percent"] = None if x is None or y is None else float(np.hypot(x, y))
        ious = column(judged(of_one(table, name)), "iou")
        symbol["iou_mean"] = float(ious.mean()) if len(ious) else None
    for figure, worst in SHOWN.items() if told["functions"] else ():
        of_all = [symbol[figure] for symbol in told["functions"].values()]
        values[figure] = None if None in of_all else worst(of_all)
    return _flat(values), results


def _simulation(scenario: Scenario, device: str) -> Simulation:
    """A simulation of the scenario; all but controllers and noise is taken from one that is ready where there is one."""
    if not isinstance(scenario.plant, SimulatedPlantParams):
        return prepare(scenario, device)
    functions = {name: {"controller"} for name in scenario.controlled}
    decisive = scenario.model_dump_json(exclude={"seed": True, "functions": functions})
    ready = _prepared(_Shared(scenario, device, decisive, (*digests(scenario).items(),)))
    assert isinstance(ready.plant, SimulatedPlant)
    held = {}
    for name, symbol in ready.controlled.items():
        function = scenario.functions[name]
        assert isinstance(function, SymbolFunctionParams) and function.controller is not None
        controller = build_symbol_controller(function.controller, symbol.observer)
        held[name] = replace(symbol, function=function, controller=controller)
    return replace(ready, scenario=scenario, plant=replace(ready.plant, seed=scenario.seed), controlled=held)


@dataclass(frozen=True)
class _Shared:
    """What runs share whose scenarios differ by controller or seed alone. decisive: the rest as JSON. files: digests of the files read."""

    scenario: Scenario = field(compare=False)
    device: str
    decisive: str
    files: tuple[tuple[str, str], ...]


@lru_cache(KEPT)
def _prepared(shared: _Shared) -> Simulation:
    return prepare(shared.scenario, shared.device)


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        flat |= {f"{key}.{inner}": each for inner, each in _flat(value).items()} if isinstance(value, dict) else {key: value}
    return {key: value for key, value in flat.items() if "_ms_" not in key}
