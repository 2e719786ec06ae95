"""The stepped loop: state in, state out. Light is shown, frames are seen, the primitive moves, the judge writes down how it lies."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from controllers.pixels.ssc import Utilisation
from controllers.symbol.laws.open_loop import OpenLoopParams
from controllers.symbol.sensing.field import cut
from controllers.symbol.sensing.flat_model import FlatModel, flat_model
from controllers.symbol.sensing.observer import Observer, Seen
from controllers.symbol.sensing.projector import Projector
from controllers.symbol.sensing.protocol import Look, Shown, SymbolController
from loop.assembly.build import build_projector, build_road, build_symbol_controller
from loop.assembly.truth import LampModule
from loop.plant.build import build_plant
from loop.plant.pairing import Arrived, UnderWay, paired
from loop.plant.protocol import Arrivals, Exposure, Frame, Plant, Showing
from loop.plant.simulated import as_simulated
from loop.scenario.checks import Light
from loop.scenario.model import Scenario
from loop.symbol.feasible import brightness
from loop.symbol.judging import Judge
from perception.camera import CameraParams
from perception.egomotion import Ego, Samples, ego_of, newest
from perception.judge import Verdict
from world.errors import LuxloopError

Lights = tuple[Utilisation, ...]
Frames = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class SimulationState:
    """step: the step that comes next. controller, plant: their states. arrivals: what has come in by its beginning.

    samples: the newest of each sensor. under_way: what was shown whose frames have not come yet. frames: that have come without the other
    one of their pair. shape: `[4]` of the road on which the symbol was seen last, None for the flat one.
    """

    step: int
    controller: Any
    plant: Any
    arrivals: Arrivals
    samples: Samples
    under_way: UnderWay[Shown] = ()
    frames: tuple[Frame, ...] = ()
    shape: Tensor | None = None


@dataclass(frozen=True)
class StepResult:
    """What happened in one step. timings: ms by part, 'step' is all that control and plant took.

    pose: `[4]` that was shown. z: `[]` m, height of its centre above the assumed road. cut: `[4]`, shares of the symbol beyond the borders
    of the lamps' field (`controllers.symbol.sensing.field`).
    aim: `[2]`, x and y in m where the symbol lies in place of its target, NaN for the target.
    frames, seen: of the newest on and off frame that came in this step; they were taken at taken_s, NaN where none came. verdict: None
    where nobody judged. showings: the on and the off exposure.
    """

    step: int
    time_s: float
    pose: Tensor
    z: Tensor
    lights: Lights
    frames: Frames | None
    taken_s: float
    seen: Seen
    verdict: Verdict | None
    cut: Tensor
    aim: Tensor
    showings: tuple[Showing, ...]
    timings: dict[str, float]


@dataclass(frozen=True)
class Simulation:
    """A scenario made ready to run on one device. plant: what is controlled. judge: None where the plant does not know the truth."""

    scenario: Scenario
    device: torch.device
    projector: Projector
    observer: Observer
    controller: SymbolController
    plant: Plant
    judge: Judge | None

    @classmethod
    def prepare(cls, scenario: Scenario, device: torch.device | str = "cpu") -> "Simulation":
        """Build plant, lamps, internal model and judge. Raises LuxloopError where a file is missing or broken."""
        device = torch.device(device)
        projector = build_projector(scenario, device)

        def model_of(camera: CameraParams) -> FlatModel:
            return flat_model(projector, camera, scenario.surface, scenario.light.ambient_lx, scenario.extraction, scenario.features)

        model = model_of(scenario.camera)
        observer = Observer(projector, model, scenario.camera, scenario.extraction)
        plant, judge = build_plant(scenario, lamp_modules(projector)), None
        if (world := getattr(plant, "truth", None)) is not None:
            judged = model if world.camera == scenario.camera else model_of(world.camera)  # the judge knows where the camera is
            judge = Judge.of(world, scenario.symbol, build_road(scenario), judged.luminance(projector.light(projector.target)))
        return cls(scenario, device, projector, observer, build_symbol_controller(scenario.controller, observer), plant, judge)

    @property
    def truth(self) -> Judge:
        """The judge, where there must be one. Raises LuxloopError on a plant that does not know the truth."""
        if self.judge is None:
            raise LuxloopError(f"{self.scenario.name}: the plant {self.scenario.plant.kind} does not know the truth; take another plant")
        return self.judge

    @cached_property
    def brightness(self) -> Tensor:
        """Median luminance `[]` in cd/m^2 of the symbol at its target on a flat road."""
        return brightness(self.observer, self.judge)

    @property
    def renderer(self) -> str:
        """Source of the simulated plant's G-buffers, else what the plant is called."""
        return self.scenario.plant.kind if self.judge is None else self.judge.world.source.name

    def lit_by(self, light: Light) -> "Simulation":
        """The same world with the same noise in open loop. Raises LuxloopError on a plant of one's own, which shows one light alone."""
        as_simulated(self.plant, f"checks: compare = {light!r}")
        scenario = self.scenario.model_copy(update={"controller": OpenLoopParams()})
        return replace(self, scenario=scenario, controller=build_symbol_controller(scenario.controller, self.observer))

    def start(self) -> SimulationState:
        """The state before step 0."""
        plant, arrivals = self.plant.start()
        controller = self.controller.start(self.scenario.start.pose.to(self.projector.target))
        return SimulationState(0, controller, plant, arrivals, newest({}, arrivals.samples))

    def ego(self, state: SimulationState) -> Ego | None:
        """What is known of the vehicle's motion when the next step begins, None of one that stands."""
        return self._ego(state.samples, state.arrivals.time_s)

    def step(self, state: SimulationState) -> tuple[SimulationState, StepResult]:
        """One control step: the symbol is on for half of it and off for the other."""
        timings = dict.fromkeys(("light", "plant", "perceive", "control"), 0.0)
        time_s, ego = state.arrivals.time_s, self.ego(state)
        with _timed(timings, "light"):
            drawing = self.controller.drawing(state.controller, ego)
            lights = self.projector.draw(drawing)
        plant, arrivals, samples, frames = state.plant, state.arrivals, state.samples, state.frames
        showings: tuple[Showing, ...] = ()
        for part, (light, drawn) in enumerate(((lights, drawing), (self.projector.resting, None))):
            with _timed(timings, "plant"):
                exposure = Exposure(
                    2 * state.step + part, arrivals.time_s, self.scenario.shares[part] / self.scenario.rate_hz, light, drawn
                )
                plant, after = self.plant.show(plant, exposure)
                showings, arrivals, frames = (*showings, Showing(arrivals, exposure, after)), after, frames + after.frames
                samples = newest(samples, after.samples)
        looks, under_way, frames = paired((*state.under_way, (2 * state.step, Shown(drawing, lights, ego))), frames)
        controller, shape, now = state.controller, state.shape, self._ego(samples, arrivals.time_s)
        for look in looks:
            shown, pair = _shown(look), look.images
            with _timed(timings, "perceive"):
                seen = self.observer.look(pair, shown.drawing, shown.lights, shape if now is None or now.stands else None)
                shape = seen.shape
            with _timed(timings, "control"):
                controller = self.controller.step(controller, Look(seen, pair, shown, now))
        timings["step"] = sum(timings.values())
        with _timed(timings, "judge"):
            verdict = self._judged(state.step, lights, time_s)
        z = torch.zeros_like(drawing.pose[..., 0]) if drawing.z is None else drawing.z
        aim = drawing.pose.new_full((2,), torch.nan) if drawing.aim is None else drawing.aim.to(drawing.pose)
        outside = cut(self.projector, drawing)
        return (
            SimulationState(state.step + 1, controller, plant, arrivals, samples, under_way, frames, shape),
            StepResult(
                state.step, time_s, drawing.pose, z, lights, pair, looks[-1].taken_s, seen, verdict, outside, aim, showings, timings
            ),
        )

    def _ego(self, samples: Samples, time_s: float) -> Ego | None:
        return ego_of(samples, self.scenario.vehicle, time_s, self.scenario.shares[0] / self.scenario.rate_hz)

    def _judged(self, step: int, lights: Lights, time_s: float) -> Verdict | None:
        every = self.scenario.judge_every
        return None if self.judge is None or not every or step % every else self.judge.verdict(lights, time_s)

    def run(self) -> Iterator[StepResult]:
        """All steps of the scenario."""
        state = self.start()
        for _ in range(self.scenario.steps):
            state, result = self.step(state)
            yield result


def lamp_modules(projector: Projector) -> tuple[LampModule, ...]:
    """The modules of a projector with their base beams."""
    drawing = zip(projector.modules, projector.resting, strict=True)
    return tuple(LampModule(each.name, each.pixel_controller.headlight, beam, each.T_world_headlight) for each, beam in drawing)


def _shown(arrived: Arrived[Shown]) -> Shown:
    """What was asked for, unless the on frame says otherwise."""
    asked, shown = arrived.what, arrived.on.shown
    return asked if shown is None else replace(asked, drawing=shown.drawing or asked.drawing, lights=shown.lights)


@contextmanager
def _timed(timings: dict[str, float], part: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    timings[part] = timings.get(part, 0.0) + 1e3 * (time.perf_counter() - start)
