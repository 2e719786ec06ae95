"""A headlamp on one page: its beam on the wall, on the road and for the driver, and its facts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from luxloop.loop.report import charts
from luxloop.loop.report.facts import borders_deg, flux_lm, peak
from luxloop.loop.report.panels import WALL_M, draw_birdseye, draw_eye, draw_wall
from luxloop.loop.report.terminal import counted
from luxloop.loop.report.views import LitCar, Road, birdseye, driver, grey, picture
from luxloop.world.headlight import Headlight
from luxloop.world.light.emitters import surface_light
from luxloop.world.rendering.gbuffer import flat_road

REACHES_LX = (1.0, 3.0, 10.0)
NAME = 15  # characters that fit before a value; longer names have a line of their own
CELL_M, ROAD_M = 0.5, (0.0, 300.0)


def draw_overview(figure: Figure, car: LitCar, beam: str, road: Road) -> None:
    """Fill a page."""
    top, bottom = figure.subfigures(2, 1, squeeze=False, height_ratios=(3.9, 3.7))[:, 0]
    left, right = top.subfigures(1, 2, squeeze=False, width_ratios=(9.2, 4.4))[0]
    wall = left.subplots()
    wall.set_title(f"Illuminance of a wall at {WALL_M:g} m in lx")
    draw_wall(wall, car, "isolux")
    above, eye = bottom.subplots(1, 2, width_ratios=(8.0, 5.9))
    above.set_title("Illuminance of the road in lx")
    draw_birdseye(above, road.look(car, birdseye()), "isolux", road.lane_width_m)
    eye.set_title("The driver's view")
    ahead = road.look(car, driver(960))
    draw_eye(eye, ahead, "luminance")
    charts.distance_marks(eye, ahead, road.lane_width_m)
    text = right.subplots()
    charts.no_frame(text)
    _write_facts(text, facts(car, beam))


def facts(car: LitCar, beam: str) -> list[tuple[str, str]]:
    """Facts of a beam as pairs of name and value: of the first lamp, and the reach of all lamps."""
    side, lamp = next(iter(car.lamps.items()))
    pattern = car.patterns[side]
    fluxes = [flux_lm(module.headlight, module.headlight.light_texture(u)) for module, u in zip(lamp.modules, pattern, strict=True)]
    brightest = peak(lamp, pattern)
    return [
        ("beam", beam),
        (f"{side} lamp", f"{counted(sum(module.headlight.n_pixels for module in lamp.modules), 'pixel')}, {sum(fluxes):,.0f} lm"),
        *((f"   {module.name}", _described(module.headlight, flux)) for module, flux in zip(lamp.modules, fluxes, strict=True)),
        ("peak", f"{brightest.candela / 1e3:.3g} kcd, {brightest.candela / WALL_M**2:.3g} lx at {WALL_M:g} m"),
        ("", "even" if brightest.even else f"{_angle(brightest.h_deg, 'right', 'left')}, {_angle(brightest.v_deg, 'up', 'down')}"),
        ("reach", "facing the car, at the road, both lamps" if len(car.lamps) > 1 else "facing the car, at the road"),
        *((f"   {lux:g} lx", _reach(car, lux)) for lux in REACHES_LX),
    ]


def reach_m(car: LitCar, lux: float) -> float:
    """Reach in m: the greatest distance ahead on a flat road with this illuminance at the road, on a surface facing the car; 0 if
    nowhere.
    """
    upright = flat_road(birdseye(CELL_M, ROAD_M), 1.0)
    normal = torch.zeros_like(upright.normal)
    normal[0] = -1
    light = grey(picture(surface_light(replace(upright, normal=normal), car.sources)[0]))
    columns = np.flatnonzero((light >= lux).any(0))
    return ROAD_M[0] + (int(columns[-1]) + 0.5) * CELL_M if len(columns) else 0.0


def _reach(car: LitCar, lux: float) -> str:
    metres = reach_m(car, lux)
    if metres > ROAD_M[1] - CELL_M:
        return f"beyond {ROAD_M[1]:g} m"
    return f"{metres:.0f} m" if metres else "nowhere on the road"


def _described(light: Headlight, flux: float) -> str:
    left, right, bottom, top = borders_deg(light)
    return f"{light.pixel_rows} x {light.pixel_cols}, {_range(-left, -right)} x {_range(bottom, top)}, {flux:,.0f} lm"


def _range(low: float, high: float) -> str:
    if abs(low + high) < 0.05:
        return f"±{high:.3g}°"
    return f"{low:+.3g} to {high:+.3g}°".replace("-", "−")


def _angle(angle: float, positive: str, negative: str) -> str:
    size = f"{abs(angle):.1f}°"
    return size if size == "0.0°" else f"{size} {positive if angle > 0 else negative}"


def _write_facts(axes: Axes, facts: Sequence[tuple[str, str]]) -> None:
    rows = [row for name, value in facts for row in ([(name, value)] if len(name) <= NAME else [(name, ""), ("", value)])]
    for i, (name, value) in enumerate(rows):
        y = 0.97 - i / max(len(rows), 12)
        axes.text(0.0, y, name, transform=axes.transAxes, va="top", fontsize=9.5, color="0.4")
        axes.text(0.24, y, value, transform=axes.transAxes, va="top", fontsize=9.5)
