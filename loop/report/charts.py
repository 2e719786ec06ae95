"""Panels of headlamp pictures: a wall, the road from above, a view, pixels and light textures, as isolines, false colours or luminance."""

import math

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm, PowerNorm
from matplotlib.patches import Polygon, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import AutoMinorLocator, FixedLocator, MaxNLocator, MultipleLocator, NullLocator
from torch import Tensor

from luxloop.loop.report.facts import lit_deg
from luxloop.loop.report.style import SHARES, field, no_frame, scale
from luxloop.loop.report.views import BIRDSEYE_X_M, BIRDSEYE_Y_M, Image, LitCar, RoadView, grey, picture
from luxloop.world.headlight import Headlight
from luxloop.world.light.emitters import wall_illuminance

FALSE_COLOURS = "turbo"
MOST_LINES, DECADES = 8, 3
DARK_TO_BRIGHT = LinearSegmentedColormap.from_list("lines", ["#1f3f8f", "#1878b4", "#118a6b", "#5b9a12", "#c79a00", "#dd6b00", "#c01818"])
ON_BLACK = LinearSegmentedColormap.from_list("lines on black", ["#6f9dff", "#4fd0e8", "#6fe39a", "#d8e85a", "#ffc13d", "#ff8a5c"])
BESIDE_M = 0.15  # of distance marks from the lane's edge
MARKS_M = (10, 20, 30, 50, 100)  # distances marked beside the lane
CAR_M = (-4.4, 0.05, 0.9, 1.45)  # rear, front, half of the width, height


def steps(peak: float, most: int = MOST_LINES) -> list[float]:
    """Levels 1, 2, 5, 10 ... below a peak, ascending, over three decades at most; a single level without light."""
    if peak <= 0:
        return [1.0]
    exponent = math.floor(math.log10(peak))
    series = [m * 10.0**e for e in range(exponent - DECADES, exponent + 1) for m in (1, 2, 5)]
    return [value for value in series if value < peak][-most:]


def isolines(axes: Axes, x: Image, y: Image, values: Image, most: int = MOST_LINES, on_black: bool = False) -> None:
    """Draw labelled isolines of values `[H, W]`, NaN for no surface, over x `[W]` and y `[H]`. most: number of lines."""
    finite = np.nan_to_num(values)
    levels = steps(float(finite.max()), most)
    if not (finite > levels[0]).any():
        axes.text(0.5, 0.5, "no light here", transform=axes.transAxes, ha="center", va="center", color="0.5")
        return
    norm = LogNorm(levels[0], max(levels[-1], 2 * levels[0]))
    lit = np.maximum(values, 1e-3 * levels[0])  # matplotlib masks zeros on a logarithmic scale, which opens lines
    lines = axes.contour(x, y, lit, levels=levels, cmap=ON_BLACK if on_black else DARK_TO_BRIGHT, norm=norm, linewidths=1.1)
    labels = axes.clabel(lines, fmt="%g", fontsize=8, inline_spacing=3)
    for label in labels:
        label.set_path_effects([withStroke(linewidth=2.5, foreground="black" if on_black else "white")])


def false_colours(axes: Axes, values: Image, extent: tuple[float, float, float, float], label: str) -> None:
    """Draw values `[H, W]` in false colours on a logarithmic scale of three decades, with a labelled colour bar."""
    light = np.nan_to_num(values)
    peak = float(light.max()) or 1.0
    least = peak / 10**DECADES
    norm = LogNorm(least, peak)
    shown = axes.imshow(np.maximum(light, least), cmap=FALSE_COLOURS, norm=norm, extent=extent, aspect="auto", interpolation="antialiased")
    bar = scale(axes, shown, label)
    bar.set_ticks([value for value in steps(1.0001 * peak, most=20) if value >= least])
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.ax.yaxis.set_minor_locator(NullLocator())


