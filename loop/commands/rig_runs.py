"""Run on a rig, check it and measure its delay: `luxloop run --rig`, `luxloop rig check` and `luxloop rig blink`."""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from luxloop.loop.commands.given import scenario_of
from luxloop.loop.commands.options import AllowCode, Flag, Keys
from luxloop.loop.report import terminal as tables
from luxloop.loop.report.progress import progress
from luxloop.world.errors import LuxloopError, locate, redact
from luxloop.world.files import whole

if TYPE_CHECKING:
    from luxloop.loop.rig.blink import Blinked
    from luxloop.loop.rig.params import MarkParams
    from luxloop.loop.rig.rig import Rig
    from luxloop.loop.scenario.model import Scenario
    from luxloop.loop.simulation.simulated import SimulatedPlant

Named = Annotated[str, Parameter(name="--scenario")]
JUDGED = "the rig's own camera, by its view of the plane that it is calibrated to; the truth is not known, and its columns are empty"


def run_on_rig(
    scenario: "Scenario", out: Path, rig_file: tuple[Path, bool, bool], device: str, kept: Mapping[str, Any], twin: bool = False
) -> bool:
    """Run a scenario on a rig and record it; returns whether all evaluated checks passed.

    out: folder of the recording. rig_file: its path, whether the lamp is lit, and whether modules that it names may run. device: to compute
    on. kept: what is recorded, keyword arguments of `luxloop.loop.run.run`. twin: whether the exposures are also simulated and compared
    with the rig's frames, which are kept then. Checks that need the truth are left out. Raises LuxloopError if the rig cannot be opened,
    and KeyboardInterrupt that says what was kept; the lamp is dark then. Raises LuxloopError after a run to which too few frames came.
    """
    from luxloop.loop.commands.runs import run_scenario
    from luxloop.loop.recording.files import RIG
    from luxloop.loop.recording.manifest import write_json
    from luxloop.loop.rig.judged import Judged
    from luxloop.loop.rig.params import load_rig
    from luxloop.loop.rig.plant import RigPlant
    from luxloop.loop.rig.rig import opened
    from luxloop.loop.simulation.build_plant import from_zero

    file, armed, allow_code = rig_file
    params = load_rig(file, allow_code=allow_code)
    scenario, left_out = _without_truth(scenario)
    if left_out:
        tables.console().print(f"checks that need the truth are left out: {', '.join(left_out)}", markup=False)
    with locate(str(file)), opened(params, pixel_grids(scenario), scenario.camera, armed=armed) as rig:
        await_rig(rig)
        rig.refuse_misfit()
        if not armed:
            tables.console().print("dry run: the lamp stays dark; give --arm to light it", markup=False)

        judged: Judged | None = None
        simulated: SimulatedPlant | None = None

        def plant(simulation: Any) -> Any:
            from luxloop.loop.simulation.lamps import lamp_modules

            nonlocal judged, simulated
            modules, judged = lamp_modules(simulation.modules), Judged(simulation.controlled, scenario.camera, params.mark)
            if twin:
                from luxloop.loop.rig.calibration.twin import twin_plant

                simulated = twin_plant(scenario, modules)
            own = RigPlant.of(rig, modules, scenario.steps * len(scenario.shares))
            return from_zero(replace(own, look=judged.look), scenario, modules)

        try:
            passed = run_scenario(scenario, out, device, False, {**kept, "plant": plant, "frames": kept["frames"] or twin})
        finally:
            rig.dark("the run has ended")
            found = of_run(rig, len(scenario.shares)) | {"judged": {} if judged is None else judged.summary()}
            told = {"rig": redact(params.model_dump(mode="json")), "armed": armed, **found}
            if out.is_dir() and rig.statistics.exposures:
                write_json(out / RIG, told)
            tables.show(tables.facts(in_words(found) | {"judge": JUDGED}))
    if simulated is not None:
        compared = _twin(out, simulated, params.mark, scenario.steps * len(scenario.shares))
        write_json(out / RIG, told | {"twin": compared})
        tables.show(tables.facts(_twin_in_words(compared)))
    refuse_failed(rig, file, out)
    return passed


