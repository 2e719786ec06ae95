"""Pictures of headlamps: a beam on a wall, on the road, for the driver and in fog; pixels and light textures."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from luxloop.loop.report.charts import WALL_M, car_outline, distance_marks, draw_birdseye, draw_eye, draw_pixels, draw_texture, draw_wall
from luxloop.loop.report.facts import borders_deg, flux_lm, peak
from luxloop.loop.report.style import columns, drawing, no_frame, page_title, rows
from luxloop.loop.report.styles import check_out, style_of
from luxloop.loop.report.terminal import plural
from luxloop.loop.report.views import SIDES, LitCar, Road, beside, birdseye, driver, grey, picture
from luxloop.loop.scenario.model import HeadlightParams, Scenario
from luxloop.loop.simulation.lamps import turn_part
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import REST, Commands, Lamp, ModuleCommand
from luxloop.world.light.emitters import surface_light
from luxloop.world.rendering.gbuffer import flat_road
from luxloop.world.scene.air import Medium

DPI = 110
VISIBILITY_M = 100.0
REACHES_LX = (1.0, 3.0, 10.0)
NAME = 15  # characters of a name on one line with its value
CELL_M, ROAD_M = 0.5, (0.0, 300.0)

WALL = {
    "isolux": f"illuminance of a wall at {WALL_M:g} m in lx",
    "isocandela": "luminous intensity in kcd",
    "falsecolour": f"illuminance of a wall at {WALL_M:g} m",
    "luminance": f"a white wall at {WALL_M:g} m",
}
ROAD = {"isolux": "illuminance of the road in lx", "falsecolour": "illuminance of the road", "luminance": "the road from above"}
DRIVER = {"isolux": "illuminance in lx, for the driver", "falsecolour": "luminance for the driver", "luminance": "the driver's view"}


def show_headlight(  # noqa: PLR0913 (each value stands by itself)
    lamps: Mapping[str, Lamp],
    out: Path,
    *,
    beam: str | Mapping[str, Sequence[Tensor]] | None = None,
    commands: Mapping[str, Commands] | None = None,
    view: str = "overview",
    style: str | None = None,
    scenario: Scenario | None = None,
    time_s: float = 0.0,
    title: str = "own pattern",
    visibility_m: float | None = None,
) -> Path:
    """Draw a picture of the light of lamps; returns its file.

    lamps: by side, "left" and "right" or one of them. out: picture file, whose suffix is its format. beam: name of a beam, by default low,
    or full for lamps without a low beam; or utilisations `[n_p]` in 0..1 by side, one a module, named by title. commands: swivel, level and
    intensity of modules by side, one a module; by default at rest. view, style: see VIEWS. scenario: gives road, objects and ambient light
    at time_s, and the mounting of the lamps; by default a flat road. visibility_m: meteorological optical range of the fog in the view
    "volume", by default 100. Raises LuxloopError for unknown names, options that do not apply to the view, and a file that cannot be
    written.
    """
    style = style_of(view, style)
    check_out(out)
    if view in ("pixels", "texture") and scenario is not None:
        raise LuxloopError(f"the view {view!r} shows the lamps by themselves; leave the scenario out or choose another view")
    if view != "volume" and visibility_m is not None:
        raise LuxloopError(f"the view {view!r} has no fog; leave the visibility out or choose the view 'volume'")
    visibility_m = VISIBILITY_M if visibility_m is None else visibility_m
    if not 0 < visibility_m < math.inf:
        raise LuxloopError(f"visibility of {visibility_m:g} m: give a number greater than 0")
    name, patterns = _patterns(lamps, beam, title)
    mount = scenario.headlight if scenario else HeadlightParams()
    car = LitCar({side: turn_part(lamp, side, mount) for side, lamp in lamps.items()}, patterns, mount).under(commands or {})
    with drawing(out, (11.5, 5.0), dpi=DPI) as figure:
        subject = _draw(figure, car, name, view, style, Road(scenario, time_s), visibility_m)
        which = "both lamps" if len(lamps) > 1 else f"{next(iter(lamps))} lamp"
        page_title(figure, " and ".join(dict.fromkeys(lamp.name for lamp in lamps.values())), name, which, subject)
    return out


def lights_by_side(scenario: Scenario, lamp: str, time_s: float) -> tuple[Mapping[str, Sequence[Tensor]], Mapping[str, Commands]]:
    """Utilisations `[n_p]` and commands of a lamp's modules in a scenario at a time, by side; zero for modules that are off.

    lamp: preset or lamp file that replaces the scenario's. Raises LuxloopError where the scenario cannot use the lamp.
    """
    headlight = scenario.headlight.model_copy(update={"model": lamp, "intensity_cd": None})
    try:
        simulation = Simulation.prepare(scenario.model_copy(update={"headlight": headlight}))
    except LuxloopError as error:
        first, *others = error.args
        raise LuxloopError(
            f"{lamp} cannot show what {scenario.name} draws; give --beam for a beam of {lamp} there, or correct this: {first}", *others
        ) from error
    lights, commands = simulation.lights_at(time_s)
    found: dict[str, list[Tensor]] = {}
    turned: dict[str, list[ModuleCommand]] = {}
    for module, u, command in zip(simulation.modules, lights, commands or (REST,) * len(lights), strict=True):
        mine = found.setdefault(module.side, [torch.zeros(each.headlight.n_pixels) for each in module.lamp.modules])
        mine[module.number] = u
        turned.setdefault(module.side, [REST] * len(mine))[module.number] = command
    return found, {side: tuple(each) for side, each in turned.items()}


def _patterns(
    lamps: Mapping[str, Lamp], beam: str | Mapping[str, Sequence[Tensor]] | None, title: str
) -> tuple[str, Mapping[str, Sequence[Tensor]]]:
    """Name of a beam, and its utilisations `[n_p]` by side, one a module."""
    if not lamps or not set(lamps) <= set(SIDES):
        raise LuxloopError(
            f"lamps by the sides {', '.join(map(repr, lamps)) or 'of none'}: give them by 'left' and 'right', or one of them"
        )
    if beam is not None and not isinstance(beam, str):
        if missing := [side for side in lamps if side not in beam]:
            raise LuxloopError(f"beam: there are no utilisations for the {missing[0]} lamp; give them for each side that has a lamp")
        return title, {side: _pattern(side, lamp, beam[side]) for side, lamp in lamps.items()}
    name = beam or ("low" if all(lamp.default_beam == "low" for lamp in lamps.values()) else "full")
    return name, {side: lamp.beam(name) for side, lamp in lamps.items()}


def _pattern(side: str, lamp: Lamp, utilisations: Sequence[Tensor]) -> tuple[Tensor, ...]:
    if len(utilisations) != len(lamp.modules):
        raise LuxloopError(f"beam of the {side} lamp: {len(utilisations)} utilisations for {len(lamp.modules)} modules; give one a module")
    for module, u in zip(lamp.modules, utilisations, strict=True):
        where, n = f"beam of the {side} lamp, module {module.name!r}", module.headlight.n_pixels
        if u.shape != (n,):
            raise LuxloopError(f"{where}: utilisations of shape {tuple(u.shape)}; give a vector of {n}, one a pixel")
        if not ((u >= 0) & (u <= 1)).all():
            raise LuxloopError(f"{where}: utilisations must be numbers from 0 to 1, these are not; scale or clamp them")
    return tuple(u.to(module.headlight.matrix.values) for module, u in zip(lamp.modules, utilisations, strict=True))


def _draw(figure: Figure, car: LitCar, beam: str, view: str, style: str, road: Road, visibility_m: float) -> str:
    """Draw a view of the car's light; returns the subject of the picture."""
    if view in ("driver", "volume"):
        figure.set_size_inches(11.0, 5.85 if style == "falsecolour" else 6.5)  # a picture of 16 : 9, with a scale of false colours
    match view:
        case "overview":
            figure.set_size_inches(14.0, 8.1)
            _draw_overview(figure, car, beam, road)
            return ""
        case "wall":
            draw_wall(figure.subplots(), car, style)
            return WALL[style]
        case "birdseye":
            draw_birdseye(figure.subplots(), road.look(car, birdseye()), style, road.lane_width_m)
            return ROAD[style]
        case "driver":
            seen, axes = road.look(car, driver()), figure.subplots()
            draw_eye(axes, seen, style)
            if style != "isolux":
                distance_marks(axes, seen, road.lane_width_m)
            return DRIVER[style]
        case "volume":
            seen, axes = road.look(car, beside(), Medium.fog(visibility_m)), figure.subplots()
            draw_eye(axes, seen, style)
            car_outline(axes, seen)
            return f"in fog, visibility {visibility_m:g} m"
        case _:
            _draw_modules(figure, car, view)
            return "utilisation of the pixels" if view == "pixels" else "light textures"


