"""Pictures of headlamps: beams on a wall, on the road, for the driver and in fog; pixels and light textures."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor

from luxloop.loop.report import charts
from luxloop.loop.report.overview import draw_overview
from luxloop.loop.report.panels import WALL_M, draw_birdseye, draw_eye, draw_pixels, draw_texture, draw_wall
from luxloop.loop.report.style import STYLE
from luxloop.loop.report.styles import check_out, style_of
from luxloop.loop.report.views import SIDES, LitCar, Road, beside, birdseye, driver
from luxloop.loop.scenario.model import HeadlightParams, Scenario
from luxloop.loop.simulation.build_lamps import turn
from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole
from luxloop.world.headlight.lamp import Commands, Lamp
from luxloop.world.light.volumetric import Medium

DPI = 110
VISIBILITY_M = 100.0

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
    """Draw one picture of lamps at work; returns its file.

    lamps: by side, "left" and "right" or one of them. out: the file, whose suffix says its format. beam: a name that the lamps know, by
    default low, or full where they have none; or utilisations `[n_p]` in 0..1, one a module, by side, which title names. commands: how
    modules are turned and dimmed beside that, one a module, by side; by default not at all. view and style: see VIEWS. scenario: its road,
    objects and light at time_s, where the lamps are mounted and how they are turned; by default a flat road. visibility_m: meteorological
    optical range of the fog in the view "volume", by default 100. Raises LuxloopError for unknown names, options that do not apply to the
    view, and a file that cannot be written.
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
    car = LitCar({side: turn(lamp, side, mount) for side, lamp in lamps.items()}, patterns, mount).under(commands or {})
    with rc_context(STYLE):
        write(_draw(car, name, view, style, Road(scenario, time_s), visibility_m), out)
    return out


def write(figure: Figure, out: Path) -> None:
    """Save a figure, whole or not at all. Raises LuxloopError where the file cannot be written."""
    FigureCanvasAgg(figure)
    with whole(out) as part:
        figure.savefig(part, format=out.suffix[1:].lower())


def _patterns(
    lamps: Mapping[str, Lamp], beam: str | Mapping[str, Sequence[Tensor]] | None, title: str
) -> tuple[str, Mapping[str, Sequence[Tensor]]]:
    """A pattern's name, and its utilisations by side, float32."""
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


def _draw(car: LitCar, beam: str, view: str, style: str, road: Road, visibility_m: float) -> Figure:
    match view:
        case "overview":
            figure = _page(car, beam, "", (14.0, 8.1))
            draw_overview(figure, car, beam, road)
        case "wall":
            figure = _page(car, beam, WALL[style], (11.5, 5.0))
            draw_wall(figure.subplots(), car, style)
        case "birdseye":
            figure = _page(car, beam, ROAD[style], (11.5, 5.0))
            draw_birdseye(figure.subplots(), road.look(car, birdseye()), style, road.lane_width_m)
        case "driver":
            figure = _page(car, beam, DRIVER[style], _eye_inches(style))
            seen = road.look(car, driver())
            axes = figure.subplots()
            draw_eye(axes, seen, style)
            if style != "isolux":
                charts.distance_marks(axes, seen, road.lane_width_m)
        case "volume":
            figure = _page(car, beam, f"in fog, visibility {visibility_m:g} m", _eye_inches(style))
            seen = road.look(car, beside(), Medium.fog(visibility_m))
            axes = figure.subplots()
            draw_eye(axes, seen, style)
            charts.car_outline(axes, seen)
        case _:
            figure = _modules(car, beam, view)
    return figure


def _modules(car: LitCar, beam: str, view: str) -> Figure:
    """A panel for each module: a lamp a column, or all in one where there is one lamp."""
    rows, columns = max(len(lamp.modules) for lamp in car.lamps.values()), len(car.lamps)
    what = "utilisation of the pixels" if view == "pixels" else "light textures"
    figure = _page(car, beam, what, (9.0 if columns == 1 else 13.0, 0.6 + 2.4 * rows))
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
    return figure


def _eye_inches(style: str) -> tuple[float, float]:
    """Of a page that a picture of 16 : 9 fills, beside the scale of false colours if there is one."""
    return (11.0, 5.85) if style == "falsecolour" else (11.0, 6.5)


def _page(car: LitCar, beam: str, what: str, inches: tuple[float, float]) -> Figure:
    """A figure with its title."""
    figure = Figure(inches, DPI, layout="constrained")
    names = " and ".join(dict.fromkeys(lamp.name for lamp in car.lamps.values()))
    which = "both lamps" if len(car.lamps) > 1 else f"{next(iter(car.lamps))} lamp"
    figure.suptitle("  ·  ".join(filter(None, (names, beam, which, what))), x=0.012, ha="left", fontsize=11.5, weight="bold")
    return figure
