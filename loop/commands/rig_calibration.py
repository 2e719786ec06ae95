"""The commands `luxloop rig board|calibrate|digitise|fit`: calibrate a rig's camera and geometry, digitise its lamp, fit a scenario."""

import math
import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from luxloop.loop.commands.options import AllowCode, Count, Flag, Keys, Share, scenario_of, within
from luxloop.loop.commands.rig_runs import await_rig
from luxloop.loop.report import terminal as tables
from luxloop.world.errors import LuxloopError

if TYPE_CHECKING:
    from luxloop.loop.rig.arrays import Array
    from luxloop.loop.rig.calibration.digitise import Reading
    from luxloop.loop.rig.calibration.intrinsics import Corners
    from luxloop.loop.rig.calibration.setups import Setup
    from luxloop.loop.rig.calibration.shots import Shots
    from luxloop.loop.scenario.model import Scenario
    from luxloop.loop.simulation.truth import LampModule

NOISY = 1.2  # times the camera's noise that a fit of all that matters leaves at most
ROUNDING = 0.3  # rms of rounding to digital numbers
PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def board(
    *, out: Path = Path("board.pdf"), columns: int = 8, rows: int = 11, square_mm: float = 23.0, paper: Literal["a4", "a3", "letter"] = "a4"
) -> None:
    """Write a ChArUco board to print at 100 %.

    Parameters
    ----------
    out
        File to write, .pdf or .png.
    columns
        Squares in a row.
    rows
        Squares in a column.
    square_mm
        Side of a square.
    paper
        Size of the page.
    """
    from luxloop.loop.rig.calibration.intrinsics import print_board

    print_board(out, _board(columns, rows, square_mm), paper)
    print(f"{out} written: {columns} x {rows} squares of {square_mm:g} mm; print it at 100 %, and measure a square")


def calibrate(
    name: str,
    /,
    *,
    out: Path = Path("rig.npz"),
    boards: Path | None = None,
    on_screen: Path | None = None,
    screen_m: Annotated[float, within(gt=0, lt=math.inf)] | None = None,
    flats: Path | None = None,
    lux: list[str] | None = None,
    columns: int = 8,
    rows: int = 11,
    square_mm: float = 23.0,
    frames: Path | None = None,
    rig: Path | None = None,
    arm: Flag = False,
    set: Keys = None,
    allow_code: AllowCode = False,
) -> None:
    """Calibrate a rig: response and lens of its camera, and the relative poses of camera, screen and lamp.

    Parameters
    ----------
    name
        Scenario with the rig's lamp and camera at their approximate poses.
    out
        File to write, .npz.
    boards
        Folder of pictures of a board (see `luxloop rig board`) in at least five poses; without it, the scenario's pinhole camera is used.
    on_screen
        Picture of the board flat on the screen, for the pose of the screen.
    screen_m
        In place of --on-screen: distance in m from the lamps to a screen perpendicular to the vehicle's x axis.
    flats
        Folder of pictures of an evenly bright surface, such as a diffuser in front of the lens, for the vignetting.
    lux
        Readings of a luxmeter on the screen with all pixels on, each as LUX@U,V with the position of its sensor in the camera's picture
        in px. They give the absolute scale, which a beam that is digitised live needs.
    columns
        Squares in a row of the board.
    rows
        Squares in a column of the board.
    square_mm
        Side of a square of the board as printed.
    frames
        Folder for the frames, from which an interrupted calibration resumes; by default named after `out`.
    rig
        Rig file (see docs/rig.md); without it, the scenario's simulated world is used.
    arm
        With --rig: light the lamp.
    set
        Keys of the scenario to change, as key=value in TOML syntax.
    """
    import numpy as np

    from luxloop.loop.rig.calibration import calibrate as steps
    from luxloop.loop.rig.calibration.geometry import DISTORTION
    from luxloop.loop.rig.calibration.intrinsics import lens, vignetting
    from luxloop.loop.rig.calibration.shots import linear_response

    steps.refuse_name(out)
    readings = [_reading(each) for each in lux or ()]
    _require_arm(rig, arm)
    printed = _board(columns, rows, square_mm)
    scenario = scenario_of(name, set, allow_code=allow_code)
    views, size = _views(boards, printed) if boards is not None else ([], (0, 0))
    found_lens = lens(views, *size) if boards is not None else None
    if on_screen is None and screen_m is None:
        raise LuxloopError(
            "nothing tells where the screen is; give a picture of the board on it with --on-screen, or its distance with --screen-m"
        )
    screen: Any = screen_m if on_screen is None else _views(on_screen, printed)[0][0]
    with _setup(scenario, rig, allow_code) as (setup, modules):
        kept = frames or out.with_name(f"{out.stem}_frames")
        shots = _shots(setup, linear_response(setup.levels), kept, scenario)
        response = steps.measure_response(shots, [each.headlight.n_pixels for each in modules])
        even = [] if flats is None else [response[each.clip(0, setup.levels)] for each in _pictures(flats).values()]
        darkening, left = vignetting(even) if even else (np.zeros(3), 0.0)
        shots = _shots(setup, response, kept, scenario)
        found, geometries, located = steps.calibrate_poses(shots, modules, scenario.camera, darkening, found_lens, screen)
        scale = steps.lux_scale(shots, [each.headlight.n_pixels for each in modules], readings, darkening) if readings else None
    steps.save(out, replace(found, lux=scale))
    camera = found.camera
    stds = [""] * 9 if camera.covariance is None else [f" ± {by:.2g}" for by in np.sqrt(np.diag(camera.covariance))]
    values = zip(("fx", "fy", "cx", "cy", *DISTORTION), camera.values, stds, strict=True)
    figures = {
        "lens": ", ".join(f"{what} {value:.5g}{std}" for what, value, std in values)
        + ("; assumed, not measured" if camera.covariance is None else ""),
        "scale": "not measured" if scale is None else f"{scale:.4g} lx on the screen saturate the camera",
        "vignetting": "not measured" if flats is None else f"{100 * darkening.sum():.1f} % in the corners, {100 * left:.2g} % rms left",
        **{f"residual, {what}": f"{value:.3f} px rms" for what, value in found.rms.items()},
        **{f"located, {what}": f"{100 * share:.1f} % of the pixels" for what, share in located.items()},
    }
    for what, geometry in geometries.items():
        place, by = geometry.lamp.place, geometry.std["lamp"][3:]
        figures[f"place, {what}"] = ", ".join(f"{a:.4f} ± {b:.1g}" for a, b in zip(place, by, strict=True)) + " m from the camera"
    tables.show(tables.facts(figures))
    keys = steps.overrides(found, modules[0])
    print(f"--set {' '.join(f'{key}={value:g}' for key, value in keys.items())}")
    print(f"{out} written; digitise the lamp with: luxloop rig digitise {shlex.join([name, '--calibration', str(out)])}")


