"""report.png: the camera's view, the road from above, the beams on a wall, charts over time, and symbols under control."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill

import numpy as np
import pyarrow as pa
import torch
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import SubFigure
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from luxloop.loop.recording.checks import lines
from luxloop.loop.recording.manifest import Manifest
from luxloop.loop.recording.remedies import SHADOW
from luxloop.loop.recording.summary import Summary
from luxloop.loop.report.courses import write_courses
from luxloop.loop.report.highlights import Highlights
from luxloop.loop.report.onlooker import Onlooker
from luxloop.loop.report.picture import MARKS_RGB, WALL_DEG, camera_luminance, marks, readable, rectangle, wall_light, white_of
from luxloop.loop.report.run_table import processing
from luxloop.loop.report.style import SHARES, columns, drawing, field, no_frame, page_title, rows
from luxloop.loop.report.symbol import HIGH_IN, draw_symbol
from luxloop.loop.report.terminal import plural
from luxloop.loop.report.views import BIRDSEYE_X_M, BIRDSEYE_Y_M, birdseye, driver
from luxloop.loop.scenario.plant import shadow_of
from luxloop.loop.simulation.columns import of_one
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.lamps import under
from luxloop.loop.simulation.light_figures import ObservedSymbol
from luxloop.loop.simulation.result import mean_lights
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.eye import exposure_of
from luxloop.world.frames import View, transform

WIDE_IN, DPI = 13.0, 130
LIGHT_IN, ABOVE_IN = 8.6, 3.4  # height of the part on all light, and of its row of pictures from above
TALLER_IN = 2.2  # added with a detector, for two large pictures of the camera, and with materials, for their chart
WALL_COLUMNS = 480
MARK_IN = 0.06  # width of a mark's character, with its share of the margins of a picture
LINE_IN, FACTS = 0.16, 225  # height of a line of facts, and its characters
SMALL, HIGH = 3, {1: 2.0, 2: 2.2, 3: 3.2}  # pictures of the camera below the driver's; its height for their number, relative to theirs
LEGEND = 110  # characters of a line of the legend of the camera's pictures
OBSERVED = 4  # observers' pictures that fit side by side
FAINTEST_ROAD_LX, BRIGHTEST_ROAD_LX, ROAD_LEVELS_LX = 0.1, 30.0, (1.0, 3.0)  # of the picture from above, and its lines
AROUND_M = 2.0  # margin around the light in the picture from above
RAYS_ABOVE = 1e6  # of the picture from above, four for each pixel of the page


def write_report(file: Path, simulation: Simulation, highlights: Highlights, table: pa.Table, summary: Summary, manifest: Manifest) -> None:
    """Draw a run of at least one step on one page: a part on all light, unless there are only symbols, a part on each symbol, and facts.

    file: of the format that its suffix names. simulation: of the last step. table, summary, manifest: of the recording. Raises LuxloopError
    if the file cannot be written.
    """
    shown = [each for each in highlights.symbols if each.last is not None and each.name in simulation.controlled]
    parts: list[tuple[float, Callable[[SubFigure], None]]] = []
    if not shown or not symbols_alone(simulation):
        high = LIGHT_IN + (simulation.pipeline is not None or bool(highlights.moments[-1].materials)) * TALLER_IN
        parts.append((high, lambda figure: _draw_light(figure, simulation, highlights, table, summary, high)))
    for each in shown:
        own = of_one(table, each.name), summary["functions"][each.name]
        parts.append((HIGH_IN, partial(draw_symbol, simulation=simulation, history=each, table=own[0], summary=own[1])))
    facts = _facts(simulation, summary, manifest)
    parts.append((LINE_IN * (facts.count("\n") + 2), lambda figure: _write_facts(figure, facts)))
    heights = [height for height, _ in parts]
    with drawing(file, (WIDE_IN, sum(heights)), dpi=DPI) as figure:
        for place, (_, draw) in zip(rows(figure, *heights), parts, strict=True):
            draw(place)


def symbols_alone(simulation: Simulation) -> bool:
    """Whether symbols under control are all that shines and is watched."""
    scenario, lighting = simulation.scenario, simulation.scenario.lighting
    others = simulation.planner.functions.keys() - simulation.controlled.keys()
    below = lighting.raw or lighting.painted or lighting.base.beam != "off"
    return not (others or simulation.recorded_ids or scenario.detector or below)


def _draw_light(figure: SubFigure, simulation: Simulation, highlights: Highlights, table: pa.Table, summary: Summary, high: float) -> None:
    """Draw the part of a page on all light. high: its height in inches."""
    moments = highlights.moments
    last, upper = moments[-1], high - ABOVE_IN
    page_title(figure, *_title(simulation, last, summary), size=12)
    left, right = columns(figure, 7.6, 5.4)
    observed = [(result, symbol) for result in moments for symbol in result.symbols][-OBSERVED:]
    heights = (upper, ABOVE_IN, 1.6) if observed else (upper, ABOVE_IN)
    top, bottom, *below = rows(left, *heights)
    if simulation.truth is None:
        _cameras(top, simulation, moments)
    else:
        _views(top, simulation, highlights)
    _from_above(bottom.subplots(), simulation, last)
    for figure_below in below:
        _observers(figure_below, observed)
    courses, walls = rows(right, upper, ABOVE_IN)
    write_courses(courses, simulation, table, summary)
    _walls(walls, simulation, last)


def _title(simulation: Simulation, last: Evaluation, summary: Summary) -> tuple[str, ...]:
    dark_lx, folder = summary["dark_lx_max"], shadow_of(simulation.scenario.plant)
    return (
        simulation.scenario.name,
        simulation.modules[0].lamp.name,
        f"{plural(summary['steps'], 'step')} to {last.time_s:.2f} s",
        "" if dark_lx is None else f"{dark_lx:.3g} lx at most on masked objects",
        "" if folder is None else f"{SHADOW} {Path(folder).name}",
    )


def _facts(simulation: Simulation, summary: Summary, manifest: Manifest) -> str:
    """What a reviewer asks of a run: when and with what it was made, the time of a step, the lamps and their notes, the checks."""
    scenario, lamps = simulation.scenario, {module.lamp.name: module.lamp.notes for module in simulation.modules}
    made = ", ".join(f"{name} {manifest.versions[name]}" for name in ("luxloop", "python", "torch"))
    flicker = f"; symbols on for {1 - scenario.off_share:.0%} at {scenario.rate_hz:g} Hz" if scenario.symbols else ""
    paragraphs = [
        f"Run of {manifest.started_utc[:16].replace('T', ' ')} UTC with {made}; renderer {manifest.renderer}, seed {manifest.seed}, "
        f"scenario {manifest.scenario_sha256[:12]}; {processing(summary, 'a step')}{flicker}",
        *(f"Lamp {name}. {' '.join(notes.split())}" for name, notes in lamps.items()),
        *(f"{name}: {line}" for name, line in lines(summary).items()),
    ]
    return "\n".join(fill(each, FACTS) for each in paragraphs)


def _write_facts(figure: SubFigure, text: str) -> None:
    figure.text(0.012, 1.0, text, fontsize=8, va="top", linespacing=1.3)


def _views(figure: SubFigure, simulation: Simulation, highlights: Highlights) -> None:
    """Draw what the driver sees while the functions are at work, and the camera's pictures below."""
    (then, busiest), moments = highlights.busiest, highlights.moments
    white = float(max(white_of(result, simulation) for result in moments))
    small = (moments[0], busiest) if busiest.detections is not None and busiest is not moments[0] else moments[:SMALL]
    grid = figure.add_gridspec(2, len(small), height_ratios=(HIGH[len(small)], 1))
    axes = figure.add_subplot(grid[0, :])
    onlooker, light = Onlooker.of(then, driver()), mean_lights(busiest, then.scenario.shares)
    commands, exposure_ev = busiest.now.commands, then.scenario.video.exposure_ev
    if exposure_ev is None:
        exposure_ev = exposure_of(onlooker.light(busiest.time_s, light, commands))
    axes.imshow(onlooker.picture(busiest.time_s, light, commands, exposure_ev))
    axes.set_title(f"The driver at {busiest.time_s:.2f} s, exposure {exposure_ev:.1f} EV", weight="normal")
    no_frame(axes)
    for number, result in enumerate(small):
        _camera(figure.add_subplot(grid[1, number]), simulation, result, white)
    figure.supxlabel(fill(_legend(simulation), LEGEND), x=0.02, ha="left", fontsize=8)


