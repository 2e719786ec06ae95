"""The part of report.png on a symbol under control, after the thesis' figures 9.12 to 9.17."""

from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from matplotlib.ticker import MaxNLocator, PercentFormatter
from numpy.typing import NDArray

from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.loop.recording.remedies import SHADOW, remedies, why_no_metrics
from luxloop.loop.recording.summary import DRAWN, Summary, column
from luxloop.loop.report.facts import borders_deg
from luxloop.loop.report.highlights import SymbolHistory
from luxloop.loop.report.style import FOUR, SHARES, STYLE, columns, field, heading, no_frame, page_title, rows
from luxloop.loop.report.terminal import number
from luxloop.loop.scenario.plant import shadow_of
from luxloop.loop.simulation.columns import ERRORS
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.lamps import Lights
from luxloop.loop.simulation.redrawn import open_loop_lights
from luxloop.loop.simulation.road_metrics import SymbolEvaluator
from luxloop.loop.simulation.simulated import SimulatedPlant
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.camera import luminance_of
from luxloop.perception.metrics import THRESHOLD
from luxloop.world.frames import View

Pairs = dict[str, tuple[Lights, Lights]]  # lights with a symbol and without it, by title
Image = NDArray[np.floating]

TARGET, PATH, LOST = "#00c8ff", "#ff2020", "#d55e00"
HIGH_IN = 9.4  # height of a symbol's part of a page
NOTE = 175  # characters of a line as wide as the page
WHY = 40  # characters of a line in a chart
OTHERWISE = (("black", "--"), (FOUR[2], "-"), (FOUR[3], "-"), ("0.5", "-"), ("black", ":"))  # colour and line of each curve of `DRAWN`
FEW_STEPS = 60  # steps up to which curves have markers
LEAST_M, LEAST_DEG = 0.01, 0.1  # least range of the axes of poses to both sides


def draw_symbol(figure: SubFigure, simulation: Simulation, history: SymbolHistory, table: pa.Table, summary: Summary) -> None:
    """Draw a symbol's part of a page. table: its columns (`luxloop.loop.simulation.columns.of_one`), one row or more. summary: the
    symbol's.
    """
    assert history.last is not None, "a page needs a step"
    symbol, last = simulation.controlled[history.name], history.last
    lights = {
        "without control (open loop)": open_loop_lights(simulation, last, history.name),
        "at the end": (last.exposures[0].lights, last.off.lights),
    }
    shadow = shadow_of(simulation.scenario.plant)
    page_title(figure, *_title(simulation, history.name, summary, shadow), size=11)
    notes = [] if shadow else remedies(history.name, summary)
    figure.supxlabel("\n".join(fill(note, NOTE) for note in notes), x=0.012, ha="left", fontsize=10)
    left, right = columns(figure, 4.3, 7.7)
    _courses(left, symbol.function, history, table, summary)
    views = _camera_images(simulation, lights, history, last)
    if symbol.evaluator is None:
        top, beam = rows(right, 2.75, 3.6)
    else:
        top, middle, bottom = rows(right, 2.75, 2.35, 3.6)
        _camera_views(middle, symbol, views)
        plane, beam = columns(bottom, 3.5, 4.2)
        _birds_eye_views(plane, symbol.evaluator, lights, last)
    view = last.sense.view if simulation.truth is None else simulation.truth.view_from_ground(last.time_s)
    _progression(top, symbol, history, views["at the end"], view)
    _beam_patterns(beam, symbol, lights["at the end"][0], "asked for" if shadow else "at the end")


def _title(simulation: Simulation, name: str, summary: Summary, shadow: str | None) -> tuple[str, ...]:
    controller = Path(summary["controller"]).name  # without the folder of a user's own module
    who = f"{simulation.scenario.name}: {name} ({controller})"
    if shadow is not None:
        return who, f"{SHADOW} {Path(shadow).name}"
    lost = f"lost in {summary['lost_steps']} of {summary['shown_steps']} steps" if summary["lost_steps"] else ""
    if (why := why_no_metrics(summary)) is not None:
        return who, why, lost
    unsettled = summary["unsettled"]
    settled = f"settled at step {summary['settle_step']}" if unsettled is None else f"not settled: {unsettled.replace('_', ' ')}"
    x, y = (number(value, ".1f") for value in summary["centroid_error_percent"])
    mean, mean_open, ended, ended_open = (number(summary[key], ".2f") for key in ("iou_mean", "iou_open_mean", "iou_final", "iou_open"))
    if summary["iou_open_mean"] is None:
        iou = f"IoU {ended} at the end, {ended_open} without control"
    else:
        iou = f"mean IoU {mean}, {mean_open} without control"
    return who, settled, iou, f"centroid error {x} %, {y} %", lost