def digitise(
    name: str,
    /,
    *,
    calibration: Path,
    out: Path = Path("digitised.npz"),
    lux: list[str] | None = None,
    reflectance: Share = 0.8,
    by_angle: Path | None = None,
    comb_frames: Count = 4,
    texels: Annotated[tuple[int, int], within(gte=1, lte=8)] = (4, 2),
    frames: Path | None = None,
    rig: Path | None = None,
    arm: Flag = False,
    set: Keys = None,
    allow_code: AllowCode = False,
) -> None:
    """Measure the light of each pixel of a lamp on a screen, and write it as a lamp file.

    Parameters
    ----------
    name
        Scenario with the rig's lamp.
    calibration
        File written by `luxloop rig calibrate`.
    out
        Lamp file to write, .npz; a report is written beside it.
    lux
        Readings of a luxmeter on the screen with all pixels on, each as LUX@U,V with the position of its sensor in the camera's picture
        in px. One gives the scale; four or more also correct errors of the assumed screen.
    reflectance
        Reflectance of the screen; without effect if there is a luxmeter reading.
    by_angle
        CSV of two columns: angle of view from the screen's normal in deg, and luminance factor there; by default the screen is Lambertian.
    comb_frames
        Frames to average for each pattern of separate pixels.
    texels
        Rows and columns of texels per pixel.
    frames
        Folder for the frames, from which an interrupted measurement resumes; by default named after `out`.
    rig
        Rig file (see docs/rig.md); without it, the scenario's simulated world is used.
    arm
        With --rig: light the lamp.
    set
        Keys of the scenario to change, as key=value in TOML syntax.
    """
    from luxloop.loop.rig.calibration import digitise as steps
    from luxloop.loop.rig.calibration import pictures as report
    from luxloop.loop.rig.calibration.calibrate import load, refuse_name
    from luxloop.loop.rig.calibration.digitise import lamp_of, refuse_both_sides
    from luxloop.loop.rig.calibration.geometry import candela_factor
    from luxloop.loop.rig.calibration.intrinsics import brightness
    from luxloop.world.lamps import archive

    readings = [_reading(each) for each in lux or ()]
    refuse_name(out)
    _require_arm(rig, arm)
    scenario = scenario_of(name, set, allow_code=allow_code)
    refuse_both_sides(scenario)
    known = load(calibration)
    with _setup(scenario, rig, allow_code) as (setup, modules):
        if setup.shape != (known.camera.height, known.camera.width):
            height, width = setup.shape
            raise LuxloopError(
                f"{calibration}: is of {known.camera.width} x {known.camera.height} px, but the camera has {width} x {height} px"
            )
        factor = _factor(reflectance, by_angle)
        shade = brightness(known.vignetting, *setup.shape)
        shots = _shots(setup, known.response, frames or out.with_name(f"{out.stem}_frames"), scenario)
        nominal = [steps.Nominal.of(k, each.name, each.headlight) for k, each in enumerate(modules)]
        sizes = [each.headlight.n_pixels for each in modules]
        found = [
            steps.digitise_module(
                shots,
                each,
                sizes,
                known.geometry(each.name),
                lambda at: candela_factor(at, setup.shape, factor) / shade,
                comb_frames,
                texels,
            )
            for each in nominal
        ]
    scatter = None
    if readings:
        scaled, scatter = steps.scale_to_lux(found, readings)
        found = list(scaled)
    notes = f"Digitised on a rig with {calibration.name}, {tables.plural(len(readings), 'luxmeter reading')}."
    archive.save(out, lamp_of(scenario, [each.light for each in found], out.stem, notes))
    written = report.write(out.with_suffix(""), found)
    for module in found:
        figures = report.facts(module)
        tables.show(
            tables.facts(
                {
                    module.name: f"{figures['pixels']:,} pixels, {figures['dead_count']} dead, {figures['stuck_count']} stuck",
                    "intensity": f"{100 * figures['intensity_noise']:.2g} % noise of a pixel, "
                    f"{100 * figures['residual_rms']:.2g} % residual rms",
                    "place": f"{figures['place_rms_px']:.3f} px rms from the data sheet's, "
                    f"shifts {figures['shift_rms_pixels']:.3f} pixels rms",
                    "not fitted": ", ".join(f"{what} {100 * value:.2g} %" for what, value in figures["checked"].items()),
                }
            )
        )
    if scatter is None:
        print("no --lux: intensities are in the camera's own unit; give a reading for candela")
    elif len(readings) > 1:
        print(f"the luxmeter's readings differ by {100 * scatter:.2g} % from the digitised light")
    print(
        f"{out} written, with {', '.join(each.name for each in written)}; look at it with: luxloop headlight show {shlex.quote(str(out))}"
    )


