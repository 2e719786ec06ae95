"""A run in the studio: its simulation, its steps so far, and their values."""

import gc
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.recording.checks import Checks
from luxloop.loop.recording.manifest import REPORT, Manifest
from luxloop.loop.recording.record import schema
from luxloop.loop.recording.recorder import Recorder, Tally
from luxloop.loop.recording.replay import apply_edit
from luxloop.loop.report.highlights import Highlights
from luxloop.loop.report.picture import white_of
from luxloop.loop.run import prepare
from luxloop.loop.scenario.driving import repeat
from luxloop.loop.scenario.edits import ACTS, Edit, differences, replaces
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.lamps import T_world_lamp, lamp_modules
from luxloop.loop.simulation.protocol import close_plant
from luxloop.loop.simulation.redrawn import lights_without_paint, mask_limits
from luxloop.loop.simulation.result import SimulationState
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.simulation.truth import LampModule
from luxloop.loop.studio.meshes import Meshes
from luxloop.loop.studio.messages import PICTURES, VIEWS, View
from luxloop.loop.studio.playback import Playback
from luxloop.loop.studio.snapshot import Snapshot, bodies_at, snapshot
from luxloop.loop.studio.sources import Source
from luxloop.perception.camera import camera_view, saturation_luminance
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import output_folder
from luxloop.world.frames import inverse
from luxloop.world.headlight.lamp import Lamp, Module
from luxloop.world.light import emitters
from luxloop.world.regulation import check_beam
from luxloop.world.scene.triangles import NOTHING

KEPT_BYTES = 2**30  # of light and pictures of past steps; the oldest are dropped
MOST_EDITS = 100  # separate edits of one step