def _courses(figure: SubFigure, target: SymbolFunctionParams, history: SymbolHistory, table: pa.Table, summary: Summary) -> None:
    errors, pose, truth = figure.subplots(3, 1, sharex=True)
    steps = column(table, "step")
    lost = np.array(table["loss"].to_pylist()) != ""
    for axes in (errors, pose, truth):
        label = "symbol lost" if axes is errors and lost.any() else None
        shade = {"color": LOST, "alpha": 0.18, "lw": 0, "label": label}
        axes.fill_between(steps, 0, 1, where=lost, step="mid", transform=axes.get_xaxis_transform(), **shade)
        if summary["settle_step"] is not None:
            axes.axvline(summary["settle_step"], color="0.3", lw=1.2, ls=":", label="settled" if axes is errors else None)
    marker = "o" if len(steps) <= FEW_STEPS else ""

    unit = " px" if target.features.view == "raw" else " m"
    units = (unit, unit, "" if target.features.shape == "moments" else unit, unit)
    for name, colour, unit in zip(ERRORS, FOUR, units, strict=True):
        values = column(table, name)
        peak = np.nanmax(np.abs(values), initial=0)
        label = f"$e_{{{name[2:]}}}$: {peak:.3g}{unit}"
        errors.plot(steps, values / (peak or 1), color=colour, marker=marker, ms=2.2, label=label)
    errors.set_ylim(-1.1, 1.1)
    errors.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    heading(errors, "Control errors, 100 % is the largest of each")

    turned = _right_axis(pose)
    pose.plot(steps, column(table, "x_m") - target.x_m, color=FOUR[0], label=f"x − {target.x_m:g} m")
    pose.plot(steps, column(table, "y_m") - target.y_m, color=FOUR[1], label=f"y − {target.y_m:g} m" if target.y_m else "y")
    turned.plot(steps, column(table, "roll_deg"), color=FOUR[2], ls="--", label="roll")
    turned.plot(steps, column(table, "pitch_deg"), color=FOUR[3], ls="--", label="pitch, nose down")
    if (z := column(table, "z_m")).any():
        pose.plot(steps, z, color="black", label="z")
    if history.shown:
        at = np.interp(list(history.shown), column(table, "time_s"), steps)
        shown = torch.stack(list(history.shown.values())).cpu().numpy()
        for values, place, colour, name in zip(shown.T, (target.x_m, target.y_m), FOUR, "xy", strict=False):
            pose.plot(at, values - place, color=colour, lw=0, marker=".", ms=4, label=f"{name} that was shown")
    for axes, least in ((pose, LEAST_M), (turned, LEAST_DEG)):
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, -least), max(high, least))
    pose.set_ylabel("position in m")
    turned.set_ylabel("angle in deg (dashed)")
    heading(pose, "Pose of the primitive", turned)

    truth.axhspan(-2, 2, color="0.5", alpha=0.15, lw=0)
    for name, colour, label in (("x", FOUR[0], "centroid along"), ("y", FOUR[1], "centroid across")):
        _line(truth, steps, column(table, f"centroid_error_{name}_percent"), color=colour, label=label)
    truth.set_yscale("symlog", linthresh=5, linscale=1.2)
    truth.yaxis.set_major_formatter(PercentFormatter(decimals=0))
    truth.set_yticks([-100, -20, -5, -2, 0, 2, 5, 20, 100])
    truth.set_ylabel("error in % of the symbol's size")
    overlap = _right_axis(truth)
    _line(overlap, steps, column(table, "iou"), color="black", label="IoU")
    if why := why_no_metrics(summary):
        truth.text(0.5, 0.5, fill(why, WHY), transform=truth.transAxes, ha="center", va="center", color="0.4")
    known = {key: summary.get(f"{key}_mean") for key in DRAWN}
    for (key, mean), (colour, line) in zip(known.items(), OTHERWISE, strict=True):
        if mean is not None:
            _line(overlap, steps, column(table, key), color=colour, ls=line, lw=1, label=f"{DRAWN[key]}: {mean:.2f}")
    if known["iou_open"] is None and summary["iou_open"] is not None:
        overlap.axhline(summary["iou_open"], color="black", ls="--", lw=1, label="IoU at the end in open loop")
    overlap.set(ylim=(0, 1), ylabel="IoU with the target")
    heading(truth, "How the symbol lies, without noise", overlap)
    truth.set(xlabel="control step", xlim=(steps[0], max(steps[-1], steps[0] + 1)))
    truth.xaxis.set_major_locator(MaxNLocator(integer=True))