def luminance_image(axes: Axes, luminance: Image, extent: tuple[float, float, float, float], dimmed: bool = False) -> None:
    """Draw a luminance `[H, W]` in cd/m^2, or linear sRGB `[H, W, 3]`, with a display's gamma; its 99 % quantile is white."""
    light = grey(luminance)
    white = max(float(np.quantile(light, 0.99)), float(light.max()) / 20, 1e-9)
    code = (luminance / white).clip(0, 1) ** (1 / 2.2) * (0.6 if dimmed else 1.0)
    axes.imshow(code, extent=extent, aspect="auto", **SHARES)


def degrees(angle: float, position: float = 0.0) -> str:
    """An angle in deg as the label of a scale, at any position."""
    return f"{angle:.3g}°".replace("-", "−")


def degree_grid(axes: Axes) -> None:
    """Draw a grid of degrees with the lines H-H and V-V, as on a measuring screen."""
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(20, steps=[1, 2, 5, 10], integer=True))
        axis.set_minor_locator(AutoMinorLocator(2))
        axis.set_major_formatter(degrees)
    axes.grid(True, which="major", alpha=0.45)
    axes.grid(True, which="minor", alpha=0.18)
    axes.axhline(0, color="0.45", lw=1)
    axes.axvline(0, color="0.45", lw=1)
    axes.set_xlabel("to the right")
    axes.set_ylabel("up")


def distance_marks(axes: Axes, seen: RoadView, lane_width_m: float) -> None:
    """Mark distances beside the right edge of the lane in a view, where the road is visible and labels do not overlap."""
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
    """Draw the edges of the car: cross-sections at tail, roof's end and nose, joined."""
    rear, front, half, height = CAR_M
    ribs = [
        [(x, side * half, z) for side, z in ((1, 0.25), (1, top), (-1, top), (-1, 0.25))]
        for x, top in ((rear, height), (rear + 2.6, height), (front, 0.9))
    ]
    outline = seen.view.project(torch.tensor(ribs, dtype=torch.float64).flatten(0, 1).T)[0].T.unflatten(0, (3, 4)).numpy()
    for rib in outline:
        axes.add_patch(Polygon(rib, fill=False, ec="0.45", lw=0.8))
    axes.plot(outline[..., 0], outline[..., 1], color="0.45", lw=0.8)


WALL_M, WALL_POINTS = 25.0, (641, 321)
WHITE_WALL = 0.8  # albedo


def draw_wall(axes: Axes, car: LitCar, style: str) -> None:
    """Draw a wall ahead of the car, in angles from the only lamp or from the point midway between both."""
    h, v = (np.linspace(*ends, count) for ends, count in zip(lit_deg(car.intensity), WALL_POINTS, strict=True))
    H, V = torch.meshgrid(torch.from_numpy(h), torch.from_numpy(v), indexing="xy")
    extent = (h[0], h[-1], v[0], v[-1])
    axes.set(xlim=extent[:2], ylim=extent[2:])
    if style == "isocandela":
        isolines(axes, h, v, car.intensity(H, V).numpy() / 1e3)
    else:
        light = wall_illuminance(car.sources, car.T_world_middle, H, V, WALL_M)
        if style == "isolux":
            isolines(axes, h, v, grey(picture(light)))
        elif style == "falsecolour":
            false_colours(axes, grey(picture(light))[::-1], extent, "lx")
        else:
            luminance_image(axes, (picture(light) * WHITE_WALL / math.pi)[::-1], extent)
    degree_grid(axes)


