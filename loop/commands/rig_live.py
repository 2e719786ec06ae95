"""`luxloop run --rig` of a scenario with a digitised module: a real lamp lights the simulated world."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from luxloop.loop.commands.rig_runs import await_rig, in_words, of_run, refuse_failed
from luxloop.loop.report import terminal as tables
from luxloop.world.errors import locate, redact

if TYPE_CHECKING:
    from luxloop.loop.rig.live.plant import LivePlant
    from luxloop.loop.scenario.model import Scenario


def run_live(scenario: "Scenario", out: Path, rig_file: tuple[Path, bool, bool], device: str, kept: Mapping[str, Any]) -> bool:
    """Run a scenario in its simulated world with one module digitised from a real lamp; returns whether all evaluated checks passed.

    out: folder of the recording. rig_file: its path, whether the lamp is lit, and whether modules that it names may run. device: to compute
    on. kept: what is recorded, keyword arguments of `luxloop.loop.run.run`. Checks that compare with another light are left out. Raises
    LuxloopError if the rig cannot be opened or does not fit the scenario, and KeyboardInterrupt that says what was kept; the lamp is dark
    then. Raises LuxloopError after a run to which too few frames came.
    """

    from luxloop.loop.commands.runs import run_scenario
    from luxloop.loop.recording.files import BEAM, RIG
    from luxloop.loop.recording.manifest import write_json
    from luxloop.loop.rig.calibration.files import load
    from luxloop.loop.rig.live.picture import draw_beam
    from luxloop.loop.rig.live.plant import live_plant, refuse_unfit
    from luxloop.loop.rig.params import load_rig
    from luxloop.loop.rig.plant import grids_of
    from luxloop.loop.rig.rig import opened
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
    with locate(str(file)), opened(params, grids_of([modules[number]]), None, armed=armed) as rig, ExitStack() as stack:
        await_rig(rig)
        if not armed:
            tables.console().print("dry run: the lamp stays dark, and so does its module; give --arm to light it", markup=False)
        live: LivePlant | None = None

        def plant(simulation: Any) -> Any:
            nonlocal live
            with locate(str(calibration_file)):
                live = stack.enter_context(live_plant(rig, simulation.plant, calibration, scenario.camera, exposures))
            rig.statistics = type(rig.statistics)()
            return live

        try:
            passed = run_scenario(scenario, out, device, False, {**kept, "plant": plant})
        finally:
            rig.dark("the run has ended")
            if live is not None and rig.statistics.exposures and out.is_dir():
                found = of_run(rig, len(scenario.shares)) | {"judged": {}}
                beam = live.beam.summary() | {"module": modules[number].name, "seen": live.digitiser.seen}
                write_json(out / RIG, {"rig": redact(params.model_dump(mode="json")), "armed": armed, **found, "live": beam})
                if live.beam.newest is not None:
                    texture, u = live.beam.newest
                    draw_beam(out / BEAM, texture, live.truth.modules[number].headlight, u)
                tables.show(tables.facts(in_words(found) | _in_words(beam)))
    refuse_failed(rig, file, out)
    return passed


def _in_words(beam: Mapping[str, Any]) -> dict[str, str]:
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