def _line(axes: Axes, steps: Image, values: Image, **style: Any) -> None:
    """Plot the finite values over the steps, with markers if there are few; not all steps are evaluated."""
    there = np.isfinite(values)
    axes.plot(steps[there], values[there], marker="o" if there.sum() <= FEW_STEPS else "", ms=2.2, **style)


def _right_axis(axes: Axes) -> Axes:
    twin = axes.twinx()
    twin.grid(False)
    twin.spines["right"].set_visible(True)
    return twin


def _camera_images(simulation: Simulation, lights: Pairs, history: SymbolHistory, last: Evaluation) -> dict[str, Image]:
    """Luminances `[height, width]` in cd/m^2 that the camera measures, by title: of a simulated plant exposed anew at the last step's time,
    else of the newest frame.
    """
    camera, plant, time_s = simulation.scenario.camera, simulation.plant, last.time_s
    if isinstance(plant, SimulatedPlant):
        frames = {
            name: plant.exposed(*plant.world.luminance(time_s, on, last.now.commands), last.step, 0) for name, (on, _) in lights.items()
        }
    else:
        frames = {"at the end": torch.zeros(camera.height_px, camera.width_px) if history.frame is None else history.frame}
    return {name: luminance_of(frame, camera).cpu().numpy() for name, frame in frames.items()}


def _target(symbol: ControlledSymbol) -> tuple[torch.Tensor, torch.Tensor]:
    """Luminance `[height, width]` in cd/m^2 of a symbol at its target on a flat road, and the mask of its bright pixels."""
    projector = symbol.projector
    luminance = symbol.sensor.model.luminance(projector.light(projector.target))
    return luminance, luminance > THRESHOLD * symbol.brightness


def _night(image: Image, white: float) -> Image:
    """An image tone-mapped to 0..1, so that the dark road stays visible."""
    return (image / max(white, 1e-6)).clip(0, 1) ** (1 / 2.2)


def _show(axes: Axes, image: Image, white: float) -> None:
    height, width = image.shape
    axes.imshow(_night(image, white), extent=(0, width, height, 0), **SHARES)
    no_frame(axes)


def _white(symbol: ControlledSymbol, *images: Image) -> float:
    """Luminance in cd/m^2 that is shown as white: a high quantile of the target's or the scene's, so that glints do not darken the rest."""
    luminance, mask = _target(symbol)
    bright = luminance[mask]
    return max(float(bright.quantile(0.9)) if len(bright) else 0.0, *(float(np.quantile(image, 0.98)) for image in images))


def _progression(figure: SubFigure, symbol: ControlledSymbol, history: SymbolHistory, after: Image, view: View) -> None:
    """view: of the image after the last step, from the ground frame."""
    axes = figure.subplots()
    axes.set_title("Symbol progression in the camera's image  (red: past symbols and path, cyan: target)")
    _show(axes, after, _white(symbol, after))
    final = np.zeros(after.shape, bool)  # which past symbols leave free
    for crop, past in history.symbols[-1:]:
        final[crop.slices] = past
    for crop, past in history.symbols[:-1]:
        overlay = np.zeros((*past.shape, 4), np.float32)
        overlay[..., 0], overlay[..., 3] = 1.0, 0.3 * (past & ~final[crop.slices])
        axes.imshow(overlay, extent=(crop.u_start, crop.u_stop, crop.v_stop, crop.v_start), interpolation="nearest")
    outline_target(axes, symbol, view)
    path = np.array(history.path)
    axes.plot(*path.T, color=PATH, lw=1.3, marker="o", ms=2.5)
    seen = path[np.isfinite(path).all(1)]
    if len(seen):
        axes.plot(*seen[0], color=PATH, marker="o", ms=6, mfc="none", mew=1.4)
        axes.plot(*seen[-1], color=PATH, marker="x", ms=7, mew=1.8)
    boxes = [(crop.u_start, crop.v_start, crop.u_stop, crop.v_stop) for crop, _ in history.symbols]
    _look_at(axes, symbol, boxes, after.shape, aspect=2.75)


def outline_target(axes: Axes, symbol: ControlledSymbol, view: View) -> None:
    """Outline the target on the plane z = 0 as a view from the ground frame sees it."""
    mask, eye = _target(symbol)[1].cpu(), symbol.sensor.model.eye.view
    lit = torch.nonzero(mask)
    if not len(lit):
        return
    (v0, u0), (v1, u1) = (lit.amin(0) - 1).clamp(min=0).tolist(), (lit.amax(0) + 2).tolist()
    part = slice(v0, v1), slice(u0, u1)
    rays = eye.within(*part).rays().flatten(1)
    uv, _ = view.project(eye.origin[:, None] - rays * (eye.origin[2] / rays[2]))
    u, v = uv.unflatten(1, mask[part].shape).numpy()
    axes.contour(u, v, mask[part].float().numpy(), levels=[0.5], colors=TARGET, linewidths=0.8)