class Run:
    """Steps of one simulation, with what clients show of them.

    The stepping thread adds to `snapshots`, `rows`, `edits`, `client_edits` and `meshes`, which others read; nothing is removed but light
    and pictures of old snapshots. rows: of a repeated recording those of all its steps; replaced when an edit ends the repetition.
    client_edits: edits sent to clients, all but those of driving. columns: of the rows; later rows may have more. recorder: None while
    nothing is recorded. label: for the page.
    """

    def __init__(
        self,
        simulation: Simulation,
        label: str,
        overrides: Collection[str],
        wanted: Collection[View] = VIEWS,
        playback: Playback | None = None,
    ) -> None:
        """Start a run with its first step. wanted: contents that clients show. playback: of a recording to repeat."""
        self.simulation, self.label, self.overrides = simulation, label, list(overrides)
        self.tally, self.highlights = Tally(simulation), Highlights(simulation)
        self.recorder: Recorder | None = None
        self._recording = ExitStack()
        self.playback = playback
        self.columns = _numbers(simulation) if playback is None else playback.columns(_numbers(simulation))
        self.meshes, self.snapshots = Meshes(), list[Snapshot]()
        self.client_edits = list[Edit]()
        self.rows = list[np.ndarray]() if playback is None else playback.rows(self.columns)
        self.step_ms = float("nan")
        self._state = simulation.start()
        self._reached = self._state, simulation.scenario  # after the last step, before edits
        self._kept, self._forgotten = 0, 0
        self._pictures = set[str]()  # names of those that any snapshot has had
        self.bodies = NOTHING  # of the newest snapshot
        self._sources: tuple[Snapshot, Mapping[int, emitters.Source]] | None = None
        self._below: Sequence[tuple[Utilisation, Tensor]] = ()  # light of the last step without paint, and limits of paint
        self._ahead = False  # whether edits follow the last step
        self._next: tuple[Simulation, Evaluation] | None = None  # preview of the next step
        self._made = simulation, self.step(wanted)  # last result and its simulation
        self.white_cd_m2 = float(white_of(self._made[1], simulation))
        self.peaks_cd = [each.headlight.peak_cd for each in simulation.modules]

    @property
    def over(self) -> bool:
        """Whether all steps of the scenario are done."""
        return len(self.snapshots) >= self.simulation.scenario.steps

    @property
    def shown(self) -> tuple[Simulation, Evaluation]:
        """The last result, or its preview with pending edits, and its simulation."""
        return self._next or self._made

    def step(self, wanted: Collection[View]) -> Evaluation:
        """Do a step. wanted: contents that clients show."""
        if self._below or self._next is not None:
            self.snapshots[-1] = self._take_snapshot(*self._made, self.snapshots[-1], wanted)
        while self.playback is not None and (due := self.playback.due(len(self.snapshots))) is not None:
            self._go_on(self.prepare_edit(repeat(self.simulation.scenario, due)), due.overrides, due.driven)
        began_s = time.perf_counter()
        with locate(self.simulation.scenario.source):
            state, stepped = self.simulation.step(self._state)
            result = self.simulation.evaluate(stepped, self._made[1] if self.snapshots else None)
        self.step_ms = 1e3 * (time.perf_counter() - began_s)
        before = self.snapshots[-1] if self.snapshots else None
        taken = self._take_snapshot(self.simulation, result, before, wanted)
        values = (self.recorder or self.tally).add(result)
        self.highlights.add(result)
        self._state, self._made = state, (self.simulation, result)
        self._reached = state, self.simulation.scenario
        self._below, self._next, self._ahead = (), None, False
        if len(self.rows) == len(self.snapshots):  # not from a recording
            self.rows.append(np.array([_number(values.get(each.name)) for each in self.columns], np.float32))
        self.snapshots.append(taken)
        if before is not None and before.exact:
            self.snapshots[-2] = replace(before, exact={})
        self._kept += taken.bytes_beside(before)
        while self._kept > KEPT_BYTES and self._forgotten < len(self.snapshots) - 1:
            self._forget(self._forgotten)
        return result

    def at(self, step: int) -> Snapshot:
        """Snapshot of a step, the last one for later steps; of a repeated recording also a step not yet repeated."""
        snapshots, playback = self.snapshots, self.playback
        if playback is None or step < len(snapshots):
            return snapshots[min(step, len(snapshots) - 1)]
        return playback.snapshot(min(step, len(self.rows) - 1), snapshots[-1])

    def with_pictures(self, seen: Snapshot, wanted: Collection[View]) -> Snapshot:
        """Snapshot with the wanted pictures, or a recording's stored frames; else the last earlier one with them, or itself."""
        names = {PICTURES[view] for view in ("camera", "off") if view in wanted} & self._pictures
        if names <= seen.pictures.keys():
            return seen
        if self.playback is not None and (kept := self.playback.pictures(seen.step)):
            return replace(seen, pictures=kept)
        before = (self.snapshots[k] for k in range(min(seen.step, len(self.snapshots) - 1), -1, -1))
        return next((each for each in before if names <= each.pictures.keys()), seen)

    def record(self, directory: Path) -> None:
        """Record all steps so far, and further ones until `end_recording`. Raises LuxloopError as `Recorder`, and if another process writes
        there.
        """
        self.end_recording()

        def report(table: pa.Table, summary: dict[str, Any], manifest: Manifest) -> None:
            from luxloop.loop.report.page import write_report  # imports Matplotlib, late for a fast start

            write_report(directory / REPORT, self.simulation, self.highlights, table, summary, manifest)
            gc.collect()  # see `luxloop.loop.run`

        with ExitStack() as stack:
            stack.enter_context(output_folder(directory))
            recorder = stack.enter_context(Recorder(directory, self.tally, report, self._outcomes))
            recorder.begin()
            self.recorder, self._recording = recorder, stack.pop_all()

    def end_recording(self) -> None:
        """Finish the recording, if any, which draws its report for seconds."""
        self.recorder = None
        self._recording.close()

    def look_again(self, wanted: Collection[View]) -> None:
        """Renew the last snapshot with all that clients show now, and in a simulated world with pending edits."""
        if self._ahead and self._next is None and self.simulation.scenario.plant.kind == "simulated":  # other plants show light
            with locate(self.simulation.scenario.source):
                _, following = self.simulation.step(self._state)
            self._next = self.simulation, replace(self.simulation.evaluate(following, self._made[1]), step=self._made[1].step)
        seen = self._next or (self._made[0], self._repaint())
        self.snapshots[-1] = self._take_snapshot(*seen, self.snapshots[-1], wanted)

    def _repaint(self) -> Evaluation:
        """Last result with the current paint."""
        (simulation, result), lighting = self._made, self.simulation.scenario.lighting
        if lighting.painted == simulation.scenario.lighting.painted:
            return result
        self._below = self._below or tuple(zip(lights_without_paint(simulation, result), mask_limits(simulation, result), strict=True))
        lights = [self.simulation.planner.paint(each.name, *below) for each, below in zip(simulation.modules, self._below, strict=True)]
        factors = {side: power.factor for side, power in result.powers.items()}
        powers = simulation.lamps.powers(simulation.lamps.aim(result.now), lights, factors)
        return replace(result, lights=tuple(each.u for each in lights), reception=replace(result.reception, powers=powers))

    def _take_snapshot(self, simulation: Simulation, result: Evaluation, before: Snapshot | None, wanted: Collection[View]) -> Snapshot:
        self.bodies = bodies_at(simulation, result.time_s, self.bodies)
        taken = snapshot(simulation, result, self.meshes.assign(self.bodies.placed), before, wanted)
        self._pictures |= taken.pictures.keys()
        return taken

    def prepare_edit(self, scenario: Scenario) -> tuple[Simulation, SimulationState]:
        """Simulation and state for another scenario. Raises LuxloopError."""
        state, by = self._reached
        return apply_edit(self.simulation, state, scenario, by)

    def edit(self, after: tuple[Simulation, SimulationState], overrides: tuple[str, ...], driven: bool = False) -> None:
        """Continue with a prepared edit from the next step on; this ends the repetition of a recording.

        overrides: of the scenario. driven: whether by driving.
        """
        if self.playback is not None:
            self.playback, self.rows = None, self.rows[: len(self.snapshots)]
        self._go_on(after, overrides, driven)

    def _go_on(self, after: tuple[Simulation, SimulationState], overrides: tuple[str, ...], driven: bool) -> None:
        before, scenario = self.simulation.scenario, after[0].scenario
        painted = before.lighting.model_copy(update={"painted": scenario.lighting.painted})
        self._ahead |= before.model_copy(update={"lighting": painted}) != scenario
        self._next = None
        self.simulation, self._state = after
        edit = Edit(step=len(self.snapshots), overrides=overrides, driven=driven)
        if not driven:
            self.highlights.edit(self.simulation)
            known = {each.name for each in self.columns}
            self.columns = [*self.columns, *(each for each in _numbers(self.simulation) if each.name not in known)]
            if self.client_edits and replaces(edit, self.client_edits[-1]):  # a picture of many strokes is stored once
                self.client_edits[-1] = edit.model_copy(update={"overrides": ()})
            self.client_edits.append(edit)
        (self.recorder or self.tally).edit(self.simulation, edit)
        edits = self.tally.edits
        first = next((k for k, each in enumerate(edits) if each.step == edit.step), len(edits))
        if len(edits) - first > MOST_EDITS:
            with suppress(LuxloopError):  # not every change is a value of a key
                edits[first:] = [Edit(step=edit.step, overrides=differences(self._reached[1], scenario))]
                self.client_edits[:-1] = [each.model_copy(update={"overrides": ()}) for each in self.client_edits[:-1]]

    def _forget(self, number: int) -> None:
        old, after = self.snapshots[number : number + 2]
        self.snapshots[number] = replace(old, lights=(), pictures={})
        self._kept -= old.bytes_beside(after)
        self._forgotten = number + 1

    def summary(self) -> dict[str, Any]:
        """Results of all steps so far. Renders, so call it in the stepping thread."""
        return self.tally.summary(self._outcomes)

    def _outcomes(self, table: pa.Table) -> dict[str, Any]:
        """Outcomes by name of the checks without comparison light."""
        return Checks(self.simulation.scenario.checks, None).outcomes(table)

    @property
    def shining(self) -> tuple[LampModule, ...]:
        """The modules as they truly shine, which may be worn, unlike those of `simulation`."""
        world = self.simulation.truth
        return lamp_modules(self.simulation.modules) if world is None else world.modules

    def lit_snapshot(self, step: int | None) -> Snapshot:
        """Snapshot of a step, the newest for None. Raises LuxloopError if its light is no longer stored."""
        shown = self.snapshots[-1 if step is None else min(step, len(self.snapshots) - 1)]
        if not shown.lights:
            raise LuxloopError(f"step {step}: its light is no longer kept; start anew to see it")
        return shown

    def sources(self, shown: Snapshot) -> Mapping[int, emitters.Source]:
        """The modules that shine in a snapshot, by number; cached for the last one."""
        if self._sources is None or self._sources[0] is not shown:
            lit = zip(self.shining, shown.lights, shown.head["modules"], strict=True)
            found = {
                number: emitters.Source(
                    module.headlight,
                    (module.measured or module.headlight).light_texture(u.to(module.headlight.matrix.values)).cpu(),
                    matrix(posed["T_world_module"]),
                )
                for number, (module, u, posed) in enumerate(lit)
                if bool(u.any())
            }
            self._sources = shown, found
        return self._sources[1]

    def beam(self, rule: str, side: str, step: int | None) -> list[dict[str, Any]]:
        """Result of a regulation's requirements for a side's light in a step, the newest for None, as the protocol has it.

        Raises LuxloopError for an unknown rule, and if the light of that step is no longer stored.
        """
        shown = self.lit_snapshot(step)
        head = shown.head
        T_body_world, modules, lights = inverse(matrix(head["T_world_body"])), [], []
        for module, u, posed in zip(self.simulation.modules, shown.lights, head["modules"], strict=True):
            if module.side == side:
                modules.append(Module(module.name, module.headlight, T_body_world @ matrix(posed["T_world_module"])))
                lights.append(u.to(module.flux))
        verdicts = {"pass": True, "fail": False}
        return [
            {
                "id": each.id,
                "where": each.where,
                "value": each.value,
                "unit": each.unit,
                "limit": each.limits,
                "passed": verdicts.get(each.verdict),
            }
            for each in check_beam(Lamp(side, tuple(modules)).lit(lights), rule)
        ]

    def facts(self) -> dict[str, Any]:
        """Facts of the run for clients, plain."""
        scenario = self.simulation.scenario
        view = camera_view(scenario.camera)
        lens = {key: getattr(view, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
        return {
            "label": self.label,
            "overrides": self.overrides,
            "controllers": {name: each.params.name for name, each in self.simulation.controlled.items()},
            "columns": [
                {"name": each.name, **{key.decode(): value.decode() for key, value in (each.metadata or {}).items()}}
                for each in self.columns
            ],
            "lamps": {side: T_world_lamp(side, scenario.headlight)[:3, 3].tolist() for side in scenario.headlight.lamps},
            "modules": [self._module(k) for k in range(len(self.simulation.modules))],
            "camera": {**lens, "bits": scenario.camera.bits, "saturation_cd_m2": saturation_luminance(scenario.camera)},
            "ambient_lx": scenario.light.ambient_lx,
            "white_cd_m2": self.white_cd_m2,
            "road": scenario.road.kind,
            "street_lamps": [each.model_dump(mode="json") for each in scenario.light.street_lamps],
        }

    def _module(self, number: int) -> dict[str, Any]:
        module = self.simulation.modules[number]
        keys = ("rows", "cols", "left", "right", "bottom", "top", "pixel_rows", "pixel_cols")
        grid = {key: getattr(module.headlight, key) for key in keys}
        turns = {"swivel_deg": module.swivel_deg, "level_deg": module.level_deg}
        return {"name": module.name, "side": module.side, **grid, "peak_cd": self.peaks_cd[number], "flux_lm": module.flux_lm, **turns}


def start(
    sources: Iterable[tuple[Source, Scenario | None]],
    old: Sequence[Run],
    wanted: Collection[View],
    told: Callable[[str], None],
    *,
    anew: bool,
    device: str = "cpu",
    allow_code: bool = False,
) -> list[Run]:
    """Runs of sources. sources: each with a scenario instead of its own, or None to load that.

    old: runs to replace; their plants are closed once a new one is prepared, and their parts are reused unless `anew`. wanted: contents
    that clients show. told: called with the current activity. Raises LuxloopError.
    """
    torch.set_num_threads(1)  # a step's operations are too small for two
    before = None if anew or not old else old[0].simulation
    given = [(source, *(source.load(allow_code) if scenario is None else (scenario, None))) for source, scenario in sources]
    runs = list[Run]()
    for source, scenario, recording in given:
        told(f"preparing {scenario.name}")
        before = prepare(scenario, device, before)
        for run in old:
            close_plant(run.simulation.plant)  # the new one needs its address or devices
        told(f"first step of {scenario.name}")
        playback = Playback(source.recording, recording) if source.recording and recording else None
        runs.append(Run(before, source.label, source.all, wanted, playback))
    return runs


def head(runs: Sequence[Run], number: int) -> dict[str, Any]:
    """Head of the message `scenario`."""
    first = runs[0].simulation.scenario
    return {
        "type": "scenario",
        "number": number,
        **{key: getattr(first, key) for key in ("name", "source", "steps", "rate_hz", "seed")},
        "runs": [run.facts() for run in runs],
        "model": first.model_dump(mode="json"),
        "acts": ACTS,
    }


def _numbers(simulation: Simulation) -> list[pa.Field]:
    """Columns of numbers of a simulation's recording."""
    return [each for each in schema(simulation) if not pa.types.is_string(each.type)]


def matrix(numbers: Sequence[float]) -> torch.Tensor:
    """Pose `[4, 4]` from the 16 numbers of a message."""
    return torch.tensor(numbers, dtype=torch.float64).view(4, 4)


def _number(value: Any) -> float:
    return float("nan") if value is None or isinstance(value, str) else float(value)
