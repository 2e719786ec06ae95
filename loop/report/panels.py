"""Panels of headlamp pictures: a wall, the road from above, a view, pixels, a light texture."""

import math

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator
from torch import Tensor

from luxloop.loop.report import charts
from luxloop.loop.report.style import field, no_frame, scale
from luxloop.loop.report.views import BIRDSEYE_X_M, BIRDSEYE_Y_M, Image, LitCar, RoadView, grey, picture
from luxloop.world.headlight import Headlight
from luxloop.world.light.emitters import wall_illuminance

WALL_M, WALL_POINTS = 25.0, (641, 321)
WHITE_WALL = 0.8  # albedo
FAINTEST = 1 / 500  # of the peak, that a wall's picture still reaches to


def wall_angles(car: LitCar) -> tuple[Image, Image]:
    """Angles in deg, `[W]` to the right and `[H]` up, of a rectangle that holds the beam."""
    h, v = torch.arange(-60.0, 60.5, 0.5), torch.arange(-25.0, 25.25, 0.25)
    light = car.intensity(*torch.meshgrid(h, v, indexing="xy")).numpy()
    lit = light > light.max() * FAINTEST
    columns, rows = h.numpy()[lit.any(0)], v.numpy()[lit.any(1)]
    if not len(columns):
        return np.linspace(-10, 10, WALL_POINTS[0]), np.linspace(-4, 2, WALL_POINTS[1])
    h_range = min(columns[0] - 1.0, -5.0), max(columns[-1] + 1.0, 5.0)
    v_range = min(rows[0] - 0.5, -2.0), max(rows[-1] + 0.5, 1.5)
    return np.linspace(*h_range, WALL_POINTS[0]), np.linspace(*v_range, WALL_POINTS[1])


def draw_wall(axes: Axes, car: LitCar, style: str) -> None:
    """A wall before the car, in angles from the only lamp or the middle of both."""
    h, v = wall_angles(car)
    H, V = torch.meshgrid(torch.from_numpy(h), torch.from_numpy(v), indexing="xy")
    extent = (h[0], h[-1], v[0], v[-1])
    axes.set(xlim=extent[:2], ylim=extent[2:])
    if style == "isocandela":
        charts.isolines(axes, h, v, car.intensity(H, V).numpy() / 1e3)
    else:
        light = wall_illuminance(car.sources, car.T_world_middle, H, V, WALL_M)
        if style == "isolux":
            charts.isolines(axes, h, v, grey(picture(light)))
        elif style == "falsecolour":
            charts.false_colours(axes, grey(picture(light))[::-1], extent, "lx")
        else:
            charts.luminance_image(axes, (picture(light) * WHITE_WALL / math.pi)[::-1], extent)
    charts.degree_grid(axes)


def draw_birdseye(axes: Axes, seen: RoadView, style: str, lane_width_m: float) -> None:
    """The road from above, the way ahead to the right."""
    (x0, x1), (y0, y1) = BIRDSEYE_X_M, BIRDSEYE_Y_M
    if style == "isolux":
        rows, cols = seen.illuminance.shape
        x, y = (np.arange(cols) + 0.5) / cols, (np.arange(rows) + 0.5) / rows
        charts.isolines(axes, x0 + x * (x1 - x0), y1 - y * (y1 - y0), seen.illuminance)
    elif style == "falsecolour":
        charts.false_colours(axes, seen.illuminance, (x0, x1, y0, y1), "lx")
    else:
        charts.luminance_image(axes, seen.luminance, (x0, x1, y0, y1))
    ink = "0.2" if style == "isolux" else "white"
    charts.map_frame(axes, ink, lane_width_m)
    charts.object_outlines(axes, seen, (x0, x1, y0, y1), ink)


def draw_eye(axes: Axes, seen: RoadView, style: str) -> None:
    """A picture as an eye sees it."""
    rows, cols = seen.illuminance.shape
    extent = (0, cols, rows, 0)
    if style == "falsecolour":
        charts.false_colours(axes, grey(seen.luminance), extent, "cd/m²")
    else:
        charts.luminance_image(axes, seen.luminance, extent, dimmed=style == "isolux")
        if style == "isolux":
            charts.isolines(axes, np.arange(cols) + 0.5, np.arange(rows) + 0.5, seen.illuminance, most=5, on_black=True)
    axes.set_aspect("equal")
    axes.set(xlim=(0, cols), ylim=(rows, 0))
    no_frame(axes)


def draw_pixels(axes: Axes, light: Headlight, utilisation: Tensor) -> None:
    """Utilisation of a module's pixels in %, with the dark half of the scale stretched."""
    image = 100 * utilisation.view(light.pixel_rows, light.pixel_cols).cpu().numpy()
    extent = (-0.5, light.pixel_cols - 0.5, light.pixel_rows - 0.5, -0.5)  # a pixel's number at its middle
    shown = field(axes, image, extent, cmap="magma", norm=PowerNorm(0.5, 0, 100), interpolation="nearest")
    axes.set(xlabel="column", ylabel="row")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(8, integer=True))
    scale(axes, shown, "%").set_ticks([0, 5, 20, 50, 100])


def draw_texture(axes: Axes, light: Headlight, texture: Tensor, peak_cd: float) -> None:
    """A module's light texture `[rows, cols]` in cd, up to a peak, on the plane of tangents with a scale in degrees."""
    image = texture.cpu().numpy() / 1e3
    extent = (-light.left, -light.right, light.bottom, light.top)
    shown = field(axes, image, extent, vmin=0, vmax=(peak_cd or 1e3) / 1e3)
    for axis, ends in ((axes.xaxis, extent[:2]), (axes.yaxis, extent[2:])):
        axis.set_major_locator(FixedLocator(_round_tangents(*ends)))
        axis.set_major_formatter(FuncFormatter(lambda tangent, _: charts.degrees(math.degrees(math.atan(tangent)))))
    axes.set(xlabel="to the right", ylabel="up")
    scale(axes, shown, "kcd")


def _round_tangents(start: float, end: float) -> list[float]:
    """Tangents of round angles between two tangents, spaced for their labels."""
    low, high = sorted((start, end))
    first, last = (math.degrees(math.atan(tangent)) for tangent in (low, high))
    step = next(step for step in (0.5, 1, 2, 5, 10, 20) if (last - first) / step <= 9)
    kept: list[float] = []
    for angle in sorted(np.arange(math.ceil(first / step) * step, last + 1e-9, step), key=abs, reverse=True):
        tangent = math.tan(math.radians(angle))
        if all(abs(tangent - other) > 0.07 * (high - low) for other in kept):
            kept.append(tangent)
    return kept
