"""Flux and power over a drive: `python benchmarks/energy.py [--seconds N] [--rate_hz N] [--seed N]`.

A street with oncoming traffic, walkers and cyclists: object light beside the glare-free guard, glare-free high beam and the low beam, with
lamps that stay cold, that get warm, and whose pixels are dimmed by current in place of pulse width. Prints the table of
docs/object_based.md.
"""

from argparse import Namespace
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import pandas as pd
from bench import run, show

from luxloop import Scenario, Simulation, load, validate
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.simulation.lamps import LampDriver

LOW, GUARD = "low beam", {"kind": "glare_free"}


def scenarios(given: Namespace) -> Iterator[tuple[str, Scenario]]:
    """The drive in each lighting; without functions in the low beam, which is always the same."""
    own = load("obl").model_dump(mode="json", include={"lighting", "functions", "headlight", "camera", "ssc", "detector", "light"})
    world = {"road": given.road, "vehicle": given.vehicle, "traffic": given.traffic | {"seed": given.seed}}
    drive = own | world | {"rate_hz": given.rate_hz, "steps": round(given.seconds * given.rate_hz)}
    yield "object light beside the guard", validate({**drive, "name": "object", "functions": own["functions"] | {"guard": GUARD}}, "drive")
    yield "glare-free high beam", validate({**drive, "name": "glare-free", "functions": {"guard": GUARD}}, "drive")
    yield LOW, validate({**drive, "name": "low", "functions": {}, "lighting": {"base": {"beam": "low"}}, "steps": 1}, "drive")


def drivers(simulation: Simulation, lamps: Mapping[str, Mapping[str, float]]) -> dict[str, LampDriver]:
    """The simulation's lamps with other parameters, by name."""
    scenario = simulation.scenario
    params = {name: type(scenario.headlight)(**scenario.headlight.model_dump() | each) for name, each in lamps.items()}
    return {name: replace(simulation.lamps, scenario=scenario.model_copy(update={"headlight": own})) for name, own in params.items()}


def drive(scenario: Scenario, lamps: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Mean flux in lm and mean power in W of each kind of lamps, of all lamps together."""
    simulation, rows = Simulation.prepare(scenario), []
    lit = drivers(simulation, lamps)
    for result in simulation.run():
        lights = [Utilisation(u) for u in result.lights]
        sides = dict.fromkeys(result.powers, 1.0)
        watts = {name: sum(p.watts for p in each.powers(simulation.modules, lights, sides).values()) for name, each in lit.items()}
        rows.append({"lm": sum(power.flux_lm for power in result.powers.values()), **watts})
    return pd.DataFrame(rows).mean().to_dict()


def measure(given: Namespace) -> dict[str, Any]:
    found = {name: drive(scenario, given.lamps) for name, scenario in scenarios(given)}
    low = found[LOW]
    show(f"Over {given.seconds:g} s, mean flux in lm and power in W", found)
    saved = {name: {key: 1 - value / low[key] for key, value in row.items()} for name, row in found.items() if name != LOW}
    show("Saved against the low beam", saved)
    return {"means": found, "saved": saved}


if __name__ == "__main__":
    run(measure, __doc__, "seconds", "rate_hz", "seed")