def check(file: Path, /, *, scenario: Named = "snowflake", set: Keys = None, allow_code: AllowCode = False) -> None:
    """Check a rig without lighting it: the rig file, the lamp's address, and three seconds of the camera's pictures.

    Parameters
    ----------
    file
        Rig file.
    scenario
        Scenario whose lamp and camera the rig must fit.
    set
        Keys of the scenario to change, as key=value in TOML syntax.
    """
    from luxloop.loop.rig.light import open_light
    from luxloop.loop.rig.look import look
    from luxloop.loop.rig.params import load_rig
    from luxloop.loop.rig.rig import opened

    params = load_rig(file, allow_code=allow_code)
    given = scenario_of(scenario, set, allow_code=allow_code)
    with locate(str(file)):
        grids = pixel_grids(given)
        light = open_light(params.light, grids)
        light.close()
        with opened(params, grids, given.camera, armed=False) as rig:
            await_rig(rig)
            found = look(rig)
    rows = {
        "light": f"{params.light.kind}, {sum(rows * columns for rows, columns in grids):,} pixels of {scenario}; not lit",
        "camera": f"{', '.join(f'{w} x {h} px' for w, h in found['sizes'])} at {found['rate_hz']:.1f} Hz, "
        f"{found['interval_worst_ms']:.0f} ms between two pictures at most, {found['late']:.0%} of them from a queue",
        "brightest": f"{found['brightest']:.0%} of the largest digital number",
        "timing": f"frames count from {1e3 * params.timing.clear_s:.0f} ms after the light on; measure it with luxloop rig blink",
        "limits": f"{params.limits.share:.0%} mean utilisation, {params.limits.change_per_s:g} change a second",
    }
    tables.show(tables.facts(rows))
    if found["refused"]:
        raise LuxloopError(f"{file}: {found['refused']}")


def blink(
    file: Path,
    /,
    *,
    arm: Flag = False,
    scenario: Named = "snowflake",
    set: Keys = None,
    blinks: int = 100,
    level: float = 1.0,
    write: Flag = False,
    allow_code: AllowCode = False,
) -> None:
    """Measure the delay from light to frame: all pixels go on and off at random times, for half a second each.

    Parameters
    ----------
    file
        Rig file.
    arm
        Light the lamp. Without it, no device is opened.
    scenario
        Scenario with the rig's lamp.
    set
        Keys of the scenario to change, as key=value in TOML syntax.
    blinks
        Number of changes of the light.
    level
        Utilisation of all pixels; the limits of the rig file may dim it.
    write
        Write the result as [timing] into the rig file.
    """
    from luxloop.loop.rig.blink import blink as measure
    from luxloop.loop.rig.params import load_rig
    from luxloop.loop.rig.rig import opened

    params = load_rig(file, allow_code=allow_code)
    if not 0 < level <= 1:
        raise LuxloopError(f"--level {level:g}: is no utilisation; give a number above 0, to 1")
    given = scenario_of(scenario, set, allow_code=allow_code)
    grids = pixel_grids(given)
    if not arm:
        print(f"{file}: all {sum(rows * columns for rows, columns in grids):,} pixels would blink {blinks} times; give --arm to light them")
        return
    with locate(str(file)), opened(params, grids, None, armed=True) as rig, progress("blink", blinks + 2) as advance:
        await_rig(rig)
        found = measure(rig, grids, blinks, level, advance)
    tables.show(tables.facts(_blinked(found)))
    if found.warning:
        tables.console().print(found.warning, markup=False)
    text = "[timing]\n" + "".join(f"{name} = {value:g}\n" for name, value in found.timing.items())
    if write:
        written(file, found.timing)
        print(f"{file}: [timing] written")
    else:
        print(f"\n{text}\nWith --write these go into {file}.")


def written(file: Path, timing: Mapping[str, float]) -> None:
    """Write values of `[timing]` into a rig file and change nothing else in it. Raises LuxloopError if it cannot be written."""
    text = file.read_text("utf-8")
    table = re.search(r"^\[timing\][^\n]*\n(?:(?!\[)[^\n]*\n?)*", text, re.M)
    old = table[0] if table else "\n[timing]\n"
    new = old if old.endswith("\n") else f"{old}\n"
    for name, value in reversed(list(timing.items())):
        line, pattern = f"{name} = {value:g}", rf"^{name}\s*=[^\n]*"
        if re.search(pattern, new, re.M):
            new = re.sub(pattern, line, new, flags=re.M)
        else:
            new = re.sub(r"(\[timing\][^\n]*\n)", rf"\1{line}\n", new)
    made = text.replace(old, new) if table else f"{text.rstrip()}\n{new}"
    try:
        understood = tomllib.loads(made)["timing"].items() >= {name: float(f"{value:g}") for name, value in timing.items()}.items()
    except tomllib.TOMLDecodeError:
        understood = False
    if not understood:  # [timing] is there in another notation
        raise LuxloopError(f"{file}: timing: is not written as a table [timing] of its own, with a line for each key; rewrite it so")
    with whole(file) as part:
        part.write_text(made, "utf-8")


def pixel_grids(scenario: "Scenario") -> tuple[tuple[int, int], ...]:
    """Rows and columns of the pixels of the scenario's modules."""

    from luxloop.loop.rig.plant import grids_of
    from luxloop.loop.simulation.build_lamps import mount

    with locate(scenario.source):
        return grids_of(mount(scenario.headlight))


def await_rig(rig: "Rig") -> None:
    """Wait for the page of a screen and for the camera. Raises LuxloopError if no page connects or no picture comes."""
    from luxloop.loop.rig.rig import await_camera
    from luxloop.loop.rig.screen import ScreenLight

    if isinstance(rig.light, ScreenLight):
        rig.light.await_page(lambda address: print(f"Open {address} on the projector, in full screen.", flush=True))
    if not await_camera(rig):
        raise LuxloopError(rig.camera.reason)


