"""A run in one row of plain figures, without files: what campaigns tabulate and tuning minimises."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from loop.assembly.build import build_symbol_controller
from loop.lighting.compared import compared
from loop.lighting.record import row as lighting_row
from loop.lighting.record import schema as lighting_schema
from loop.lighting.simulation import LightingSimulation
from loop.lighting.summary import summarise as summarise_lighting
from loop.plant.simulated import SimulatedPlant
from loop.recording.manifest import digests
from loop.recording.recorder import row, summary_of, table_of
from loop.recording.summary import column, judged
from loop.run import prepare, torch_device
from loop.scenario.model import AnyScenario, LightingScenario, Scenario
from loop.scenario.plant import SimulatedPlantParams
from loop.symbol.batch import Rollout
from loop.symbol.simulation import Simulation
from perception.extraction import Loss

KEPT = 4  # simulations made ready, half a gigabyte each


def figures(scenario: AnyScenario, device: str = "auto") -> dict[str, float | str | None]:
    """Run a scenario and give its summary, flat: `centroid_error_x_percent`, `lamps.left.flux_lm_mean`; None where a value does not exist.

    A symbol's run has iou_mean (over all judged steps), residual_percent (how far off the centroid ends, of the symbol's size) and
    utilisation_mean (of all pixels, over all steps) as well; one of lighting functions flux_lm_mean (of all lamps), and with a detector
    confidence_final_mean and _min (over the objects in sight at the end). Times are left out, so that the same scenario gives the same
    figures.
    Raises LuxloopError where the scenario cannot run.
    """
    if isinstance(scenario, LightingScenario):
        lighting = LightingSimulation.prepare(scenario, torch_device(device))
        table = table_of([lighting_row(result) for result in lighting.run()], lighting_schema(lighting))
        told = summarise_lighting(table, scenario.name, compared(lighting, table))
        flux = [each["flux_lm_mean"] for each in told["lamps"].values()]
        sure = [each["confidence_final"] for each in told["objects"].values() if each.get("confidence_final") is not None]
        least = {"confidence_final_mean": float(np.mean(sure)), "confidence_final_min": min(sure)} if sure else {}
        return _flat(told | {"flux_lm_mean": sum(flux)} | least)
    return traced(scenario, device)[0]


def traced(scenario: Scenario, device: str = "auto") -> tuple[dict[str, float | str | None], Rollout]:
    """The figures of a symbol's run, and the run as a batch of one. Raises what `figures` raises."""
    simulation = _simulation(scenario, device)
    rows, utilisations, trace = [], [], []
    for result in simulation.run():
        rows.append(row(result))
        utilisations.append(float(np.mean([light.u.mean().item() for light in result.lights])))
        usable = (result.seen.code == Loss.SEEN) & result.seen.pose_error.isfinite().all()
        trace.append((result.pose, torch.where(usable, result.seen.pose_error, 0.0), usable))
    table = table_of(rows)
    values = summary_of(simulation, table)
    x, y = values.pop("centroid_error_percent")
    values |= {"centroid_error_x_percent": x, "centroid_error_y_percent": y}
    values["residual_percent"] = None if x is None or y is None else float(np.hypot(x, y))
    ious = column(judged(table), "iou")
    values["iou_mean"] = float(ious.mean()) if len(ious) else None
    values["utilisation_mean"] = float(np.mean(utilisations))
    return _flat(values), Rollout(*(torch.stack(column)[None] for column in zip(*trace, strict=True)))


def _simulation(scenario: Scenario, device: str) -> Simulation:
    """A simulation of the scenario; all but controller and noise is taken from one that is ready where there is one."""
    if not isinstance(scenario.plant, SimulatedPlantParams):
        return prepare(scenario, device)
    ready = _prepared(_Shared(scenario, device, scenario.model_dump_json(exclude={"controller", "seed"}), (*digests(scenario).items(),)))
    assert isinstance(ready.plant, SimulatedPlant)
    plant, controller = replace(ready.plant, seed=scenario.seed), build_symbol_controller(scenario.controller, ready.observer)
    return replace(ready, scenario=scenario, plant=plant, controller=controller)


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
