"""`luxloop run --rig`: a real lamp and a real camera as the plant, or a real lamp that lights the simulated world."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from luxloop.loop.report import terminal as tables
from luxloop.world.errors import LuxloopError, locate, redact

if TYPE_CHECKING:
    from luxloop.loop.rig.arrays import Grids
    from luxloop.loop.rig.live.plant import LivePlant
    from luxloop.loop.rig.params import MarkParams, RigParams
    from luxloop.loop.rig.rig import Rig
    from luxloop.loop.scenario.model import Scenario
    from luxloop.loop.simulation.simulated import SimulatedPlant
    from luxloop.perception.camera import CameraParams

EVALUATOR = "the rig's own camera, by its view of the plane that it is calibrated to; the truth is not known, and its columns are empty"


def run_on_rig(
    scenario: "Scenario", out: Path, rig_file: tuple[Path, bool, bool], device: str, kept: Mapping[str, Any], twin: bool = False
) -> bool:
    """Run a scenario on a rig and record the run; returns whether all evaluated checks passed.

    out: folder of the recording. rig_file: path, whether the lamp is lit, and whether modules that the file names may run. device: torch
    device. kept: what is recorded, keyword arguments of `luxloop.loop.run.run`. twin: whether frames are recorded, and the exposures
    simulated and compared with them. Checks that need the truth are left out. The lamp is dark after the run. Raises LuxloopError if the
    rig cannot be opened or sends too few frames, and KeyboardInterrupt that says which steps are kept.
    """
    from luxloop.loop.commands.runs import run_scenario
    from luxloop.loop.rig.plant import RigEvaluator, RigPlant
    from luxloop.loop.simulation.build import from_zero
    from luxloop.loop.simulation.columns import of_truth
    from luxloop.loop.simulation.lamps import lamp_modules

    file, armed, allow_code = rig_file
    if scenario.headlight.rate_hz is not None:
        raise LuxloopError("headlight.rate_hz: a rig takes a frame of each exposure; leave it out")
    params = read_rig(file, allow_code)
    without = [name for name, each in scenario.checks.items() if of_truth(each.metric) or each.compare is not None]
    checks = {name: each for name, each in scenario.checks.items() if name not in without}
    scenario = scenario.model_copy(update={"checks": checks})
    if without:
        tables.say(f"checks that need the truth are left out: {', '.join(without)}")
    with connect(params, file, pixel_grids(scenario), scenario.camera, armed) as rig:
        rig.refuse_misfit()
        if not armed:
            tables.say("dry run: the lamp stays dark; give --arm to light it")

        evaluator: RigEvaluator | None = None
        simulated: SimulatedPlant | None = None

        def plant(simulation: Any) -> Any:
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
            figures = run_statistics(rig, len(scenario.shares)) | {"judged": {} if evaluator is None else evaluator.summary()}
            if out.is_dir():
                _write(out, rig, figures)
            tables.show(tables.facts(describe_run(figures) | {"evaluator": EVALUATOR}))
    if simulated is not None:
        compared = _twin(out, simulated, params.mark, scenario.steps * len(scenario.shares))
        _write(out, rig, figures | {"twin": compared})
        tables.show(tables.facts(_describe_twin(compared)))
    _require_frames(rig, file, out)
    return passed


def run_live(scenario: "Scenario", out: Path, rig_file: tuple[Path, bool, bool], device: str, kept: Mapping[str, Any]) -> bool:
    """Run a scenario in its simulated world with one module digitised from a real lamp; returns whether all evaluated checks passed.

    out, rig_file, device, kept: as of `run_on_rig`. Checks that compare with a baseline are left out. The lamp is dark after the run.
    Raises LuxloopError if the rig cannot be opened, does not fit the scenario or sends too few frames, and KeyboardInterrupt that says
    which steps are kept.
    """
    from luxloop.loop.commands.runs import run_scenario
    from luxloop.loop.recording.manifest import BEAM
    from luxloop.loop.rig.arrays import grids_of
    from luxloop.loop.rig.calibration.calibrate import load
    from luxloop.loop.rig.calibration.pictures import draw_beam
    from luxloop.loop.rig.live.plant import live_plant, refuse_unfit
    from luxloop.loop.scenario.plant import SimulatedPlantParams
    from luxloop.loop.simulation.lamps import mount
    from luxloop.loop.simulation.simulated import digitised_number

    file, armed, allow_code = rig_file
    params = read_rig(file, allow_code)
    with locate(str(file)):
        calibration_file = refuse_unfit(params)
    calibration = load(calibration_file)
    checks = {name: each for name, each in scenario.checks.items() if each.compare is None}
    scenario = scenario.model_copy(update={"plant": SimulatedPlantParams(), "checks": checks})
    with locate(scenario.source):
        modules = mount(scenario.headlight)
        number = digitised_number(scenario, [each.name for each in modules])
    with connect(params, file, grids_of([modules[number]]), None, armed) as rig, ExitStack() as stack:
        if not armed:
            tables.say("dry run: the lamp stays dark, and so does its module; give --arm to light it")
        live: LivePlant | None = None

        def plant(simulation: Any) -> Any:
            nonlocal live
            with locate(str(calibration_file)):
                live = stack.enter_context(live_plant(rig, simulation.plant, calibration, scenario.steps * len(scenario.shares)))
            rig.statistics = type(rig.statistics)()
            return live

        try:
            passed = run_scenario(scenario, out, device, False, {**kept, "plant": plant})
        finally:
            rig.keeper.dark("the run has ended")
            if live is not None and rig.statistics.exposures and out.is_dir():
                figures = run_statistics(rig, len(scenario.shares)) | {"judged": {}}
                beam = live.beam.summary() | {"module": modules[number].name, "seen": live.digitiser.coverage}
                _write(out, rig, figures | {"live": beam})
                if live.beam.newest is not None:
                    texture, u = live.beam.newest
                    draw_beam(out / BEAM, texture, live.truth.modules[number].headlight, u)
                tables.show(tables.facts(describe_run(figures) | _describe_beam(beam)))
    _require_frames(rig, file, out)
    return passed


def pixel_grids(scenario: "Scenario") -> "Grids":
    """Rows and columns of the pixels of the scenario's modules."""
    from luxloop.loop.rig.arrays import grids_of
    from luxloop.loop.simulation.lamps import mount

    with locate(scenario.source):
        return grids_of(mount(scenario.headlight))