def _cameras(figure: SubFigure, simulation: Simulation, moments: Sequence[Evaluation]) -> None:
    """Draw the camera's pictures: with a detector the first and the last at the same size, else the last large and the others small."""
    white = float(max(white_of(result, simulation) for result in moments))
    *before, end = moments
    figure.suptitle(fill(_legend(simulation), LEGEND), x=0.02, ha="left", fontsize=9)
    if before and end.detections is not None:
        for axes, result in zip(figure.subplots(2, 1), (before[0], end), strict=True):
            _camera(axes, simulation, result, white)
        return
    rows = figure.add_gridspec(2, len(before), height_ratios=(1, 2)) if before else figure.add_gridspec(2, 1, height_ratios=(1e-3, 1))
    for number, result in enumerate(before):
        _camera(figure.add_subplot(rows[0, number]), simulation, result, white)
    _camera(figure.add_subplot(rows[1, :]), simulation, end, white)


def _legend(simulation: Simulation) -> str:
    """Legend of the colours in the camera's pictures."""
    kinds = {function.kind for function in simulation.scenario.functions.values()}
    zones = "; named: zones" if "zone" in kinds else ""
    zones += "; blue: target of a held symbol" if simulation.controlled else ""
    if not simulation.recorded_ids and simulation.pipeline is None:
        return f"Camera's view{zones}"
    orange = ", orange where a mask keeps it dark" if "glare_free" in kinds else ""
    if simulation.pipeline is None:
        return f"Camera's view; green boxes: objects that functions receive{orange}{zones}"
    return f"Camera's view; green: tracked, with confidence{orange}; grey: found in this frame{zones}"


