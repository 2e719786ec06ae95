"""The commands `luxloop headlight ...`: show, draw, build, export and check lamps and photometric files."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Literal

from cyclopts import App

from luxloop.loop.commands.options import DIFFERS, AllowCode, Points
from luxloop.loop.report import terminal as tables

if TYPE_CHECKING:
    from torch import Tensor

    from luxloop.world.headlight.lamp import Commands, Lamp

headlight_app = App(name="headlight", help="Lamps and photometric files: facts, pictures, lamp files, and the regulations' test points.")
PHOTOMETRIC = (".ies", ".ldt")


@headlight_app.command(name="list")
def list_() -> None:
    """Show the lamps that come with luxloop."""
    from luxloop.loop.commands.headlight_tables import presets

    tables.show(presets())


@headlight_app.command
def info(lamp: str, /) -> None:
    """Show the facts of a lamp or of a photometric file.

    Parameters
    ----------
    lamp
        Name of a preset (see `luxloop headlight list`), a lamp file (.npz), a description (.toml) or a photometric file (.ies, .ldt).
    """
    from luxloop.loop.commands import headlight_tables

    if Path(lamp).suffix.lower() in PHOTOMETRIC:
        from luxloop.world.photometry import read_all

        tables.show(headlight_tables.photometry(*read_all([Path(lamp)])))
        return
    from luxloop.world.lamps.description import load_lamp

    described = load_lamp(lamp)
    print(f"{described.name}\n{described.notes}\n" if described.notes else described.name)
    tables.show(headlight_tables.modules(described))
    print()
    tables.show(headlight_tables.beams(described))
    _print_compliance(described)


@headlight_app.command
def show(
    lamp: str,
    /,
    *,
    beam: str | None = None,
    view: str | None = None,
    style: str | None = None,
    side: Literal["both", "left", "right"] | None = None,
    traffic: Literal["left", "right"] | None = None,
    scenario: str | None = None,
    time_s: float | None = None,
    visibility_m: float | None = None,
    out: Path | None = None,
    allow_code: AllowCode = False,
) -> None:
    """Draw the light of a lamp, or a photometric file.

    Parameters
    ----------
    lamp
        Preset, lamp file (.npz), description (.toml) or photometric file (.ies, .ldt). Without --view, a photometric file is drawn as it
        was measured.
    beam
        Name of a beam, full or off; by default the scenario's light, else low, or full if the lamp has no low beam.
    view
        overview (the default), wall, birdseye, driver, volume, pixels or texture.
    style
        luminance, falsecolour, isolux or isocandela; not every view has all styles.
    side
        Which lamps are on; by default both.
    traffic
        Side of the road that traffic drives on, by default right; for left, the default beams are fitted to left-hand traffic.
    scenario
        Scenario that gives road, objects, ambient light and lighting functions; by default a flat road at night.
    time_s
        Time in the scenario in s; by default its start.
    visibility_m
        Visibility in the fog of the view volume in m; by default 100.
    out
        Picture to write (.png, .jpg, .pdf or .svg); by default named after lamp, beam and view.
    """
    from luxloop.loop.report.styles import check_out, style_of
    from luxloop.world.errors import LuxloopError

    stem = Path(lamp).stem
    if view is not None or style is not None:
        style_of(view or "overview", style)
    if out is not None:
        check_out(out)
    chosen = {
        "beam": beam,
        "style": style,
        "side": side,
        "traffic": traffic,
        "scenario": scenario,
        "time-s": time_s,
        "visibility-m": visibility_m,
    }
    if Path(lamp).suffix.lower() in PHOTOMETRIC and view is None:
        from luxloop.loop.report.photometry import show_distribution
        from luxloop.world.photometry import read_all

        for name, value in chosen.items():
            if value is not None:
                raise LuxloopError(f"--{name}: a photometric file is drawn as it was measured; give --view as well to draw it as a lamp")
        (photometry,) = read_all([Path(lamp)])
        print(f"{show_distribution(photometry, out or Path(f'{stem}.png'))} written")
    else:
        from luxloop.loop.report.headlight import lights_by_side, show_headlight
        from luxloop.loop.scenario.model import load
        from luxloop.world.lamps.description import for_traffic, load_lamp

        if time_s is not None and (scenario is None or not 0 <= time_s < math.inf):
            raise LuxloopError("--time-s: is a time in a --scenario, in s from its start; give both, and a number of 0 or more")
        sides: tuple[Literal["left", "right"], ...] = ("left", "right") if side is None or side == "both" else (side,)
        lamps: dict[str, Lamp] = {each: for_traffic(load_lamp(lamp, each), traffic or "right") for each in sides}
        target = out or Path("-".join([stem, *([beam] if beam else []), *([style] if style else []), view or "overview"]) + ".png")
        world, shown = None if scenario is None else load(scenario, allow_code=allow_code), beam or lamps[sides[0]].default_beam
        pattern: str | Mapping[str, Sequence[Tensor]] = shown
        commands: Mapping[str, Commands] = {}
        if world is not None and beam is None:
            if traffic is not None:
                raise LuxloopError("--traffic: a scenario's light does not depend on the side of the road; name a --beam")
            (pattern, commands), shown = lights_by_side(world, lamp, time_s or 0.0), f"{world.name} at {time_s or 0.0:g} s"
            lamps = {each: lamps[each] for each in lamps if each in pattern} or lamps
            world = None if view in ("pixels", "texture") else world
        written = show_headlight(
            lamps,
            target,
            beam=pattern,
            commands=commands,
            view=view or "overview",
            style=style,
            scenario=world,
            time_s=time_s or 0.0,
            title=shown,
            visibility_m=visibility_m,
        )
        print(f"{written} written: {next(iter(lamps.values())).name}, beam {shown}")


@headlight_app.command
def build(description: Path, /, *, out: Path | None = None) -> None:
    """Build a lamp file from a description in TOML, and report how well the light textures reproduce the source.

    Parameters
    ----------
    description
        TOML file with a [[module]] table for each module.
    out
        Lamp file to write; by default the description's name, ending in .npz.
    """
    from luxloop.loop.commands import headlight_tables
    from luxloop.world.lamps.archive import save
    from luxloop.world.lamps.description import build as build_lamp

    with _pixels_done() as on_progress:
        lamp, report = build_lamp(description, on_progress=on_progress)
    target = out or description.with_suffix(".npz")
    save(target, lamp)
    tables.show(headlight_tables.built(report))
    _print_compliance(lamp)
    print(f"{target} written, {target.stat().st_size / 1e6:.1f} MB; look at it with: luxloop headlight show {quote(str(target))}")


@headlight_app.command
def export(
    lamp: str,
    /,
    *,
    out: Path,
    beam: str | None = None,
    side: Literal["left", "right"] = "left",
    traffic: Literal["left", "right"] = "right",
    step_deg: float = 0.1,
) -> None:
    """Write a beam as an IES file (LM-63-2019, type A) or as EULUMDAT, by the suffix, for other programs.

    Parameters
    ----------
    lamp
        Preset, lamp file or description.
    out
        File to write, ending in .ies or .ldt.
    beam
        Name of the beam, full or off; by default low, or full where the lamp has no low beam.
    side
        Side of the car that the lamp is for.
    traffic
        Side of the road that the traffic drives on; for the left, default beams are fitted to it.
    step_deg
        Step of both angles in deg; in EULUMDAT of gamma, whose planes are 1 deg apart.
    """
    from luxloop.loop.report.export_light import export as export_beam
    from luxloop.world.lamps.description import for_traffic, load_lamp

    exported = for_traffic(load_lamp(lamp, side), traffic)
    name = beam or exported.default_beam
    candela = export_beam(exported, name, out, step_deg).candela
    angles = f"{candela.shape[0]} x {candela.shape[1]} angles"
    print(f"{out} written: {exported.name}, beam {name}, {angles}, peak {candela.max():,.0f} cd")


@headlight_app.command
def measure(
    lamp: str,
    /,
    *,
    at: Points = None,
    wall: float | None = None,
    road: Points = None,
    beam: str | None = None,
    side: Literal["both", "left", "right"] | None = None,
    traffic: Literal["left", "right"] = "right",
    extent: Points = None,
    step_deg: float | None = None,
    out: Path | None = None,
) -> None:
    """Measure a beam: cd and lx by direction, over a wall, or lx at places on a flat road.

    Parameters
    ----------
    lamp
        Preset, lamp file, description or photometric file, whose own table is measured.
    at
        Direction H,V in deg from the lamp, to the right and up, or a line H,V:H,V:COUNT: cd, and lx of an upright wall 25 m ahead.
    wall
        Distance in m of an upright wall, measured where the beam lights it.
    road
        Place X,Y or X,Y,Z in m, ahead of the lamps, to the left of their middle, and up from the road, or a line X,Y:X,Y:COUNT: lx of a
        horizontal surface, and of a vertical one that faces the car. The lamps are 1.2 m apart and 0.75 m high; nothing casts shadows.
    beam
        Name of the beam, full or off; by default low, or full where the lamp has no low beam.
    side
        Lamps that are on; by default left for directions and walls, which have one lamp, and both for the road.
    traffic
        Side of the road that the traffic drives on; for the left, default beams are fitted to it.
    extent
        Part of the wall to measure instead: largest angles H,V in deg to each side, up and down, or two corners H,V:H,V.
    step_deg
        Step of both angles over a wall in deg; by default 0.5.
    out
        File for all values (.csv); by default a table is printed.
    """
    from luxloop.loop.commands import headlight_tables
    from luxloop.loop.report import measure as measuring
    from luxloop.world.errors import LuxloopError
    from luxloop.world.lamps.description import for_traffic, load_lamp, measured_lamp

    if sum(bool(each) for each in (at, wall is not None, road)) != 1:
        raise LuxloopError("measure: give one of --at H,V, --wall METRES and --road X,Y; --at and --road may be repeated")
    if side == "both" and not road:
        raise LuxloopError("--side both: a direction or a wall is measured from one lamp; give left or right, or measure the --road")
    if wall is not None and not 0 < wall < math.inf:
        raise LuxloopError(f"--wall {wall:g}: give a distance greater than 0 m")
    if wall is not None and out is None:
        raise LuxloopError(f"--wall {wall:g}: has too many values for a table; give --out FILE.csv")
    for option, given in (("extent", extent), ("step-deg", step_deg)):
        if given is not None and wall is None:
            raise LuxloopError(f"--{option}: is for a --wall; leave it out, or give a line as H,V:H,V:COUNT")
    if out is not None and out.suffix.lower() != ".csv":
        raise LuxloopError(f"--out {out}: gives no format of values; end it in .csv")
    sides: Sequence[Literal["left", "right"]] = (
        ("left", "right") if side == "both" or (road and side is None) else ("right",) if side == "right" else ("left",)
    )
    photometric = Path(lamp).suffix.lower() in PHOTOMETRIC
    lamps: dict[str, Lamp] = {
        each: for_traffic(measured_lamp(Path(lamp), each) if photometric else load_lamp(lamp, each), traffic) for each in sides
    }
    first = lamps[sides[0]]
    name = beam or first.default_beam
    first.require_beam(name)
    if road:
        values = measuring.on_road(lamps, name, measuring.points(road, "XYZ", measuring.LIMITS_M, "--road"))
    elif at:
        values = measuring.towards(first, name, measuring.points(at, "HV", measuring.LIMITS_DEG, "--at"))
    else:
        directions = measuring.grid(first, name, measuring.STEP_DEG if step_deg is None else step_deg, extent)
        values = measuring.towards(first, name, directions, wall or measuring.SCREEN_M)
    title = f"{first.name}, beam {name}, {' and '.join(sides)} lamp{'s' * (len(sides) > 1)}"
    if out is None:
        tables.show(headlight_tables.measured(values, title))
    else:
        measuring.write_csv(out, values)
        print(f"{out} written: {title}, {tables.plural(len(next(iter(values.values()))), 'point')}")


@headlight_app.command
def rules() -> None:
    """Show the sets of test points that `check` knows, and the confidence in their numbers."""
    from luxloop.loop.commands import headlight_tables

    tables.show(headlight_tables.rules())


@headlight_app.command
def check(
    lamp: str,
    /,
    *,
    beam: str | None = None,
    rule: str | None = None,
    side: Literal["left", "right"] = "left",
    aim: bool = False,
    traffic: Literal["left", "right"] = "right",
) -> int:
    """Check a beam against the test points of UN R149, R112, R123 or FMVSS 108; exit code 1 if it fails.

    Parameters
    ----------
    lamp
        Preset, lamp file, description or photometric file, whose own table is checked; all others by their light textures.
    beam
        Name of the beam, full or off; by default low for a passing beam's rule, high for a driving beam's, or full where the lamp has none.
    rule
        Set of test points (see `luxloop headlight rules`); by default the R149 set for the beam's name.
    side
        Side of the car that the lamp is for.
    aim
        First aim the lamp by its cut-off or its maximum, as the regulation says.
    traffic
        Side of the road that the traffic drives on; for the left, the tables are mirrored and default beams are fitted to it.
    """
    from luxloop.loop.commands import headlight_tables
    from luxloop.world.lamps.description import for_traffic, load_lamp, measured_lamp
    from luxloop.world.regulation import passes

    photometric = Path(lamp).suffix.lower() in PHOTOMETRIC
    measured = for_traffic(measured_lamp(Path(lamp), side) if photometric else load_lamp(lamp, side), traffic)
    title, results = headlight_tables.check(measured, beam, rule, aim, traffic)
    tables.show(headlight_tables.results(results, title))
    return 0 if passes(results) else DIFFERS


def _print_compliance(lamp: "Lamp") -> None:
    from luxloop.loop.commands.headlight_tables import compliance

    if lines := compliance(lamp):
        print("\n".join(["", *lines, "`luxloop headlight check` has the details."]))


@contextmanager
def _pixels_done() -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar for each module; yields a function of the module's name, its pixels done and its number of pixels."""
    with ExitStack() as bars:
        advance: list[Callable[[], None]] = []

        def on_progress(name: str, done: int, of: int) -> None:
            if done == 1:
                bars.close()
                advance[:] = [bars.enter_context(tables.progress(f"{name}, pixels", of))]
            advance[0]()

        yield on_progress
