"""A run of lighting functions in a few numbers, and electrical power to compare its own with."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.controllers.functions.commands import MOVEMENTS, Movable
from luxloop.controllers.functions.material import Quantity
from luxloop.loop.recording.summary import Circumstances, Summary, column
from luxloop.loop.recording.summary import summarise as summarise_symbol
from luxloop.loop.scenario.plant import shadow_of
from luxloop.loop.simulation.columns import of_one
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.lamps import ShiningModule, flux_by_side
from luxloop.loop.simulation.redrawn import covering, open_loop_lights
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.headlight.lamp import REST

START_UP_S = 1.0  # in which functions that learn begin with more light than they come to need
SETTLED = 0.05  # greatest deviation of a zone from its target, as a share of it
LAST_STEPS = 10  # that a confidence at the end is the mean of
UNITS: Mapping[Quantity, str] = {"luminance": "cd/m^2", "lx": "lx"}
LOOKING = ("detections", "false_positives")  # columns that are summarised by their means
NAMED = 8  # objects that charts and the closing table tell one by one


def summary_of(
    simulation: Simulation, table: pa.Table, last: Mapping[str, Evaluation], covered: Mapping[str, Evaluation] | None = None
) -> Summary:
    """The summary of a run's steps. last: of each symbol the last step that shows it, beside which the open loop is evaluated. covered: of
    those that were lost as covered the last such step.
    """
    scenario, held = simulation.scenario, dict[str, Summary]()
    for name, symbol in simulation.controlled.items():
        iou = road_m = math.nan
        mine = of_one(table, name)
        if symbol.evaluator is not None and name in last:
            now, lights = last[name].now, open_loop_lights(simulation, last[name], name)
            iou = float(symbol.evaluator.evaluate(simulation.world.added(now.time_s, *lights, now.commands), now.time_s).iou)
            road_m = symbol.evaluator.road_m(mine["time_s"].to_pylist())
        by = covering(simulation, covered[name], name) if covered and name in covered else ()
        judge_every = None if symbol.evaluator is None else scenario.judge_every
        run = Circumstances(judge_every, scenario.vehicle is not None, road_m, getattr(symbol.params, "highest_m", None))
        held[name] = summarise_symbol(mine, symbol.params.name, iou, by, run)
    summary = summarise(table, scenario.name, reference_power(simulation, table), held)
    low = _low_beam(simulation)
    summary |= {"shadow_of": shadow_of(scenario.plant), "low_beam_lm": sum(_flux_lm(simulation, low)) if low else None}
    summary |= {"modules": modules} if (modules := of_modules(table, simulation.modules)) else {}
    return summary | ({"flicker": {"rate_hz": scenario.rate_hz, "on_share": 1 - scenario.off_share}} if held else {})


def summarise(table: pa.Table, scenario: str, compared_w: Mapping[str, NDArray[np.floating]], held: Mapping[str, Summary]) -> Summary:
    """A recording in a few numbers, ready for JSON: None where a value does not exist.

    compared_w: electrical power `[steps]` in W that the recording's is compared with, by name. held: summaries of symbols, by name.
    """
    known = table.column_names
    lamps = [name.split(".")[1] for name in known if name.startswith("lamp.") and name.endswith(".flux_lm")]
    objects = [name.removeprefix("objects.").removesuffix(".lx_max") for name in known if name.endswith(".lx_max")]

    def over(name: str, what: str) -> float | None:
        return _over(column(table, name), what)

    times_s, ms = column(table, "time_s"), float(np.median(column(table, "processing_ms"))) if table.num_rows else None
    return {
        "scenario": scenario,
        "steps": table.num_rows,
        "dark_lx_max": over("dark_lx_max", "max"),
        "symbol_iou_min": over("symbol_iou_min", "min") if "symbol_iou_min" in known else None,
        "lamps": {
            side: {
                "flux_lm_mean": over(f"lamp.{side}.flux_lm", "mean"),
                "power_share_max": over(f"lamp.{side}.power_share", "max"),
                "power_factor_min": over(f"lamp.{side}.power_factor", "min"),
            }
            for side in lamps
        },
        "objects": {
            name: {
                "lx_mean": over(f"objects.{name}.lx_mean", "mean"),
                "lx_max": over(f"objects.{name}.lx_max", "max"),
                "masked_steps": table[f"objects.{name}.masked"].to_pylist().count(True),
                **(_recognition(table, name) if f"objects.{name}.track" in known else {}),
            }
            for name in objects
        },
        "functions": dict(held),
        **({"zones": zones} if (zones := _zones(table)) else {}),
        **({"materials": materials} if (materials := _materials(table)) else {}),
        **(
            {
                "energy_j": _energy(table, column(table, "power_w")),
                "energy_compared_j": {name: _energy(table, watts) for name, watts in compared_w.items()},
                "base_share_first": float(column(table, "base_share")[0]),
                "base_share_final": float(column(table, "base_share")[-1]),
            }
            if "power_w" in known and table.num_rows
            else {}
        ),
        **{key: over(key, "mean") for key in LOOKING if key in known},
        **(
            {
                "eyes_lx_max": eyes_lx(table),
                "eyes_lx_max_after_start_up": eyes_lx(table, START_UP_S),
                "tracks_of_nothing": steps_of_nothing(table, objects),
            }
            if "eyes_lx_max" in known
            else {}
        ),
        "processing_ms_median": ms,
        "times_real_time": None if ms is None or table.num_rows < 2 else ms / 1e3 * (table.num_rows - 1) / float(times_s[-1] - times_s[0]),
    }


def of_modules(table: pa.Table, modules: Sequence[Movable]) -> dict[str, dict[str, Summary]]:
    """What functions commanded, by names of modules and movements: least and most, and of angles in how many steps they were at an end of
    the module's range, rest excepted.
    """
    found = dict[str, dict[str, Summary]]()
    for module in modules:
        for movement in MOVEMENTS:
            if (name := f"modules.{module.name}.{movement}") in table.column_names:
                rest = getattr(REST, movement)
                values = np.nan_to_num(column(table, name), nan=rest)
                told: Summary = {"least": float(values.min()), "most": float(values.max())}
                if movement != "intensity":
                    told["steps_at_end"] = int((np.isin(values, getattr(module, movement)) & (values != rest)).sum())
                found.setdefault(module.name, {})[movement] = told
    return found


def brightest(objects: Mapping[str, Summary]) -> list[str]:
    """Names of the objects that a summary lists: all in sight, or the `NAMED` brightest of more."""
    most = {name: each["lx_max"] for name, each in objects.items() if each["lx_max"] is not None}
    if len(most) <= NAMED:
        return [*most]
    return [name for name in sorted(most, key=most.__getitem__, reverse=True)[:NAMED] if most[name]]


def spoken(name: str) -> str:
    """A name, or several with dots between, as text has it."""
    return name.replace("_", " ").replace(".", ": ", 1)


def zones_of(table: pa.Table) -> list[str]:
    """Names of the zones of a recording."""
    return [each.removeprefix("functions.").removesuffix(".target") for each in table.column_names if each.endswith(".target")]


def materials_of(table: pa.Table, quantity: Quantity) -> list[str]:
    """Materials of a recording of which that is wanted, each behind the name of its function and a dot."""
    asked = [each.removeprefix("functions.").removesuffix(".wanted") for each in table.column_names if each.endswith(".wanted")]
    return [name for name in asked if f"functions.{name}.{quantity}" in table.column_names]


def lost_steps(table: pa.Table, name: str) -> int:
    """Steps in which an object is in sight and no track shows it, after the first that did."""
    in_sight, tracked = np.isfinite(column(table, f"objects.{name}.confidence")), np.isfinite(column(table, f"objects.{name}.track"))
    return int((in_sight & ~tracked)[np.argmax(tracked) :].sum()) if tracked.any() else 0


def steps_of_nothing(table: pa.Table, objects: Sequence[str]) -> int:
    """Steps in which there is a track that shows no object, or one that another track shows; objects out of sight keep the one they had."""
    shown = np.zeros(table.num_rows)
    for name in objects:
        in_sight, tracked = np.isfinite(column(table, f"objects.{name}.confidence")), np.isfinite(column(table, f"objects.{name}.track"))
        last = np.maximum.accumulate(np.where(in_sight, np.arange(len(shown)), -1))  # step in which it was in sight
        shown += (last >= 0) & tracked[last]
    return int((column(table, "tracks") > shown).sum())


def eyes_lx(table: pa.Table, from_s: float = 0.0) -> float | None:
    """Most light on heads and windscreens from a time on; None where none are seen."""
    return _over(column(table, "eyes_lx_max")[column(table, "time_s") >= from_s], "max")


def _over(values: NDArray[np.floating], what: str) -> float | None:
    """The mean, say, of the values that there are; None where there are none."""
    values = values[np.isfinite(values)]
    return float(getattr(values, what)()) if len(values) else None


def _zones(table: pa.Table) -> Summary:
    """By name: how bright a zone is at the end, and the step from which on it stays within 5 % of its target; or None."""
    found = {}
    for name in zones_of(table):
        luminance, target = column(table, f"functions.{name}.luminance"), column(table, f"functions.{name}.target")
        beyond = np.flatnonzero(~(np.abs(luminance / target - 1) <= SETTLED))
        after = int(beyond[-1]) + 1 if len(beyond) else 0
        if len(luminance):
            settled = after if after < len(luminance) else None
            found[name] = {"luminance": _last(luminance), "target": _last(target), "settled_step": settled}
    return found


def _materials(table: pa.Table) -> Summary:
    """By name: what a material has at the end, None out of sight, and what was wanted."""
    found = {}
    for quantity in UNITS:
        for name in materials_of(table, quantity) if table.num_rows else ():
            last, wanted = (_last(column(table, f"functions.{name}.{each}")) for each in (quantity, "wanted"))
            found[name] = {"quantity": quantity, "median": last, "wanted": wanted}
    return found


def _last(values: NDArray[np.floating]) -> float | None:
    return float(values[-1]) if np.isfinite(values[-1]) else None


def _energy(table: pa.Table, power_w: NDArray[np.floating]) -> float | None:
    """Of all lamps, in J; None of a single step, which has no duration."""
    times = column(table, "time_s")
    return float(power_w.sum() * (times[-1] - times[0]) / (len(times) - 1)) if len(times) > 1 else None


def _recognition(table: pa.Table, name: str) -> Summary:
    """The confidence at the end, and the least since a track first showed an object, how many showed it one after the other, and for how
    long it was in sight, and lost."""
    confidence = column(table, f"objects.{name}.confidence")
    tracks = {number for number in table[f"objects.{name}.track"].to_pylist() if number is not None}
    tracked = np.isfinite(column(table, f"objects.{name}.track"))
    since = confidence[np.argmax(tracked) :] if tracked.any() else confidence[:0]
    return {
        "confidence_final": _over(confidence[-LAST_STEPS:], "mean"),
        "confidence_min": _over(since, "min"),
        "tracks": len(tracks),
        "pixels_max": _over(column(table, f"objects.{name}.pixels"), "max"),
        "steps_in_sight": int(np.isfinite(confidence).sum()),
        "steps_lost": lost_steps(table, name),
    }


LOW, STANDBY = "low", "standby"


def reference_power(simulation: Simulation, table: pa.Table) -> Mapping[str, NDArray[np.floating]]:
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