def _draw_modules(figure: Figure, car: LitCar, view: str) -> None:
    """Draw a panel for each module, a column for each lamp."""
    rows, columns = max(len(lamp.modules) for lamp in car.lamps.values()), len(car.lamps)
    figure.set_size_inches(9.0 if columns == 1 else 13.0, 0.6 + 2.4 * rows)
    panels = figure.subplots(rows, columns, squeeze=False)
    textures = {
        side: [module.headlight.light_texture(u) for module, u in zip(lamp.modules, car.patterns[side], strict=True)]
        for side, lamp in car.lamps.items()
        if view == "texture"
    }
    for column, (side, lamp) in enumerate(car.lamps.items()):
        for axes in panels[len(lamp.modules) :, column]:
            axes.set_visible(False)
        for row, (module, u) in enumerate(zip(lamp.modules, car.patterns[side], strict=True)):
            axes, light = panels[row, column], module.headlight
            if view == "pixels":
                axes.set_title(f"{side}, {module.name}: {light.pixel_rows} x {light.pixel_cols} pixels")
                draw_pixels(axes, light, u)
            else:
                axes.set_title(f"{side}, {module.name}: {light.rows} x {light.cols} texels")
                brightest = max(float(each[row].max()) for each in textures.values() if row < len(each))
                draw_texture(axes, light, textures[side][row], brightest)