def _look_at(axes: Axes, symbol: ControlledSymbol, boxes: list[tuple[int, int, int, int]], shape: tuple[int, ...], aspect: float) -> None:
    """Zoom to the target and the boxes (u0, v0, u1, v1) with a margin, within the image. aspect: width over height of the window."""
    lit = torch.nonzero(_target(symbol)[1])
    if len(lit):
        (v0, u0), (v1, u1) = lit.amin(0).tolist(), lit.amax(0).tolist()
        boxes = [*boxes, (u0, v0, u1, v1)]
    if not boxes:
        return
    (u0, v0, *_), (*_, u1, v1) = np.min(boxes, 0), np.max(boxes, 0)
    width = min(max(1.15 * (u1 - u0), 1.8 * aspect * (v1 - v0)), shape[1])
    height = min(width / aspect, shape[0])
    u, v = np.clip(((u0 + u1) / 2, (v0 + v1) / 2), (width / 2, height / 2), (shape[1] - width / 2, shape[0] - height / 2))
    axes.set(xlim=(u - width / 2, u + width / 2), ylim=(v + height / 2, v - height / 2))


def _camera_views(figure: SubFigure, symbol: ControlledSymbol, views: dict[str, Image]) -> None:
    white = _white(symbol, *views.values())
    for axes, (name, image) in zip(figure.subplots(1, len(views), squeeze=False)[0], views.items(), strict=True):
        axes.set_title(f"Camera's view, {name}")
        _show(axes, image, white)
        _look_at(axes, symbol, [], image.shape, aspect=16 / 9)


def _birds_eye_views(figure: SubFigure, evaluator: SymbolEvaluator, lights: Pairs, last: Evaluation) -> None:
    goal, axes_m, symbol = evaluator.goal, evaluator.plane.axes, evaluator.symbol
    y, x = -axes_m.u.cpu().numpy(), -axes_m.v.cpu().numpy()
    mask = goal.mask.float().cpu().numpy()
    title = "From above, noise-free" if evaluator.view is None else "In the observer's view, as if from above, noise-free"
    figure.suptitle(title, x=0.12, ha="left", weight="bold", fontsize=STYLE["axes.titlesize"])
    for axes, (title, (on, off)) in zip(figure.subplots(1, 2, sharey=True), lights.items(), strict=True):
        plane = evaluator.from_above(on, off, last.time_s, last.now.commands).cpu().numpy()
        axes.imshow(_night(plane, 1.5 * float(goal.median)), extent=(y[0], y[-1], x[-1], x[0]), **SHARES)
        axes.contour(y, x, mask, levels=[0.5], colors=TARGET, linewidths=0.8)
        axes.set_title(title, weight="normal", loc="center")
        axes.grid(False)
        left, right = symbol.y_m + symbol.width_m, symbol.y_m - symbol.width_m
        axes.set(xlabel="to the left in m", xlim=(left, right), ylim=(symbol.x_m - symbol.length_m, symbol.x_m + 1.2 * symbol.length_m))
    figure.axes[0].set_ylabel("ahead in m")


def _beam_patterns(figure: SubFigure, symbol: ControlledSymbol, on: Lights, when: str) -> None:
    modules, lights = symbol.projector.modules, [on[k] for k in symbol.drawn_by]
    panels = figure.subplots(len(modules), 1, squeeze=False)[:, 0]
    for axes, module, light in zip(panels, modules, lights, strict=True):
        headlight = module.pixel_controller.headlight
        texture = headlight.light_texture(light.u).cpu().numpy() / 1e3
        left, right, bottom, top = borders_deg(headlight)
        drawn = field(axes, texture, (left, right, bottom, top))
        rows, cols = np.nonzero(texture > 0)
        if len(rows):
            v = top + (np.array([rows.max() + 1, rows.min()]) / headlight.rows) * (bottom - top)
            h = left + (np.array([cols.min(), cols.max() + 1]) / headlight.cols) * (right - left)
            axes.set_xlim(min(h[0] + 1.5, left), max(h[1] - 1.5, right))
            axes.set_ylim(max(v[0] - 0.5, bottom), min(v[1] + 0.5, top))
        axes.set_title(f"Beam pattern of {module.name} {when}")
        axes.set_ylabel("up in deg")
        figure.colorbar(drawn, ax=axes, label="kcd", pad=0.02)
    panels[-1].set_xlabel("to the left in deg")
