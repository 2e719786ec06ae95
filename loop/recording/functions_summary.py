"""Key figures of a run, and the electrical power of reference beams."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.controllers.functions.commands import MOVEMENTS, Movable
from luxloop.controllers.functions.material import Quantity
from luxloop.loop.recording.summary import Circumstances, Summary, column, finite, last
from luxloop.loop.recording.summary import summarise as summarise_symbol
from luxloop.loop.scenario.plant import shadow_of
from luxloop.loop.simulation.columns import of_one
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.lamps import flux_by_side
from luxloop.loop.simulation.redrawn import covering, open_loop_lights
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.headlight.lamp import REST

START_UP_S = 1.0  # functions that learn begin with more light than they need
SETTLED = 0.05  # largest deviation of a settled zone from its target, relative to the target
LAST_STEPS = 10  # their mean is the final confidence
UNITS: Mapping[Quantity, str] = {"luminance": "cd/m^2", "lx": "lx"}
MEANS = ("detections", "false_positives")  # columns that are summarised by their means
LAMP = (("flux_lm", "mean"), ("power_share", "max"), ("power_factor", "min"))  # columns of a lamp and their statistics
NAMED = 8  # objects that have a row or a curve of their own


def summary_of(
    simulation: Simulation, table: pa.Table, latest: Mapping[str, Evaluation], covered: Mapping[str, Evaluation] | None = None
) -> Summary:
    """Summary of a run. latest: by symbol the last step that shows it, at which the open loop is evaluated as well. covered: by symbol the
    last step in which other functions covered it.
    """
    scenario, symbols = simulation.scenario, dict[str, Summary]()
    for name, symbol in simulation.controlled.items():
        iou = road_m = math.nan
        mine = of_one(table, name)
        if symbol.evaluator is not None and name in latest:
            now, lights = latest[name].now, open_loop_lights(simulation, latest[name], name)
            iou = float(symbol.evaluator.evaluate(*lights, now.time_s, now.commands).iou)
            road_m = symbol.evaluator.road_m(mine["time_s"].to_pylist())
        by = covering(simulation, covered[name], name) if covered and name in covered else ()
        judge_every = None if symbol.evaluator is None else scenario.judge_every
        run = Circumstances(judge_every, scenario.vehicle is not None, road_m, getattr(symbol.params, "highest_m", None))
        symbols[name] = summarise_symbol(mine, symbol.params.name, iou, by, run)
    summary = summarise(table, scenario.name, reference_power(simulation, table), symbols)
    low = _low_beam(simulation)
    summary |= {"shadow_of": shadow_of(scenario.plant), "low_beam_lm": sum(_flux_lm(simulation, low)) if low else None}
    summary |= {"modules": modules} if (modules := summarise_modules(table, simulation.modules)) else {}
    return summary | ({"flicker": {"rate_hz": scenario.rate_hz, "on_share": 1 - scenario.off_share}} if symbols else {})


def summarise(table: pa.Table, scenario: str, compared_w: Mapping[str, NDArray[np.floating]], symbols: Mapping[str, Summary]) -> Summary:
    """Summary of a recording, ready for JSON: None where a value does not exist.

    compared_w: electrical power `[steps]` in W of reference beams, by name. symbols: summaries of the symbols under control, by name.
    """
    known = table.column_names
    lamps = [name.split(".")[1] for name in known if name.startswith("lamp.") and name.endswith(".flux_lm")]
    objects = [name.removeprefix("objects.").removesuffix(".lx_max") for name in known if name.endswith(".lx_max")]

    def over(name: str, what: str) -> float | None:
        return _over(column(table, name), what)

    found: Summary = {
        "scenario": scenario,
        "steps": table.num_rows,
        "dark_lx_max": over("dark_lx_max", "max"),
        "symbol_iou_min": over("symbol_iou_min", "min") if "symbol_iou_min" in known else None,
        "lamps": {side: {f"{key}_{what}": over(f"lamp.{side}.{key}", what) for key, what in LAMP} for side in lamps},
        "objects": {
            name: {
                "lx_mean": over(f"objects.{name}.lx_mean", "mean"),
                "lx_max": over(f"objects.{name}.lx_max", "max"),
                "masked_steps": table[f"objects.{name}.masked"].to_pylist().count(True),
                **(_recognition(table, name) if f"objects.{name}.track" in known else {}),
            }
            for name in objects
        },
        "functions": dict(symbols),
    }
    found |= {"pixels": pixels} if (pixels := _pixels(table)) else {}
    found |= {"probes": probes} if (probes := _probes(table)) else {}
    found |= {"zones": zones} if (zones := _zones(table)) else {}
    found |= {"materials": materials} if (materials := _materials(table)) else {}
    if "power_w" in known and table.num_rows:
        share = column(table, "base_share")
        found |= {
            "energy_j": _energy(table, column(table, "power_w")),
            "energy_compared_j": {name: _energy(table, watts) for name, watts in compared_w.items()},
            "base_share_first": share[0],
            "base_share_final": share[-1],
        }
    found |= {key: over(key, "mean") for key in MEANS if key in known}
    if "eyes_lx_max" in known:
        found |= {
            "eyes_lx_max": eyes_lx(table),
            "eyes_lx_max_after_start_up": eyes_lx(table, START_UP_S),
            "tracks_of_nothing": steps_of_nothing(table, objects),
        }
    if causes := {name.removeprefix("causes."): column(table, name) for name in known if name.startswith("causes.")}:
        found["causes"] = {why: {"steps": int((counts > 0).sum()), "count": int(np.nansum(counts))} for why, counts in causes.items()}
    times_s, ms = column(table, "time_s"), np.median(column(table, "processing_ms")) if table.num_rows else math.nan
    found["processing_ms_median"] = ms
    found["times_real_time"] = None if table.num_rows < 2 else ms / 1e3 * (table.num_rows - 1) / (times_s[-1] - times_s[0])
    return finite(found)


def summarise_modules(table: pa.Table, modules: Sequence[Movable]) -> dict[str, dict[str, Summary]]:
    """Commands of functions by module and movement: least and most; of angles also the number of steps at a limit of the module's range
    that is not its rest position.
    """
    found = dict[str, dict[str, Summary]]()
    for module in modules:
        for movement in MOVEMENTS:
            if (name := f"modules.{module.name}.{movement}") in table.column_names:
                rest = getattr(REST, movement)
                values = np.nan_to_num(column(table, name), nan=rest)
                figures: Summary = {"least": float(values.min()), "most": float(values.max())}
                if movement != "intensity":
                    figures["steps_at_end"] = int((np.isin(values, getattr(module, movement)) & (values != rest)).sum())
                found.setdefault(module.name, {})[movement] = figures
    return found


def brightest(objects: Mapping[str, Summary]) -> list[str]:
    """Names of the objects with a row or curve of their own: all in sight, or the `NAMED` brightest of more."""
    most = {name: each["lx_max"] for name, each in objects.items() if each["lx_max"] is not None}
    if len(most) <= NAMED:
        return [*most]
    return [name for name in sorted(most, key=most.__getitem__, reverse=True)[:NAMED] if most[name]]


def plain_name(name: str) -> str:
    """A name of a scenario in plain words, such as "road: zebra crossing" for `road.zebra_crossing`."""
    return name.replace("_", " ").replace(".", ": ", 1)


def zones_of(table: pa.Table) -> list[str]:
    """Names of the zones of a recording."""
    return [each.removeprefix("functions.").removesuffix(".target") for each in table.column_names if each.endswith(".target")]


def materials_of(table: pa.Table, quantity: Quantity) -> list[str]:
    """Materials for which functions want a luminance or an illuminance, as FUNCTION.MATERIAL."""
    wanted = [each.removeprefix("functions.").removesuffix(".wanted") for each in table.column_names if each.endswith(".wanted")]
    return [name for name in wanted if f"functions.{name}.{quantity}" in table.column_names]


def lost_steps(table: pa.Table, name: str) -> int:
    """Number of steps in which an object is in sight without a track, after its first track."""
    in_sight, tracked = _sight(table, name)
    return int((in_sight & ~tracked & np.maximum.accumulate(tracked)).sum())


def _sight(table: pa.Table, name: str) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether the camera sees an object, and whether a track shows it, `[steps]` each."""
    in_sight, tracked = (np.isfinite(column(table, f"objects.{name}.{key}")) for key in ("confidence", "track"))
    return in_sight, tracked


