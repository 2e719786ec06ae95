"""Charts of light, drawn into matplotlib axes: isolux lines, false colours with their scale, luminance as the eye sees it."""

import math

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.patches import Polygon, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, MultipleLocator, NullLocator

from luxloop.loop.report.style import SHARES, scale
from luxloop.loop.report.views import BIRDSEYE_X_M, BIRDSEYE_Y_M, Image, RoadView, grey

FALSE_COLOURS = "turbo"
MOST_LINES, DECADES = 8, 3
DARK_TO_BRIGHT = LinearSegmentedColormap.from_list("lines", ["#1f3f8f", "#1878b4", "#118a6b", "#5b9a12", "#c79a00", "#dd6b00", "#c01818"])
ON_BLACK = LinearSegmentedColormap.from_list("lines on black", ["#6f9dff", "#4fd0e8", "#6fe39a", "#d8e85a", "#ffc13d", "#ff8a5c"])
BESIDE_M = 0.15  # of the lane's edge stand the distances
MARKS_M = (10, 20, 30, 50, 100)  # distances written beside the lane
CAR_M = (-4.4, 0.05, 0.9, 1.45)  # rear, front, half of the width, height


def steps(peak: float, most: int = MOST_LINES) -> list[float]:
    """Values 1, 2, 5, 10 ... below a peak, ascending, over three decades at most; a single one where there is no light."""
    if peak <= 0:
        return [1.0]
    exponent = math.floor(math.log10(peak))
    series = [m * 10.0**e for e in range(exponent - DECADES, exponent + 1) for m in (1, 2, 5)]
    return [value for value in series if value < peak][-most:]


def isolines(axes: Axes, x: Image, y: Image, values: Image, most: int = MOST_LINES, on_black: bool = False) -> None:
    """Labelled lines of equal value over x `[W]` and y `[H]`; values `[H, W]`, NaN where there is nothing."""
    finite = np.nan_to_num(values)
    levels = steps(float(finite.max()), most)
    if not (finite > levels[0]).any():
        axes.text(0.5, 0.5, "no light here", transform=axes.transAxes, ha="center", va="center", color="0.5")
        return
    norm = LogNorm(levels[0], max(levels[-1], 2 * levels[0]))
    lit = np.maximum(values, 1e-3 * levels[0])  # matplotlib masks zeros on a logarithmic scale, and would leave lines open there
    lines = axes.contour(x, y, lit, levels=levels, cmap=ON_BLACK if on_black else DARK_TO_BRIGHT, norm=norm, linewidths=1.1)
    labels = axes.clabel(lines, fmt=lambda value: f"{value:g}", fontsize=8, inline_spacing=3)
    for label in labels:
        label.set_path_effects([withStroke(linewidth=2.5, foreground="black" if on_black else "white")])


def false_colours(axes: Axes, values: Image, extent: tuple[float, float, float, float], label: str) -> None:
    """An image in false colours on a logarithmic scale of three decades, with a labelled colour bar; darker values get the darkest
    colour.
    """
    light = np.nan_to_num(values)
    peak = float(light.max()) or 1.0
    least = peak / 10**DECADES
    norm = LogNorm(least, peak)
    shown = axes.imshow(np.maximum(light, least), cmap=FALSE_COLOURS, norm=norm, extent=extent, aspect="auto", interpolation="antialiased")
    bar = scale(axes, shown, label)
    bar.set_ticks([value for value in steps(1.0001 * peak, most=20) if value >= least])
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bar.ax.yaxis.set_minor_locator(NullLocator())


def luminance_image(axes: Axes, luminance: Image, extent: tuple[float, float, float, float], dimmed: bool = False) -> None:
    """A luminance `[H, W]` in cd/m^2, or linear sRGB `[H, W, 3]`, with a bright part of it white and a display's gamma."""
    light = grey(luminance)
    white = max(float(np.quantile(light, 0.99)), float(light.max()) / 20, 1e-9)
    code = (luminance / white).clip(0, 1) ** (1 / 2.2) * (0.6 if dimmed else 1.0)
    axes.imshow(code, extent=extent, aspect="auto", **SHARES)