def fit(
    name: str,
    recording: Path,
    /,
    *,
    vary: list[str],
    exposures: Count = 6,
    set: Keys = None,
    allow_code: AllowCode = False,
) -> None:
    """Fit values of a scenario to the frames of a recording, and print them with their uncertainties.

    Parameters
    ----------
    name
        Scenario that was recorded.
    recording
        Folder of `luxloop run --frames`.
    vary
        Keys to fit, each as KEY=SPAN with its expected error, such as camera.pitch_deg=0.2; blur_px is the picture's blur.
    exposures
        Number of exposures to compare, spread evenly over the recording.
    set
        Keys of the scenario to change first, as key=value in TOML syntax.
    """
    from luxloop.loop.rig.calibration.twin import fit as fitted
    from luxloop.loop.rig.calibration.twin import read_exposures

    spans = dict(_span(each) for each in vary)
    keys = list(set or ())

    def scenario_with(values: Any) -> "Scenario":
        return scenario_of(name, [*keys, *(f"{key}={value!r}" for key, value in values.items())], allow_code=allow_code)

    shown = read_exposures(recording, scenario_with({}), exposures)
    with tables.progress("pictures", 1) as advance:
        found = fitted(scenario_with, shown, spans, lambda: advance(0))
    rows = ((key, f"{value:.6g}", f"{found.stds[key]:.2g}") for key, value in found.values.items())
    tables.show(tables.plain(("key", "value", "standard deviation"), rows, "lrr"))
    scores = ((what, f"{found.before[what]:.4g}", f"{found.after[what]:.4g}") for what in found.before)
    tables.show(tables.plain(("of frames", "before", "after"), scores, "lrr"))
    if (ratio := found.after["rmse"] / max(found.noise, ROUNDING)) > NOISY:
        print(
            f"the frames differ from the fit by {ratio:.2g} times the camera's noise: they depend on more than these keys, "
            "and the values may be wrong by more than their standard deviations"
        )
    print(f"--set {' '.join(f'{key}={value:.6g}' for key, value in found.values.items() if key != 'blur_px')}")


@contextmanager
def _setup(scenario: "Scenario", rig: Path | None, allow_code: bool) -> Iterator[tuple["Setup", tuple["LampModule", ...]]]:
    """The lit rig, or without a rig file the scenario's simulated world, and the modules that shine."""
    from luxloop.loop.rig.calibration.setups import simulated_setup
    from luxloop.loop.simulation.lamps import lamp_modules, mount

    modules = lamp_modules(mount(scenario.headlight))
    if rig is None:
        yield simulated_setup(scenario, modules), modules
        return
    from luxloop.loop.rig.arrays import grids_of
    from luxloop.loop.rig.calibration.setups import rig_setup
    from luxloop.loop.rig.params import load_rig

    with rig_setup(rig, load_rig(rig, allow_code=allow_code), grids_of(modules), await_rig) as setup:
        yield setup, modules