def read_rig(file: Path, allow_code: bool, **changes: Any) -> "RigParams":
    """Read a rig file. changes: values that replace its tables. Raises LuxloopError where the file is wrong."""
    from luxloop.loop.rig.params import load_rig

    return load_rig(file, allow_code=allow_code).model_copy(update=changes)


@contextmanager
def connect(params: "RigParams", file: Path, grids: "Grids", camera: "CameraParams | None", armed: bool) -> "Iterator[Rig]":
    """The open rig of a file, with its page and camera connected; arguments as of `luxloop.loop.rig.rig.open_rig`. Errors name the file."""
    from luxloop.loop.rig.rig import open_rig

    with locate(str(file)), open_rig(params, grids, camera, armed=armed) as rig:
        await_rig(rig)
        yield rig


def await_rig(rig: "Rig") -> None:
    """Wait for the page of a screen and for the camera. Raises LuxloopError if no page connects or no picture comes."""
    from luxloop.loop.rig.rig import await_camera
    from luxloop.loop.rig.screen import ScreenLight

    if isinstance(rig.light, ScreenLight):
        rig.light.await_page(lambda address: print(f"Open {address} on the projector, in full screen.", flush=True))
    if not await_camera(rig):
        raise LuxloopError(rig.camera.reason)


def _write(out: Path, rig: "Rig", figures: Mapping[str, Any]) -> None:
    """Write a rig's parameters and the figures of a run into the recording, unless nothing was exposed."""
    from luxloop.loop.recording.manifest import RIG, write_json

    if rig.statistics.exposures:
        write_json(out / RIG, {"rig": redact(rig.params.model_dump(mode="json")), "armed": rig.armed, **figures})