def _draw_overview(figure: Figure, car: LitCar, beam: str, road: Road) -> None:
    """Draw wall, road, driver's view and facts on one page."""
    top, bottom = rows(figure, 3.9, 3.7)
    left, right = columns(top, 9.2, 4.4)
    wall = left.subplots()
    wall.set_title(f"Illuminance of a wall at {WALL_M:g} m in lx")
    draw_wall(wall, car, "isolux")
    above, eye = bottom.subplots(1, 2, width_ratios=(8.0, 5.9))
    above.set_title("Illuminance of the road in lx")
    draw_birdseye(above, road.look(car, birdseye()), "isolux", road.lane_width_m)
    eye.set_title("The driver's view")
    ahead = road.look(car, driver(960))
    draw_eye(eye, ahead, "luminance")
    distance_marks(eye, ahead, road.lane_width_m)
    text = right.subplots()
    no_frame(text)
    _write_facts(text, facts(car, beam))


def facts(car: LitCar, beam: str) -> list[tuple[str, str]]:
    """Facts of a beam as names and values: pixels, flux and peak of the first lamp, and the reach of all lamps."""
    side, lamp = next(iter(car.lamps.items()))
    pattern = car.patterns[side]
    fluxes = [flux_lm(module.headlight, module.headlight.light_texture(u)) for module, u in zip(lamp.modules, pattern, strict=True)]
    brightest = peak(lamp, pattern)
    return [
        ("beam", beam),
        (f"{side} lamp", f"{plural(sum(module.headlight.n_pixels for module in lamp.modules), 'pixel')}, {sum(fluxes):,.0f} lm"),
        *((f"   {module.name}", _module_facts(module.headlight, flux)) for module, flux in zip(lamp.modules, fluxes, strict=True)),
        (
            "peak" if len(car.lamps) == 1 else f"{side} peak",
            f"{brightest.candela / 1e3:.3g} kcd, {brightest.candela / WALL_M**2:.3g} lx at {WALL_M:g} m",
        ),
        ("", "even" if brightest.even else f"{_angle(brightest.h_deg, 'right', 'left')}, {_angle(brightest.v_deg, 'up', 'down')}"),
        ("reach", "facing the car, at the road, both lamps" if len(car.lamps) > 1 else "facing the car, at the road"),
        *((f"   {lux:g} lx", _reach(car, lux)) for lux in REACHES_LX),
    ]


def reach_m(car: LitCar, lux: float) -> float:
    """Reach in m: largest distance on a flat road at which an upright surface on the road has an illuminance; 0 if there is none."""
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


def _module_facts(light: Headlight, flux: float) -> str:
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
