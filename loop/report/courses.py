"""Charts over time: flux, electrical power, modules, symbols, zones, materials, confidence, and light on objects."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import cycle, product
from textwrap import fill
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from matplotlib.ticker import LogFormatter, SymmetricalLogLocator

from luxloop.controllers.functions.commands import MOVEMENTS
from luxloop.loop.recording.checks import IN_FULL_LIGHT
from luxloop.loop.recording.functions_summary import UNITS, brightest, materials_of, plain_name, reference_power, zones_of
from luxloop.loop.recording.summary import Summary, column
from luxloop.loop.report.style import FOUR, heading
from luxloop.loop.report.terminal import plural
from luxloop.loop.simulation.columns import held_in
from luxloop.loop.simulation.simulation import Simulation

COLOURS = (*FOUR, "#56b4e9", "#d55e00", "#000000", "#999999")
GREYS = (":", "--", "-.")  # line styles of reference beams
FAINTEST_LX = 0.01  # start of the logarithmic scale of illuminance on objects
TI_PERCENT = (1.0, 10.0)  # start of the logarithmic scale of threshold increments, and its least upper end
LINE = 85  # characters of a line as wide as a chart
FEW_STEPS = 30  # steps up to which curves have markers


def write_courses(figure: SubFigure, simulation: Simulation, table: pa.Table, summary: Summary) -> None:
    """Draw a chart for each kind of columns in a recording, one below the other."""
    charts: dict[Callable[[Axes], None], float] = {lambda axes: _flux(axes, simulation, table): 1.0}  # with relative heights
    if "power_w" in table.column_names:
        charts[lambda axes: _power(axes, simulation, table)] = 1.1
    commanded = [name for name in table.column_names if name.startswith("modules.")]
    if turned := [name for name in commanded if name.endswith("_deg")]:
        charts[lambda axes: _modules(axes, table, turned, summary, "Modules in deg, swivelled to the left and levelled down")] = 1.2
    if dimmed := [name for name in commanded if name.endswith(".intensity")]:
        charts[lambda axes: _modules(axes, table, dimmed, summary, "Maximum intensity of modules, as a share of their own")] = 1.0
    if held := held_in(table):
        charts[lambda axes: _symbols(axes, table, held)] = 1.4
    if zones := zones_of(table):
        charts[lambda axes: _zones(axes, table, zones)] = 2.0
    if probes := [name for name in table.column_names if name.startswith("probes.") and name.endswith(".lx")]:
        charts[lambda axes: _probes(axes, table, probes)] = 1.4
    if eyes := [name for name in table.column_names if name.startswith("probes.") and name.endswith(".ti_percent")]:
        charts[lambda axes: _eyes(axes, table, eyes)] = 1.6
    if any(materials_of(table, quantity) for quantity in UNITS):
        charts[lambda axes: _materials(axes, table)] = 2.0
    shown = brightest(summary["objects"])
    if any(summary["objects"][name].get("tracks") for name in shown):
        charts[lambda axes: _confidences(axes, table, shown, summary)] = 1.4
    if scores := [name.removesuffix(IN_FULL_LIGHT) for name in table.column_names if name.endswith(f".score{IN_FULL_LIGHT}")]:
        charts[lambda axes: _scores(axes, table, scores)] = 1.2
    if any(each["lx_max"] is not None for each in summary["objects"].values()):
        charts[lambda axes: _on_objects(axes, table, shown, summary)] = 1.6
    panels = figure.subplots(len(charts), 1, sharex=True, squeeze=False, height_ratios=list(charts.values()))[:, 0]
    for axes, chart in zip(panels, charts, strict=True):
        chart(axes)
    panels[-1].set_xlabel("time in s")


def _curve(axes: Axes, table: pa.Table, values: str | np.ndarray, *line: str, **style: Any) -> None:
    """Plot values, or a column by its name and beside it that in full light, if there is one, over time."""
    times_s, marker = column(table, "time_s"), "." if table.num_rows < FEW_STEPS else ""
    axes.plot(times_s, column(table, values) if isinstance(values, str) else values, *line, **{"marker": marker} | style)
    if isinstance(values, str) and (full := values + IN_FULL_LIGHT) in table.column_names:
        axes.plot(times_s, column(table, full), "--", **style | {"linewidth": 0.9, "marker": "", "label": "in full light"})


def _flux(axes: Axes, simulation: Simulation, table: pa.Table) -> None:
    for side, colour in zip(dict.fromkeys(module.side for module in simulation.modules), FOUR, strict=False):
        factor = column(table, f"lamp.{side}.power_factor").min()
        label = f"{side}, dimmed to {100 * factor:.0f} % in the worst step" if factor < 1 else side
        _curve(axes, table, f"lamp.{side}.flux_lm", color=colour, label=label)
    axes.set_ylim(0, 1.08 * axes.dataLim.ymax or 1)
    heading(axes, "Luminous flux of the lamps in lm")


def _power(axes: Axes, simulation: Simulation, table: pa.Table) -> None:
    _curve(axes, table, "power_w", color="black", label="this run")
    for (name, watts), line in zip(reference_power(simulation, table).items(), GREYS, strict=False):
        _curve(axes, table, watts, line, color="0.5", label=name, marker="")
    axes.set_ylim(0, 1.08 * axes.dataLim.ymax or 1)
    heading(axes, "Electrical power in W, beside that of undimmed beams")


def _modules(axes: Axes, table: pa.Table, names: Sequence[str], summary: Summary, title: str) -> None:
    """Draw a curve for each group of modules with equal commands."""
    alike = defaultdict(list)
    for name in names:
        module, movement = name.removeprefix("modules.").rsplit(".", 1)
        at_end = summary["modules"][module][movement].get("steps_at_end", 0)
        alike[at_end, *column(table, name)].append((module, movement))
    for ((at_end, *values), moved), colour in zip(alike.items(), cycle(COLOURS), strict=False):
        who = dict.fromkeys(module for module, _ in moved)
        whose = "all" if len(who) == len(summary["modules"]) else ", ".join(who)
        movements = {movement for _, movement in moved}
        how = " and ".join(words for movement, words in MOVEMENTS.items() if movement in movements)
        ends = f", at a limit in {at_end} of {table.num_rows} steps" if at_end else ""
        _curve(axes, table, np.array(values), color=colour, label=f"{whose} {how}{ends}")
    if names[0].endswith(".intensity"):
        axes.set_ylim(-0.02, 1.05)
    heading(axes, title)


def _symbols(axes: Axes, table: pa.Table, held: Sequence[str]) -> None:
    for name, colour in zip(held, cycle(COLOURS), strict=False):
        evaluated = table.filter(table[f"functions.{name}.iou"].is_valid())
        marker = "." if table.num_rows < FEW_STEPS else ""
        _curve(axes, evaluated, f"functions.{name}.iou", color=colour, label=plain_name(name), marker=marker)
        lost = table.filter([reason not in (None, "", "no_frame") for reason in table[f"functions.{name}.loss"].to_pylist()])
        _curve(axes, lost, np.zeros(lost.num_rows), color=colour, linestyle="", marker="x", markersize=4)
    axes.set_ylim(-0.02, 1.02)
    heading(axes, "Overlap (IoU) of held symbols with their targets (x: lost)")


def _zones(axes: Axes, table: pa.Table, zones: Sequence[str]) -> None:
    for name, colour in zip(zones, cycle(COLOURS), strict=False):
        _curve(axes, table, f"functions.{name}.luminance", color=colour, label=plain_name(name))
        _curve(axes, table, f"functions.{name}.target", "--", color=colour, linewidth=0.9, marker="")
    axes.set_ylim(0, 1.08 * axes.dataLim.ymax)
    heading(axes, "Luminance of zones in cd/m², and what is wanted (dashed)")


def _probes(axes: Axes, table: pa.Table, probes: Sequence[str]) -> None:
    for name, colour in zip(probes, cycle(COLOURS), strict=False):
        _curve(axes, table, name, color=colour, label=plain_name(name.split(".")[1]))
    axes.set_ylim(bottom=0)
    heading(axes, "The lamps' light on probes in lx")


def _eyes(axes: Axes, table: pa.Table, eyes: Sequence[str]) -> None:
    for name, colour in zip(eyes, cycle(COLOURS), strict=False):
        most = np.fmax.reduce(column(table, name))
        label = plain_name(name.split(".")[1]) + ("" if most else ": 0 % throughout")
        _curve(axes, table, name, color=colour, label=label)
    start, least = TI_PERCENT
    axes.set_yscale("symlog", linthresh=start)
    axes.set_ylim(-start / 10, max(least, 1.5 * axes.dataLim.ymax))
    ticks = SymmetricalLogLocator(base=10, linthresh=start)
    ticks.set_params(numticks=4)
    axes.yaxis.set_major_locator(ticks)
    axes.yaxis.set_major_formatter(lambda percent, _: f"{percent:g}")
    heading(axes, "Threshold increment in % by the lamps in eyes")


def _materials(axes: Axes, table: pa.Table) -> None:
    materials = [(name, quantity) for quantity in UNITS for name in materials_of(table, quantity)]
    for (name, quantity), (line, colour) in zip(materials, cycle(product(("-", "--", ":"), COLOURS)), strict=False):
        values, wanted = (column(table, f"functions.{name}.{each}") for each in (quantity, "wanted"))
        if not wanted[-1]:
            continue  # dark has no share
        label = f"{plain_name(name)}: {wanted[-1]:g} {UNITS[quantity]}".replace("^2", "²")
        _curve(axes, table, values / wanted, line, color=colour, label=label)
    axes.axhline(1.0, color="0.5", linewidth=0.9)
    axes.set_ylim(bottom=0)
    heading(axes, "Light of materials, median, as a share of what is wanted")


def _confidences(axes: Axes, table: pa.Table, names: Sequence[str], summary: Summary) -> None:
    """Draw the objects that a track shows at some time, in their colours of `_on_objects`."""
    for name, colour in zip(names, COLOURS, strict=False):
        if summary["objects"][name]["tracks"]:
            _curve(axes, table, f"objects.{name}.confidence", color=colour, label=plain_name(name), marker="")
    axes.set(ylim=(0, 1.02))
    nothing = summary["tracks_of_nothing"]
    heading(axes, "Confidence of tracked objects" + (f" (false tracks in {nothing} steps)" if nothing else ""))


def _scores(axes: Axes, table: pa.Table, scores: Sequence[str]) -> None:
    for name, colour in zip(scores, cycle(COLOURS), strict=False):
        _curve(axes, table, name, color=colour, label=plain_name(name.split(".")[1]))
    axes.set(ylim=(-0.02, 1.05))
    heading(axes, "Scores of detections in single frames")


def _on_objects(axes: Axes, table: pa.Table, names: Sequence[str], summary: Summary) -> None:
    """Draw the named objects one by one, and the largest illuminance on any other object in sight."""
    most_lx = {name: each["lx_max"] for name, each in summary["objects"].items()}
    others = [name for name, lx in most_lx.items() if lx is not None and name not in names]
    for name, colour in zip(names, COLOURS, strict=False):
        _curve(axes, table, f"objects.{name}.lx_mean", color=colour, label=plain_name(name) if most_lx[name] else None)
        _curve(axes, table, f"objects.{name}.lx_max", ":", color=colour, linewidth=0.9, marker="")
    if dark := [plain_name(name) for name in names if not most_lx[name]]:
        note = fill(f"0 lx throughout: {', '.join(dark)}", LINE)
        axes.text(0.99, 0.06, note, transform=axes.transAxes, fontsize=8, ha="right")
    if others:
        most = np.fmax.reduce([column(table, f"objects.{name}.lx_max") for name in others])
        lit = "" if np.nanmax(most) else ": 0 lx"
        label = f"most on {plural(len(others), 'other' if names else 'object')}{lit}"
        _curve(axes, table, most, color="0.5", linewidth=0.9, label=label, marker="")
    if summary.get("eyes_lx_max") is not None:
        _curve(axes, table, "eyes_lx_max", "--", color="0.5", label="heads, windscreens", marker="")
    if axes.dataLim.ymin < FAINTEST_LX:
        axes.set_yscale("symlog", linthresh=FAINTEST_LX)
        axes.set_ylim(bottom=-FAINTEST_LX / 10)
    else:
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(LogFormatter())
    axes.yaxis.set_major_formatter(lambda lx, _: f"{lx:g}")
    heading(axes, "The lamps' light on objects in lx, mean and most (dotted)")
