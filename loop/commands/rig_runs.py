"""`luxloop run --rig`: a real lamp and a real camera as the plant, or a real lamp that lights the simulated world."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from luxloop.loop.report import terminal as tables
from luxloop.world.errors import LuxloopError, locate, redact

if TYPE_CHECKING:
    from luxloop.loop.rig.arrays import Grids
    from luxloop.loop.rig.live.plant import LivePlant
    from luxloop.loop.rig.params import MarkParams
    from luxloop.loop.rig.rig import Rig
    from luxloop.loop.scenario.model import Scenario
    from luxloop.loop.simulation.simulated import SimulatedPlant

EVALUATOR = "the rig's own camera, by its view of the plane that it is calibrated to; the truth is not known, and its columns are empty"


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
    from luxloop.loop.recording.manifest import RIG, write_json
    from luxloop.loop.rig.params import load_rig
    from luxloop.loop.rig.plant import RigEvaluator, RigPlant
    from luxloop.loop.rig.rig import open_rig
    from luxloop.loop.simulation.build import from_zero

    file, armed, allow_code = rig_file
    params = load_rig(file, allow_code=allow_code)
    scenario, left_out = _without_truth(scenario)
    if left_out:
        tables.say(f"checks that need the truth are left out: {', '.join(left_out)}")
    with locate(str(file)), open_rig(params, pixel_grids(scenario), scenario.camera, armed=armed) as rig:
        await_rig(rig)
        rig.refuse_misfit()
        if not armed:
            tables.say("dry run: the lamp stays dark; give --arm to light it")

        evaluator: RigEvaluator | None = None
        simulated: SimulatedPlant | None = None

        def plant(simulation: Any) -> Any:
            from luxloop.loop.simulation.lamps import lamp_modules

            nonlocal evaluator, simulated
            modules, evaluator = lamp_modules(simulation.modules), RigEvaluator(simulation.controlled, scenario.camera, params.mark)
            if twin:
                from luxloop.loop.rig.calibration.twin import twin_plant

                simulated = twin_plant(scenario, modules)
            own = RigPlant.of(rig, modules, scenario.steps * len(scenario.shares))
            return from_zero(replace(own, look=evaluator.look), scenario, modules)

        try:
            passed = run_scenario(scenario, out, device, False, {**kept, "plant": plant, "frames": kept["frames"] or twin})
        finally:
            rig.keeper.dark("the run has ended")
            found = of_run(rig, len(scenario.shares)) | {"judged": {} if evaluator is None else evaluator.summary()}
            told = {"rig": redact(params.model_dump(mode="json")), "armed": armed, **found}
            if out.is_dir() and rig.statistics.exposures:
                write_json(out / RIG, told)
            tables.show(tables.facts(in_words(found) | {"evaluator": EVALUATOR}))
    if simulated is not None:
        compared = _twin(out, simulated, params.mark, scenario.steps * len(scenario.shares))
        write_json(out / RIG, told | {"twin": compared})
        tables.show(tables.facts(_twin_in_words(compared)))
    _require_frames(rig, file, out)
    return passed


def run_live(scenario: "Scenario", out: Path, rig_file: tuple[Path, bool, bool], device: str, kept: Mapping[str, Any]) -> bool:
    """Run a scenario in its simulated world with one module digitised from a real lamp; returns whether all evaluated checks passed.

    out: folder of the recording. rig_file: its path, whether the lamp is lit, and whether modules that it names may run. device: to compute
    on. kept: what is recorded, keyword arguments of `luxloop.loop.run.run`. Checks that compare with another light are left out. Raises
    LuxloopError if the rig cannot be opened or does not fit the scenario, and KeyboardInterrupt that says what was kept; the lamp is dark
    then. Raises LuxloopError after a run to which too few frames came.
    """
    from luxloop.loop.commands.runs import run_scenario
    from luxloop.loop.recording.manifest import BEAM, RIG, write_json
    from luxloop.loop.rig.arrays import grids_of
    from luxloop.loop.rig.calibration.calibrate import load
    from luxloop.loop.rig.calibration.pictures import draw_beam
    from luxloop.loop.rig.live.plant import live_plant, refuse_unfit
    from luxloop.loop.rig.params import load_rig
    from luxloop.loop.rig.rig import open_rig
    from luxloop.loop.scenario.plant import SimulatedPlantParams
    from luxloop.loop.simulation.build_lamps import mount
    from luxloop.loop.simulation.digitised import digitised_number

    file, armed, allow_code = rig_file
    params = load_rig(file, allow_code=allow_code)
    with locate(str(file)):
        calibration_file = refuse_unfit(params)
    calibration = load(calibration_file)
    checks = {name: each for name, each in scenario.checks.items() if each.compare is None}
    scenario = scenario.model_copy(update={"plant": SimulatedPlantParams(), "checks": checks})
    with locate(scenario.source):
        modules = mount(scenario.headlight)
        number = digitised_number(scenario, [each.name for each in modules])
    exposures = scenario.steps * len(scenario.shares)
    with locate(str(file)), open_rig(params, grids_of([modules[number]]), None, armed=armed) as rig, ExitStack() as stack:
        await_rig(rig)
        if not armed:
            tables.say("dry run: the lamp stays dark, and so does its module; give --arm to light it")
        live: LivePlant | None = None

        def plant(simulation: Any) -> Any:
            nonlocal live
            with locate(str(calibration_file)):
                live = stack.enter_context(live_plant(rig, simulation.plant, calibration, exposures))
            rig.statistics = type(rig.statistics)()
            return live

        try:
            passed = run_scenario(scenario, out, device, False, {**kept, "plant": plant})
        finally:
            rig.keeper.dark("the run has ended")
            if live is not None and rig.statistics.exposures and out.is_dir():
                found = of_run(rig, len(scenario.shares)) | {"judged": {}}
                beam = live.beam.summary() | {"module": modules[number].name, "seen": live.digitiser.coverage}
                write_json(out / RIG, {"rig": redact(params.model_dump(mode="json")), "armed": armed, **found, "live": beam})
                if live.beam.newest is not None:
                    texture, u = live.beam.newest
                    draw_beam(out / BEAM, texture, live.truth.modules[number].headlight, u)
                tables.show(tables.facts(in_words(found) | _beam_in_words(beam)))
    _require_frames(rig, file, out)
    return passed


def pixel_grids(scenario: "Scenario") -> "Grids":
    """Rows and columns of the pixels of the scenario's modules."""

    from luxloop.loop.rig.arrays import grids_of
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
        with tables.progress("twin", exposures) as advance:
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


def _require_frames(rig: "Rig", file: Path, out: Path) -> None:
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


def _beam_in_words(beam: Mapping[str, Any]) -> dict[str, str]:
    whole, part = beam["light_to_texture_ms"], beam["frame_to_texture_ms"]
    if whole["median"] is None:
        return {f"{beam['module']}, digitised": "no frame was taken"}
    times = f"{whole['median']:.0f} ms (median), {whole['p95']:.0f} ms (95 %), {whole['worst']:.0f} ms (worst)"
    rows = {
        "light to texture": f"{times}; {part['median']:.0f} ms of it to digitise",
        f"{beam['module']}, digitised": f"the camera sees {beam['seen']:.1%} of its texels",
    }
    if beam["saturated"]:
        rows["saturated"] = f"{beam['saturated']:.2%} of the camera's pixels in the worst frame: its light is too low there; expose shorter"
    return rows
