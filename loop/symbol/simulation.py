"""The stepped loop: state in, state out. Light is shown, frames are seen, the primitive moves, the judge writes down how it lies."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from controllers.pixels.ssc import Utilisation
from controllers.symbol.sensing.field import cut
from controllers.symbol.sensing.flat_model import FlatModel, flat_model
from controllers.symbol.sensing.observer import Observer, Seen
from controllers.symbol.sensing.projector import Projector, SymbolParams
from controllers.symbol.sensing.protocol import Look, Shown, SymbolController
from loop.assembly.build import build_motion, build_projector, build_road, build_scene, build_symbol_controller
from loop.scenario.model import Scenario
from loop.symbol.plant import Frames, SimulatedPlant
from loop.symbol.truth import true_camera, true_modules
from loop.symbol.world import World
from perception.birdseye import BirdsEye, Region, birds_eye, cells, region_around
from perception.camera import CameraParams
from perception.judge import CELL_M, Target, Verdict, judge, target
from world.frames import transform
from world.rendering.face_source import face_source
from world.scene.vehicle import STANDING, Motion
from world.view import View

Lights = tuple[Utilisation, ...]


@dataclass(frozen=True)
class SimulationState:
    """step: the step that comes next. controller, plant: their states. shown: in the frames that are under way.

    shape: `[4]` of the road on which the symbol was seen last, None for the flat one.
    """

    step: int
    controller: Any
    plant: Any
    shown: tuple[Shown, ...] = ()
    shape: Tensor | None = None


@dataclass(frozen=True)
class StepResult:
    """What happened in one step. timings: ms by part, 'step' is all that control and plant took.

    pose: `[4]` that was shown. z: `[]` m, height of its centre above the assumed road. cut: `[4]`, shares of the symbol beyond the borders
    of the lamps' field (`controllers.symbol.sensing.field`).
    aim: `[2]`, x and y in m where the symbol lies in place of its target, NaN for the target.
    """

    step: int
    time_s: float
    pose: Tensor
    z: Tensor
    lights: Lights
    frames: Frames | None
    seen: Seen
    verdict: Verdict
    cut: Tensor
    aim: Tensor
    timings: dict[str, float]


@dataclass(frozen=True)
class Simulation:
    """A scenario made ready to run on one device.

    plant: what is controlled. world: what the judge looks at, and in simulation the plant's. plane: of the vehicle as it stands at first,
    see `plane_at`.
    """

    scenario: Scenario
    device: torch.device
    projector: Projector
    observer: Observer
    controller: SymbolController
    plant: SimulatedPlant
    world: World
    plane: BirdsEye
    goal: Target

    @classmethod
    def prepare(cls, scenario: Scenario, device: torch.device | str = "cpu") -> "Simulation":
        """Build scene, lamps, internal model and judge. Raises LuxloopError where a file is missing or broken."""
        device = torch.device(device)
        symbol = scenario.symbol
        motion = build_motion(scenario)
        scene = build_scene(scenario, motion)
        projector = build_projector(scenario, device)
        camera = true_camera(scenario)

        def model_of(camera: CameraParams) -> FlatModel:
            return flat_model(projector, camera, scenario.surface, scenario.light.ambient_lx, scenario.extraction, scenario.features)

        model = model_of(scenario.camera)
        judged = model if camera == scenario.camera else model_of(camera)  # the judge knows where the camera is
        world = World(scene, true_modules(scenario, projector), camera, face_source(scenario.renderer), device, motion)
        observer = Observer(projector, model, scenario.camera, scenario.extraction)
        return cls(
            scenario=scenario,
            device=device,
            projector=projector,
            observer=observer,
            controller=build_symbol_controller(scenario, observer),
            plant=SimulatedPlant(world, scenario.rate_hz, scenario.seed, scenario.sensors, scenario.disturbances),
            world=world,
            plane=_plane(scenario, world.view, _road(scenario, motion, 0.0), device),
            goal=target(
                judged.luminance(projector.light(projector.target)),
                _plane(scenario, world.view, None, device),
                symbol.length_m,
                symbol.width_m,
            ),
        )

    def start(self) -> SimulationState:
        """The state before step 0."""
        s = self.scenario.start
        angles = torch.deg2rad(torch.tensor([s.roll_deg, s.pitch_deg]))
        pose = torch.cat([torch.tensor([s.x_m, s.y_m]), angles]).to(self.projector.target)
        return SimulationState(0, self.controller.start(pose), self.plant.start())

    def step(self, state: SimulationState) -> tuple[SimulationState, StepResult]:
        """One control step."""
        timings: dict[str, float] = {}
        time_s, off_time_s = self.plant.exposures(state.step)
        with _timed(timings, "render"):
            self.world.render(time_s, off_time_s)
        with _timed(timings, "light"):
            drawing = self.controller.drawing(state.controller)
            lights = self.projector.draw(drawing)
        with _timed(timings, "camera"):
            plant, frames = self.plant.show(state.plant, lights, state.step)
        with _timed(timings, "perceive"):
            ego = self.plant.ego(state.step)
            shown = (*state.shown, Shown(drawing, lights, ego))
            late = self.scenario.camera.latency_steps
            seen = self.observer.look(frames, shown[0].drawing, shown[0].lights, state.shape if ego.stands else None)
        with _timed(timings, "control"):
            controller = self.controller.step(state.controller, Look(seen, frames, shown[0], ego))
        timings["step"] = sum(timings.values())
        with _timed(timings, "judge"):
            verdict = self.judge(lights, time_s)
        following = SimulationState(state.step + 1, controller, plant, shown[-late:] if late else (), seen.shape)
        z = torch.zeros_like(drawing.pose[..., 0]) if drawing.z is None else drawing.z
        aim = drawing.pose.new_full((2,), torch.nan) if drawing.aim is None else drawing.aim.to(drawing.pose)
        return following, StepResult(
            state.step, time_s, drawing.pose, z, lights, frames, seen, verdict, cut(self.projector, drawing), aim, timings
        )

    def judge(self, lights: Lights, time_s: float) -> Verdict:
        """How the light lies on the road at a time, without noise."""
        return judge(self.world.lit(time_s).luminance(lights), self.plane_at(time_s), self.goal)

    def plane_at(self, time_s: float) -> BirdsEye:
        """Where the target lies, as the camera sees it at a time: the plane z = 0 under the vehicle, or the road itself."""
        view, motion = self.world.view_from_ground(time_s), self.world.motion
        flat = self.scenario.symbol.target == "appearance"
        if motion is STANDING or (flat and view.T_world_view.equal(self.world.view.T_world_view)):
            return self.plane
        return _plane(self.scenario, view, _road(self.scenario, motion, time_s), self.device)

    def run(self) -> Iterator[StepResult]:
        """All steps of the scenario."""
        state = self.start()
        for _ in range(self.scenario.steps):
            state, result = self.step(state)
            yield result


def _plane(scenario: Scenario, view: View, road: Tensor | None, device: torch.device) -> BirdsEye:
    return birds_eye(_region(scenario.symbol), view, road).to(device)


def _region(symbol: SymbolParams) -> Region:
    return region_around(symbol.x_m, symbol.y_m, symbol.length_m, symbol.width_m, CELL_M)


def _road(scenario: Scenario, motion: Motion, time_s: float) -> Tensor | None:
    """Places `[3, rows, cols]` m of the road in the ground frame of a time, where a symbol's target is a place on it."""
    if scenario.symbol.target == "appearance":
        return None
    x, y, z = cells(_region(scenario.symbol))
    T_world_ground = motion.at(time_s).T_world_ground
    at_x, at_y, _ = transform(T_world_ground, torch.stack([x, y, z]).flatten(1)).numpy()
    return torch.stack([x, y, torch.from_numpy(build_road(scenario).z(at_x, at_y)).view_as(z)])


@contextmanager
def _timed(timings: dict[str, float], part: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    timings[part] = 1e3 * (time.perf_counter() - start)
