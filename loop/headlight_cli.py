"""The commands `luxloop headlight ...`: facts and pictures of lamps and photometric files, lamp files built, exported and checked."""

from pathlib import Path
from typing import Literal

from cyclopts import App

from loop import tables

headlight_app = App(name="headlight", help="Lamps and photometric files: facts, pictures, lamp files, and the regulations' test points.")
PHOTOMETRIC = (".ies", ".ldt")
DIFFERS = 1


@headlight_app.command(name="list")
def list_() -> None:
    """Show the lamps that come with luxloop."""
    from loop.headlight_tables import presets

    tables.show(presets())


@headlight_app.command
def info(lamp: str, /) -> None:
    """Show the facts of a lamp or of a photometric file.

    Parameters
    ----------
    lamp
        Name of a preset (see `luxloop headlight list`), a lamp file (.npz), a description (.toml) or a photometric file (.ies, .ldt).
    """
    from loop import headlight_tables

    if Path(lamp).suffix.lower() in PHOTOMETRIC:
        from world.photometry import read

        tables.show(headlight_tables.photometry(read(Path(lamp))))
        return
    from loop.lamp_description import load_lamp

    described = load_lamp(lamp)
    print(f"{described.name}\n{described.notes}\n" if described.notes else described.name)
    tables.show(headlight_tables.modules(described))
    print()
    tables.show(headlight_tables.beams(described))


@headlight_app.command
def show(
    lamp: str,
    /,
    *,
    beam: str | None = None,
    view: str | None = None,
    style: str | None = None,
    side: Literal["both", "left", "right"] | None = None,
    scenario: str | None = None,
    visibility_m: float | None = None,
    out: Path | None = None,
) -> None:
    """Draw a lamp's light, or a photometric file.

    Parameters
    ----------
    lamp
        Preset, lamp file (.npz), description (.toml) or photometric file (.ies, .ldt), which without --view is drawn as it was measured.
    beam
        Name of the beam, full or off; by default low, or full where the lamp has no low beam.
    view
        overview (the default), wall, birdseye, driver, volume, pixels or texture.
    style
        luminance, falsecolour, isolux or isocandela, as far as the view has it.
    side
        Lamps that shine, both by default.
    scenario
        Scenario whose road, objects and light are shown; by default a flat road by night.
    visibility_m
        Visibility in the fog of the view volume, 100 m by default.
    out
        Picture to write (.png, .jpg, .pdf or .svg); by default the lamp's name, beam and view.
    """
    from loop import headlight_pictures
    from loop.lamp_description import load_lamp
    from loop.scenario import load
    from world.errors import LuxloopError

    stem = Path(lamp).stem
    chosen = {"beam": beam, "style": style, "side": side, "scenario": scenario, "visibility-m": visibility_m}
    if Path(lamp).suffix.lower() in PHOTOMETRIC and view is None:
        from loop.photometry_picture import show_distribution
        from world.photometry import read

        for name, value in chosen.items():
            if value is not None:
                raise LuxloopError(f"--{name}: a photometric file is drawn as it was measured; for a picture as a lamp give --view, too")
        written = show_distribution(read(Path(lamp)), out or Path(f"{stem}.png"))
    else:
        lamps = {each: load_lamp(lamp, each) for each in (("left", "right") if side in (None, "both") else (side,))}
        target = out or Path("-".join([stem, *([beam] if beam else []), *([style] if style else []), view or "overview"]) + ".png")
        written = headlight_pictures.show(
            lamps,
            target,
            beam=beam,
            view=view or "overview",
            style=style,
            scenario=None if scenario is None else load(scenario),
            visibility_m=visibility_m,
        )
    print(f"{written} written")


@headlight_app.command
def build(description: Path, /, *, out: Path | None = None) -> None:
    """Build a lamp file from a description in TOML, and report what the light textures keep of the source.

    Parameters
    ----------
    description
        TOML file with a [[module]] table for each module.
    out
        Lamp file to write; by default the description's name with .npz.
    """
    from loop import headlight_tables
    from loop.lamp_description import build as build_lamp
    from world.lampfile import save

    lamp, report = build_lamp(description)
    target = out or description.with_suffix(".npz")
    save(target, lamp)
    tables.show(headlight_tables.built(report))
    print(f"{target} written, {target.stat().st_size / 1e6:.1f} MB; look at it with: luxloop headlight show {target}")


@headlight_app.command
def export(lamp: str, /, *, out: Path, beam: str = "full", side: Literal["left", "right"] = "left", step_deg: float = 0.1) -> None:
    """Write a beam as an IES file (LM-63-2019, type A) that other programs read.

    Parameters
    ----------
    lamp
        Preset, lamp file or description.
    out
        File to write, such as low.ies.
    beam
        Name of the beam, full or off.
    side
        Lamp of which side of the car.
    step_deg
        Step of both angles.
    """
    from loop.headlight_export import export as export_beam
    from loop.lamp_description import load_lamp

    written = export_beam(load_lamp(lamp, side), beam, out, step_deg)
    print(f"{out} written: {written.candela.shape[0]} x {written.candela.shape[1]} angles, peak {written.candela.max():,.0f} cd")


@headlight_app.command
def rules() -> None:
    """Show the sets of test points that `check` knows, and how sure their numbers are."""
    from loop import headlight_tables

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
    traffic: Literal["right", "left"] = "right",
) -> int:
    """Hold a beam against the test points of UN R149, R112, R123 or FMVSS 108; exit code 1 where it fails.

    Parameters
    ----------
    lamp
        Preset, lamp file, description or photometric file.
    beam
        Name of the beam, full or off; by default low, or full where the lamp has no low beam.
    rule
        Set of test points (see `luxloop headlight rules`); by default the one of R149 that the beam's name calls for.
    side
        Lamp of which side of the car.
    aim
        Aim the lamp by its cut-off or its maximum first, as the regulation says.
    traffic
        Side of the road that the traffic drives on; the tables are mirrored for the left.
    """
    from loop import headlight_tables
    from loop.headlight_check import judge
    from loop.lamp_description import load_lamp
    from world.regulation import passes

    judged = load_lamp(lamp, side)
    title, results = judge(judged, beam or ("low" if "low" in judged.beams else "full"), rule, aim, traffic)
    tables.show(headlight_tables.results(results, title))
    return 0 if passes(results) else DIFFERS