def _twin(out: Path, simulated: "SimulatedPlant", mark: "MarkParams | None", exposures: int) -> dict[str, Any]:
    """Simulate the exposures of the rig, and compare the frames. exposures: their largest number. Raises KeyboardInterrupt after Ctrl-C."""
    from luxloop.loop.rig.calibration.twin import write_twin

    try:
        with tables.progress("twin", exposures) as advance:
            return write_twin(out, simulated, mark, advance)
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(f"the run is kept in {out}, without its twin") from error


def _describe_twin(found: Mapping[str, Any]) -> dict[str, str]:
    return {
        f"twin, {name} frames": f"mean digital number {each['mean_rig']:.1f} on the rig, {each['mean_simulated']:.1f} simulated; "
        f"MAE {each['mae']:.1f}, RMSE {each['rmse']:.1f}, SSIM {each['ssim']:.3f}"
        for name in ("on", "off")
        if (each := found.get(name)) is not None
    } or {"twin": "no frame came"}


def _require_frames(rig: "Rig", file: Path, out: Path) -> None:
    """Raises LuxloopError where the rig sent too few frames. file: rig file. out: folder of the recording."""
    if failure := rig.statistics.failure:
        raise LuxloopError(f"{file}: {failure}; the recording is kept in {out}")


def run_statistics(rig: "Rig", per_step: int) -> dict[str, Any]:
    """Statistics of a run on a rig, as plain data. per_step: exposures per control step."""
    watched = {"darkened": rig.keeper.darkened, "interruptions": rig.keeper.interruptions}
    camera = {"pictures": rig.camera.count, "dropped": rig.camera.dropped, "connections": rig.camera.connections}
    return {**rig.statistics.summary(per_step), "per_step": per_step, "watchdog": watched, "camera": camera}


def describe_run(figures: Mapping[str, Any]) -> dict[str, str]:
    """Rows of a table on the figures of a run: statistics of `run_statistics`, and `judged`."""
    lost = figures["lost"]
    reasons = (f"\n{count} lost: {reason}" for reason, count in sorted(lost.items(), key=lambda each: -each[1])[:5])
    rows = {
        "control rate": f"{tables.number(figures['control_rate_hz'], '.2f')} Hz",
        "light to frame": _spread(figures["light_to_frame_ms"]) or "no frame was taken",
        "frames": "".join([f"{figures['exposures'] - sum(lost.values())} of {figures['exposures']} exposures", *reasons]),
        "pictures": ", ".join(f"{count} {what}" for what, count in sorted(figures["pictures"].items())) or "none",
    }
    for name, each in figures["judged"].items():
        off = each["centroid_error_percent"]
        step = each["exposure"] // figures["per_step"]
        iou = f"IoU {each['iou_final']:.3f} at step {step}, {each['iou_mean']:.3f} on average in the last {each['pairs']}"
        where = "nothing is lit" if off is None else f"centroid {off[0]:.1f} % along, {off[1]:.1f} % across"
        rows[f"{name}, as the camera sees it"] = f"{iou}; {where}"
    if figures["dimmed"] or figures["slowed"]:
        rows["limits"] = f"dimmed {figures['dimmed']} exposures, slowed {figures['slowed']}"
    if any(figures["watchdog"].values()):
        rows["watchdog"] = (
            f"darkened the lamp {figures['watchdog']['darkened']} times, {figures['watchdog']['interruptions']} interruptions"
        )
    return rows


def _spread(ms: Mapping[str, float | None]) -> str:
    """Quantiles of a delay in words; empty without a value."""
    return "" if ms["median"] is None else f"{ms['median']:.0f} ms (median), {ms['p95']:.0f} ms (95 %), {ms['worst']:.0f} ms (worst)"


def _describe_beam(beam: Mapping[str, Any]) -> dict[str, str]:
    if not (times := _spread(beam["light_to_texture_ms"])):
        return {f"{beam['module']}, digitised": "no frame was taken"}
    rows = {
        "light to texture": f"{times}; {beam['frame_to_texture_ms']['median']:.0f} ms of it to digitise",
        f"{beam['module']}, digitised": f"the camera sees {beam['seen']:.1%} of its texels",
    }
    if beam["saturated"]:
        rows["saturated"] = f"{beam['saturated']:.2%} of the camera's pixels in the worst frame: its light is too low there; expose shorter"
    return rows