def steps_of_nothing(table: pa.Table, objects: Sequence[str]) -> int:
    """Number of steps with a track that shows no object, or an object of another track; an object out of sight keeps its last track."""
    shown = np.zeros(table.num_rows)
    for name in objects:
        in_sight, tracked = _sight(table, name)
        before = np.maximum.accumulate(np.where(in_sight, np.arange(len(shown)), -1))  # last step in sight
        shown += (before >= 0) & tracked[before]
    return int((column(table, "tracks") > shown).sum())


def eyes_lx(table: pa.Table, from_s: float = 0.0) -> float | None:
    """Largest illuminance in lx on heads and windscreens from a time on; None where none are seen."""
    return _over(column(table, "eyes_lx_max")[column(table, "time_s") >= from_s], "max")


def _over(values: NDArray[np.floating], what: str) -> float | None:
    """A statistic of the finite values, "mean", "min" or "max"; None without a value."""
    values = values[np.isfinite(values)]
    return float(getattr(values, what)()) if len(values) else None


def _probes(table: pa.Table) -> Summary:
    """By probe: least, mean and largest illuminance in lx; of an eye also its largest veil in cd/m^2 and threshold increment in %."""
    found = dict[str, Summary]()
    for name in (each for each in table.column_names if each.startswith("probes.")):
        probe, key = name.removeprefix("probes.").rsplit(".", 1)
        takes = ("min", "mean", "max") if key == "lx" else ("max",)
        found.setdefault(probe, {}).update({f"{key}_{what}": _over(column(table, name), what) for what in takes})
    return found


