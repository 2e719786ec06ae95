"""Electrical power to compare a run's with: of lamps on standby, of the low beam, and of the base beam that nothing dims."""

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.loop.recording.summary import column
from luxloop.loop.simulation.lamps import ShiningModule, flux_by_side
from luxloop.loop.simulation.simulation import Simulation

LOW, STANDBY = "low", "standby"


def compared(simulation: Simulation, table: pa.Table) -> Mapping[str, NDArray[np.floating]]:
    """W of all lamps in each step `[steps]`, by name: "standby", "low beam" if they have one, then the base beam if it is another."""
    modules, beams = simulation.modules, table["beam"].to_pylist()
    steps = np.ones(table.num_rows)
    found = {STANDBY: steps * _watts(simulation, [module.flux * 0 for module in modules])}
    if low := _low_beam(simulation):
        found[f"{LOW} beam"] = steps * _watts(simulation, low)
    own = dict.fromkeys(simulation.base(beam) for beam in beams)
    if set(own) - {*found, "base beam off"}:
        watts = [
            _watts(simulation, [_base(module, beam, time_s) for module in modules])
            for time_s, beam in zip(column(table, "time_s"), beams, strict=True)
        ]
        found[next(iter(own)) if len(own) == 1 else "base beam"] = np.array(watts)
    return found


def _base(module: ShiningModule, beam: str, time_s: float) -> Tensor:
    """Utilisation `[n_p]` that nothing dims, also of a beam that an edited scenario no longer asks for."""
    return module.beam(beam) if module.raw is None else module.raw.at(time_s).to(module.flux)


def low_beam_lm(simulation: Simulation) -> float | None:
    """Luminous flux of all lamps in the low beam that nothing dims; None where they have none."""
    low = _low_beam(simulation)
    return sum(_flux_lm(simulation, low)) if low else None


def _low_beam(simulation: Simulation) -> list[Tensor]:
    """Utilisations `[n_p]`, one a module; none where a lamp has no low beam."""
    modules = simulation.modules
    known = all(LOW in module.lamp.beams for module in modules)
    return [module.beam(LOW) for module in modules] if known else []


def _flux_lm(simulation: Simulation, lights: Sequence[Tensor]) -> list[float]:
    """Of each lamp, within the power limit."""
    modules, limit = simulation.modules, simulation.scenario.lighting.power_limit or 1.0
    given, most = flux_by_side(modules, lights), flux_by_side(modules, [torch.ones_like(module.flux) for module in modules])
    return [min(lm, limit * most[side]) for side, lm in given.items()]


def _watts(simulation: Simulation, lights: Sequence[Tensor]) -> float:
    return sum(map(simulation.scenario.headlight.power_w, _flux_lm(simulation, lights)))