def _camera(axes: Axes, simulation: Simulation, result: Evaluation, white: float) -> None:
    image = (camera_luminance(result, simulation).cpu().numpy() / white).clip(0, 1) ** 0.5
    axes.imshow(image, **SHARES)
    place, figure = axes.get_subplotspec(), axes.figure
    assert place is not None
    across_in = figure.bbox.width / figure.dpi / place.get_gridspec().ncols * len(place.colspan)
    for mark in readable(marks(result, simulation), image.shape[1] * MARK_IN / across_in, image.shape[1]):
        colour = _colour(mark.kind)
        for (u0, v0), (u1, v1) in mark.lines:
            axes.plot([u0, u1], [v0, v1], color=colour, linewidth=0.7)
        text = axes.annotate(mark.text, mark.at, (0, 2), textcoords="offset points", color=colour, fontsize=6.5, clip_on=True)
        text.set_path_effects([withStroke(linewidth=1.5, foreground="black")])
    axes.set(xlim=(-0.5, image.shape[1] - 0.5), ylim=(image.shape[0] - 0.5, -0.5), xticks=[], yticks=[])
    beam = simulation.base(result.plan.base.name) + result.plan.base.shares
    watts = "" if result.detections is None else f", {sum(power.watts for power in result.powers.values()):.1f} W"
    asked = "asked for: " if shadow_of(simulation.scenario.plant) is not None else ""
    axes.set_title(f"Camera at {result.time_s:.2f} s, {asked}{beam}{watts}", weight="normal")


def _observers(figure: SubFigure, observed: Sequence[tuple[Evaluation, ObservedSymbol]]) -> None:
    figure.suptitle("Symbols as seen by their observers: luminance relative to that of a white picture", x=0.02, ha="left", fontsize=9)
    for axes, (result, symbol) in zip(figure.subplots(1, len(observed), squeeze=False)[0], observed, strict=True):
        axes.imshow(symbol.share.nan_to_num().cpu().numpy(), **SHARES)
        axes.set(xticks=[], yticks=[], anchor="N")
        axes.set_title(f"{result.time_s:.2f} s, IoU {symbol.iou:.3f}", weight="normal")