def degrees(angle: float) -> str:
    """An angle on a scale."""
    return f"{angle:.3g}°".replace("-", "−")


def degree_grid(axes: Axes) -> None:
    """A grid of degrees with the lines H-H and V-V, as on a measuring screen at 25 m."""
    for axis, ticks in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        span = abs(ticks[1] - ticks[0])
        major = next(step for step in (1, 2, 5, 10, 20) if span / step <= 20)
        axis.set_major_locator(MultipleLocator(major))
        axis.set_minor_locator(MultipleLocator(major if major == 1 else major / (2 if major != 5 else 5)))
        axis.set_major_formatter(FuncFormatter(lambda angle, _: degrees(angle)))
    axes.grid(True, which="major", alpha=0.45)
    axes.grid(True, which="minor", alpha=0.18)
    axes.axhline(0, color="0.45", lw=1)
    axes.axvline(0, color="0.45", lw=1)
    axes.set_xlabel("to the right")
    axes.set_ylabel("up")


def map_frame(axes: Axes, ink: str, lane_width_m: float) -> None:
    """The road from above: scales in metres, the lane's edges, and the car."""
    rear, front, half, _ = CAR_M
    axes.set(xlim=BIRDSEYE_X_M, ylim=BIRDSEYE_Y_M, xlabel="ahead in m", ylabel="to the left in m")
    axes.xaxis.set_major_locator(MultipleLocator(10))
    axes.yaxis.set_major_locator(MultipleLocator(5))
    for side in (-1, 1):
        axes.axhline(side * lane_width_m / 2, color=ink, lw=0.7, ls=(0, (8, 4)), alpha=0.6)
    axes.add_patch(Rectangle((rear, -half), front - rear, 2 * half, fill=False, ec=ink, lw=1))


def object_outlines(axes: Axes, seen: RoadView, extent: tuple[float, float, float, float], ink: str) -> None:
    """The outlines of all objects in a picture of this extent, row 0 at its upper end."""
    ids = seen.surfaces.object_id.cpu().numpy()
    rows, cols = ids.shape
    left, right, bottom, top = extent
    x = left + (np.arange(cols) + 0.5) / cols * (right - left)
    y = top + (np.arange(rows) + 0.5) / rows * (bottom - top)
    for number in np.unique(ids[ids > 0]):
        axes.contour(x, y, (ids == number).astype(float), levels=[0.5], colors=[ink], linewidths=1)


def distance_marks(axes: Axes, seen: RoadView, lane_width_m: float) -> None:
    """Distances beside the right edge of the lane in a view ahead, where the road is visible and labels do not overlap."""
    lowest = 0.97 * seen.view.height
    for metres in MARKS_M:
        place = seen.on_road(metres, -lane_width_m / 2 - BESIDE_M)
        if place is None:
            continue
        u, v = place
        if u < 0.95 * seen.view.width and v < lowest:
            text = axes.text(u, v, f"– {metres} m", color="0.85", fontsize=7.5, ha="left", va="center")
            text.set_path_effects([withStroke(linewidth=1.5, foreground="black")])
            lowest = v - 0.028 * seen.view.height


def car_outline(axes: Axes, seen: RoadView) -> None:
    """The edges of a car: tail, roof's end and nose, joined."""
    rear, front, half, height = CAR_M
    ribs = [
        [(x, side * half, z) for side, z in ((1, 0.25), (1, top), (-1, top), (-1, 0.25))]
        for x, top in ((rear, height), (rear + 2.6, height), (front, 0.9))
    ]
    outline = seen.view.project(torch.tensor(ribs, dtype=torch.float64).flatten(0, 1).T)[0].T.unflatten(0, (3, 4)).numpy()
    for rib in outline:
        axes.add_patch(Polygon(rib, fill=False, ec="0.45", lw=0.8))
    axes.plot(outline[..., 0], outline[..., 1], color="0.45", lw=0.8)