def _without_truth(scenario: "Scenario") -> tuple["Scenario", list[str]]:
    """The scenario without checks that a rig cannot evaluate, and their names."""
    from luxloop.loop.simulation.columns import of_truth

    left_out = [name for name, each in scenario.checks.items() if of_truth(each.metric) or each.compare is not None]
    kept = {name: each for name, each in scenario.checks.items() if name not in left_out}
    return scenario.model_copy(update={"checks": kept}), left_out


def _twin(out: Path, simulated: "SimulatedPlant", mark: "MarkParams | None", exposures: int) -> dict[str, Any]:
    """Simulate the exposures of the rig. exposures: their largest number. Raises KeyboardInterrupt that says what was kept."""
    from luxloop.loop.rig.calibration.twin import write_twin

    try:
        with progress("twin", exposures) as advance:
            return write_twin(out, simulated, mark, advance)
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(f"the run is kept in {out}, without its twin") from error


def _twin_in_words(found: Mapping[str, Any]) -> dict[str, str]:
    return {
        f"twin, {name} frames": f"mean digital number {each['mean_rig']:.1f} on the rig, {each['mean_simulated']:.1f} simulated; "
        f"MAE {each['mae']:.1f}, RMSE {each['rmse']:.1f}, SSIM {each['ssim']:.3f}"
        for name in ("on", "off")
        if (each := found.get(name)) is not None
    } or {"twin": "no frame came"}


def refuse_failed(rig: "Rig", file: Path, out: Path) -> None:
    """Raises LuxloopError after a run on a rig that sent too few frames. file: of the rig. out: folder of the recording."""
    if failure := rig.statistics.failure:
        raise LuxloopError(f"{file}: {failure}; the recording is kept in {out}")


def of_run(rig: "Rig", per_step: int) -> dict[str, Any]:
    """Statistics of a run on a rig, as plain data. per_step: exposures per control step."""
    told = rig.keeper
    watched = {"darkened": told.darkened, "interruptions": told.interruptions}
    camera = {"pictures": rig.camera.count, "dropped": rig.camera.dropped, "connections": rig.camera.connections}
    return {**rig.statistics.summary(per_step), "per_step": per_step, "watchdog": watched, "camera": camera}


def in_words(found: Mapping[str, Any]) -> dict[str, str]:
    """The result of `of_run`, and `judged`, as rows of a table."""
    lost, late = sum(found["lost"].values()), found["light_to_frame_ms"]
    rows = {
        "control rate": f"{tables.number(found['control_rate_hz'], '.2f')} Hz",
        "light to frame": "no frame was taken"
        if late["median"] is None
        else f"{late['median']:.0f} ms (median), {late['p95']:.0f} ms (95 %), {late['worst']:.0f} ms (worst)",
        "frames": f"{found['exposures'] - lost} of {found['exposures']} exposures"
        + "".join(f"\n{count} lost: {reason}" for reason, count in sorted(found["lost"].items(), key=lambda each: -each[1])[:5]),
        "pictures": ", ".join(f"{count} {what}" for what, count in sorted(found["pictures"].items())) or "none",
    }
    for name, each in found["judged"].items():
        off = each["centroid_error_percent"]
        step = each["exposure"] // found["per_step"]
        told = f"IoU {each['iou_final']:.3f} at step {step}, {each['iou_mean']:.3f} on average in the last {each['pairs']}"
        where = "nothing is lit" if off is None else f"centroid {off[0]:.1f} % along, {off[1]:.1f} % across"
        rows[f"{name}, as the camera sees it"] = f"{told}; {where}"
    if found["dimmed"] or found["slowed"]:
        rows["limits"] = f"dimmed {found['dimmed']} exposures, slowed {found['slowed']}"
    if any(found["watchdog"].values()):
        rows["watchdog"] = f"darkened the lamp {found['watchdog']['darkened']} times, {found['watchdog']['interruptions']} interruptions"
    return rows


def _blinked(found: "Blinked") -> dict[str, str]:
    (interval, longest), (median, most, worst) = found.interval_s, (1e3 * each for each in found.first_s)
    return {
        "light to frame": f"{median:.0f} ms (median), {most:.0f} ms (95 %), {worst:.0f} ms (worst), in {found.blinks} blinks",
        "latency": f"{1e3 * found.latency_s:.1f} ms to a frame that begins with the light",
        "jitter": f"{1e3 * found.jitter_s:.1f} ms, the worst that was measured with a quarter and 8 ms on it",
        "exposure and readout": f"{1e3 * found.rolling_s:.1f} ms",
        "drift": "{:+.1f} ± {:.1f} ms a minute".format(*(1e3 * each for each in found.drift_s_per_min)),
        "pictures": f"every {1e3 * interval:.1f} ms (median), {1e3 * longest:.0f} ms (worst), {found.queued:.0%} queued",
    }