def _pixels(table: pa.Table) -> Summary:
    """By module: numbers of pixels with a known gain, and of those that have worn, at the end."""
    known = [each for each in table.column_names if each.startswith("pixels.") and each.endswith(".known")]
    names = [each.removeprefix("pixels.").removesuffix(".known") for each in known]
    return {name: {key: last(table, f"pixels.{name}.{key}") for key in ("known", "worn")} for name in names} if table.num_rows else {}


def _zones(table: pa.Table) -> Summary:
    """By zone: luminance and target in cd/m^2 at the end, and the step from which on the luminance stays within 5 % of the target."""
    found = {}
    for name in zones_of(table):
        luminance, target = column(table, f"functions.{name}.luminance"), column(table, f"functions.{name}.target")
        beyond = np.flatnonzero(~(np.abs(luminance / target - 1) <= SETTLED))
        after = int(beyond[-1]) + 1 if len(beyond) else 0
        if len(luminance):
            settled = after if after < len(luminance) else None
            found[name] = {"luminance": luminance[-1], "target": target[-1], "settled_step": settled}
    return found


def _materials(table: pa.Table) -> Summary:
    """By material: quantity, its median at the end, None out of sight, and its wanted value."""
    found = {}
    for quantity in UNITS:
        for name in materials_of(table, quantity) if table.num_rows else ():
            median, wanted = (last(table, f"functions.{name}.{each}") for each in (quantity, "wanted"))
            found[name] = {"quantity": quantity, "median": median, "wanted": wanted}
    return found


def _energy(table: pa.Table, power_w: NDArray[np.floating]) -> float | None:
    """Energy in J of a power `[steps]` in W; None for a single step, which has no duration."""
    times = column(table, "time_s")
    return float(power_w.sum() * (times[-1] - times[0]) / (len(times) - 1)) if len(times) > 1 else None


def _recognition(table: pa.Table, name: str) -> Summary:
    """Of an object: final confidence, least confidence since its first track, number of its tracks, largest size in the image, and the
    numbers of steps in sight and lost.
    """
    confidence, (in_sight, tracked) = column(table, f"objects.{name}.confidence"), _sight(table, name)
    return {
        "confidence_final": _over(confidence[-LAST_STEPS:], "mean"),
        "confidence_min": _over(confidence[np.maximum.accumulate(tracked)], "min"),
        "tracks": len(table[f"objects.{name}.track"].drop_null().unique()),
        "pixels_max": _over(column(table, f"objects.{name}.pixels"), "max"),
        "steps_in_sight": int(in_sight.sum()),
        "steps_lost": lost_steps(table, name),
    }


LOW, STANDBY = "low", "standby"


def reference_power(simulation: Simulation, table: pa.Table) -> Mapping[str, NDArray[np.floating]]:
    """Power `[steps]` in W of all lamps by reference beam: "standby", "low beam" if the lamps have one, and any other base beam."""
    modules, beams = simulation.modules, table["beam"].to_pylist()
    steps = np.ones(table.num_rows)
    found = {STANDBY: steps * _watts(simulation, [module.flux * 0 for module in modules])}
    if low := _low_beam(simulation):
        found[f"{LOW} beam"] = steps * _watts(simulation, low)
    own = dict.fromkeys(simulation.base(beam) for beam in beams)
    if set(own) - {*found, "base beam off"}:
        watts = [
            _watts(simulation, [m.beam(beam) if m.raw is None else m.raw.at(time_s).to(m.flux) for m in modules])
            for time_s, beam in zip(column(table, "time_s"), beams, strict=True)
        ]
        found[next(iter(own)) if len(own) == 1 else "base beam"] = np.array(watts)
    return found


def _low_beam(simulation: Simulation) -> list[Tensor]:
    """Utilisations `[n_p]` of the low beam, one a module; none where a lamp has no low beam."""
    modules = simulation.modules
    known = all(LOW in module.lamp.beams for module in modules)
    return [module.beam(LOW) for module in modules] if known else []


def _flux_lm(simulation: Simulation, lights: Sequence[Tensor]) -> list[float]:
    """Flux in lm of each lamp, within the power limit."""
    modules, limit = simulation.modules, simulation.scenario.lighting.power_limit or 1.0
    own, most = flux_by_side(modules, lights), flux_by_side(modules, [torch.ones_like(module.flux) for module in modules])
    return [min(lm, limit * most[side]) for side, lm in own.items()]


def _watts(simulation: Simulation, lights: Sequence[Tensor]) -> float:
    params = simulation.scenario.headlight
    return sum(map(params.power_w, _flux_lm(simulation, [params.at_full_current(u) for u in lights])))