def _from_above(axes: Axes, simulation: Simulation, last: Evaluation) -> None:
    axes.set(xlabel="ahead in m", ylabel="to the left in m")
    for each in last.now.objects:
        if each.since_s <= last.time_s < each.until_s:
            foot = transform(each.T_world_object.double(), rectangle(*each.size_m[:2]))[:2].T.numpy()
            colour = _colour("masked" if each.name in last.masked else "tracked")
            axes.add_patch(Polygon(foot, fill=False, color=colour, linewidth=1.2))
    if (truth := simulation.truth) is None:
        title = "Objects from above, at the end; the light on the road is unknown"
        axes.set(xlim=BIRDSEYE_X_M, ylim=BIRDSEYE_Y_M, title=title)
        return
    light, extent = _from_near(lambda view: truth.through(view, last.time_s).light(last.lights, last.now.commands)[0])
    most = float(light.max().clip(1, BRIGHTEST_ROAD_LX))
    scale = LogNorm(FAINTEST_ROAD_LX, most)
    shown = field(axes, light.clip(FAINTEST_ROAD_LX), extent, norm=scale)
    levels = [level for level in ROAD_LEVELS_LX if light.min() < level < light.max()]
    if levels:
        lines = axes.contour(light, levels=levels, colors="white", linewidths=0.6, extent=extent, origin="upper")
        axes.clabel(lines, fmt="%g lx", fontsize=7)
    axes.set(xlim=extent[:2], ylim=extent[2:], title="Illuminance from above, at the end")
    ticks = [tick for tick in (0.1, 0.3, 1, 3, 10, 30) if tick <= most]
    extend = "max" if light.max() > most else "neither"
    axes.figure.colorbar(shown, ax=axes, pad=0.01, ticks=ticks, extend=extend, format="%g lx").minorticks_off()


def _colour(kind: str) -> tuple[float, ...]:
    return tuple(value / 255 for value in MARKS_RGB[kind])


def _from_near(look: Callable[[View], torch.Tensor]) -> tuple[NDArray[np.floating], tuple[float, float, float, float]]:
    """Illuminance `[H, W]` in lx of the lit part of the road from above, and its extent in m. Each pixel is the mean of four rays, since
    shadows on a rough road are finer than a pixel. look: gives the illuminance in a view.
    """
    (left, right), (low, high) = lit_part(look(birdseye()).cpu().numpy())
    cell_m = math.sqrt((right - left) * (high - low) / RAYS_ABOVE)
    wide, tall = (2 * math.ceil(length / cell_m / 2) for length in (right - left, high - low))
    column, row = round((left - BIRDSEYE_X_M[0]) / cell_m), round((BIRDSEYE_Y_M[1] - high) / cell_m)
    near = look(birdseye(cell_m).within(slice(row, row + tall), slice(column, column + wide)))
    return torch.nn.functional.avg_pool2d(near[None], 2)[0].cpu().numpy(), (left, right, low, high)


def lit_part(light: NDArray[np.floating]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ranges of x and y in m of the visible light in an illuminance `[H, W]` from above; the whole ranges if no light is visible."""
    columns, rows = (np.flatnonzero((light > FAINTEST_ROAD_LX).any(axis)) for axis in (0, 1))
    if not len(columns):
        return BIRDSEYE_X_M, BIRDSEYE_Y_M
    x, y = np.linspace(*BIRDSEYE_X_M, light.shape[1]), np.linspace(*BIRDSEYE_Y_M[::-1], light.shape[0])
    return (x[columns[0]] - AROUND_M, x[columns[-1]] + AROUND_M), (y[rows[-1]] - AROUND_M, y[rows[0]] + AROUND_M)


def _walls(figure: SubFigure, simulation: Simulation, last: Evaluation) -> None:
    sides = tuple(dict.fromkeys(module.side for module in simulation.modules))
    side_deg, down_deg, up_deg = WALL_DEG
    for axes, side in zip(figure.subplots(len(sides), 1, squeeze=False, sharex=True)[:, 0], sides, strict=True):
        mine = [number for number, module in enumerate(simulation.modules) if module.side == side]
        modules = under(simulation.modules, last.now.commands)
        mount = simulation.scenario.headlight
        wall = wall_light([modules[n] for n in mine], [last.lights[n] for n in mine], mount, WALL_COLUMNS)
        extent = (-side_deg, side_deg, -down_deg, up_deg)
        most = float(wall.max())
        field(axes, wall.cpu().numpy(), extent, "lx", vmin=0, vmax=most or 1)
        axes.set(title=f"The {side} lamp on a wall at 25 m, at the end: {most:.3g} lx at most", ylabel="up in deg")
    axes.set_xlabel("to the right in deg")