def _require_arm(rig: Path | None, arm: bool) -> None:
    if rig is not None and not arm:
        raise LuxloopError(f"--rig {rig}: its lamp would be lit, with all pixels at times; give --arm as well")
    if arm and rig is None:
        raise LuxloopError("--arm lights the lamp of a rig file; give --rig FILE as well")


def _shots(setup: "Setup", response: "Array", folder: Path, scenario: "Scenario") -> "Shots":
    from luxloop.loop.rig.calibration import structured_light as codes
    from luxloop.loop.rig.calibration.shapes import SPACING
    from luxloop.loop.rig.calibration.shots import Shots, plan_digest

    plan = codes.PERIOD, codes.STEPS, SPACING
    return Shots(setup, response, folder, plan_digest(scenario.headlight.model_dump(mode="json"), setup.shape, plan))


def _board(columns: int, rows: int, square_mm: float) -> Any:
    from luxloop.loop.rig.calibration.intrinsics import BoardParams
    from luxloop.world.validation import validate_model

    return validate_model(BoardParams, {"columns": columns, "rows": rows, "square_mm": square_mm}, "see `luxloop rig board --help`")


def _pictures(path: Path) -> dict[Path, Any]:
    """Grey pictures `[height, width]` of a folder or a file. Raises LuxloopError without a picture, and for pictures of different sizes."""
    import cv2

    from luxloop.world.files import content, files_at, reading
    from luxloop.world.images import decode

    found = {}
    for file in files_at(path):
        if file.suffix.lower() in PICTURES:
            with reading(file, "no picture", "take it out of the folder"):
                picture = decode(content(file), str(file), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
                if picture is None:
                    raise ValueError("damaged")
                found[file] = picture
    if not found:
        raise LuxloopError(f"{path}: holds no pictures ({', '.join(PICTURES)}); check the path")
    if len({each.shape for each in found.values()}) > 1:
        raise LuxloopError(f"{path}: its pictures differ in size; take all with the same camera")
    return found


def _views(path: Path, printed: Any) -> tuple[list["Corners"], tuple[int, int]]:
    """Corners of the board in each picture, and the pictures' width and height; prints which pictures show no board. Raises LuxloopError if
    none does.
    """
    from luxloop.loop.rig.calibration.intrinsics import Corners, corners

    pictures = _pictures(path)
    found = {file: corners(each, printed, str(file)) for file, each in pictures.items()}
    why = [f"{file}: {each}" for file, each in found.items() if isinstance(each, str)]
    if len(why) == len(found):
        raise LuxloopError(f"{path}: no picture shows the board", *why) if len(why) > 1 else LuxloopError(*why)
    for each in why:
        tables.say(f"left out: {each}")
    height, width = next(iter(pictures.values())).shape
    return [each for each in found.values() if isinstance(each, Corners)], (width, height)


def _reading(text: str) -> "Reading":
    try:
        value, at = text.split("@")
        u, v = at.split(",")
        found = float(value), float(u), float(v)
    except ValueError as error:
        raise LuxloopError(f"--lux {text}: is not of the form LUX@U,V, such as 820@640,360") from error
    if not (found[0] > 0 and all(map(math.isfinite, found))):
        raise LuxloopError(f"--lux {text}: is no light; give a finite reading above 0, and finite places")
    return found


def _span(text: str) -> tuple[str, float]:
    key, _, span = text.partition("=")
    try:
        value = float(span)
    except ValueError as error:
        raise LuxloopError(f"--vary {text}: is not of the form KEY=SPAN, such as camera.pitch_deg=0.2") from error
    if not value > 0:
        raise LuxloopError(f"--vary {text}: a span is above 0")
    return key.strip(), value


def _factor(reflectance: float, by_angle: Path | None) -> Any:
    """Luminance factor of the screen by the cosine of the angle of view."""
    import numpy as np

    from luxloop.world.files import content, reading

    if by_angle is None:
        return lambda cos: np.full_like(cos, reflectance)
    with reading(by_angle, "no table of angle and luminance factor", "write a line `angle_deg,factor` for each angle, ascending from 0"):
        lines = content(by_angle).decode("utf-8").splitlines()
        table = np.array([line.split(",") for line in lines if re.match(r"\s*[\d.]", line)], float)
        if table.shape[1] != 2 or not (np.diff(table[:, 0]) > 0).all() or not (table[:, 1] > 0).all():
            raise ValueError("angles ascend, factors are above 0")
    return lambda cos: np.interp(np.degrees(np.arccos(cos.clip(0, 1))), table[:, 0], table[:, 1])