def draw_birdseye(axes: Axes, seen: RoadView, style: str, lane_width_m: float) -> None:
    """Draw the road from above, ahead to the right, with the lane's edges, the car and outlines of objects."""
    (x0, x1), (y0, y1) = BIRDSEYE_X_M, BIRDSEYE_Y_M
    rows, cols = seen.illuminance.shape
    x, y = x0 + (np.arange(cols) + 0.5) / cols * (x1 - x0), y1 - (np.arange(rows) + 0.5) / rows * (y1 - y0)
    if style == "isolux":
        isolines(axes, x, y, seen.illuminance)
    elif style == "falsecolour":
        false_colours(axes, seen.illuminance, (x0, x1, y0, y1), "lx")
    else:
        luminance_image(axes, seen.luminance, (x0, x1, y0, y1))
    axes.set(xlim=(x0, x1), ylim=(y0, y1), xlabel="ahead in m", ylabel="to the left in m")
    axes.xaxis.set_major_locator(MultipleLocator(10))
    axes.yaxis.set_major_locator(MultipleLocator(5))
    ink = "0.2" if style == "isolux" else "white"
    for side in (-1, 1):
        axes.axhline(side * lane_width_m / 2, color=ink, lw=0.7, ls=(0, (8, 4)), alpha=0.6)
    rear, front, half, _ = CAR_M
    axes.add_patch(Rectangle((rear, -half), front - rear, 2 * half, fill=False, ec=ink, lw=1))
    ids = seen.surfaces.object_id.cpu().numpy()
    for number in np.unique(ids[ids > 0]):
        axes.contour(x, y, (ids == number).astype(float), levels=[0.5], colors=[ink], linewidths=1)


def draw_eye(axes: Axes, seen: RoadView, style: str) -> None:
    """Draw a view in perspective."""
    rows, cols = seen.illuminance.shape
    extent = (0, cols, rows, 0)
    if style == "falsecolour":
        false_colours(axes, grey(seen.luminance), extent, "cd/m²")
    else:
        luminance_image(axes, seen.luminance, extent, dimmed=style == "isolux")
        if style == "isolux":
            isolines(axes, np.arange(cols) + 0.5, np.arange(rows) + 0.5, seen.illuminance, most=5, on_black=True)
    axes.set_aspect("equal")
    axes.set(xlim=(0, cols), ylim=(rows, 0))
    no_frame(axes)


def draw_pixels(axes: Axes, light: Headlight, utilisation: Tensor) -> None:
    """Draw the utilisation of a module's pixels in %, with the dark half of the scale stretched."""
    image = 100 * utilisation.view(light.pixel_rows, light.pixel_cols).cpu().numpy()
    extent = (-0.5, light.pixel_cols - 0.5, light.pixel_rows - 0.5, -0.5)  # numbers at the pixels' centres
    shown = field(axes, image, extent, cmap="magma", norm=PowerNorm(0.5, 0, 100), interpolation="nearest")
    axes.set(xlabel="column", ylabel="row")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(8, integer=True))
    scale(axes, shown, "%").set_ticks([0, 5, 20, 50, 100])


def draw_texture(axes: Axes, light: Headlight, texture: Tensor, peak_cd: float) -> None:
    """Draw a module's light texture `[rows, cols]` in cd up to a peak, on the plane of tangents with a scale in degrees."""
    image = texture.cpu().numpy() / 1e3
    extent = (-light.left, -light.right, light.bottom, light.top)
    shown = field(axes, image, extent, vmin=0, vmax=(peak_cd or 1e3) / 1e3)
    for axis, ends in ((axes.xaxis, extent[:2]), (axes.yaxis, extent[2:])):
        axis.set_major_locator(FixedLocator(_round_tangents(*ends)))
        axis.set_major_formatter(lambda tangent, _: degrees(math.degrees(math.atan(tangent))))
    axes.set(xlabel="to the right", ylabel="up")
    scale(axes, shown, "kcd")


def _round_tangents(start: float, end: float) -> list[float]:
    """Tangents of round angles in a range of tangents, spaced for their labels."""
    low, high = sorted((start, end))
    first, last = (math.degrees(math.atan(tangent)) for tangent in (low, high))
    step = next(step for step in (0.5, 1, 2, 5, 10, 20) if (last - first) / step <= 9)
    kept: list[float] = []
    for angle in sorted(np.arange(math.ceil(first / step) * step, last + 1e-9, step), key=abs, reverse=True):
        tangent = math.tan(math.radians(angle))
        if all(abs(tangent - other) > 0.07 * (high - low) for other in kept):
            kept.append(tangent)
    return kept
