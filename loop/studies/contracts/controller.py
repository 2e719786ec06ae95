"""Contract of a user's own symbol controller."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.symbol.sensing.projection import ProjectionCommand, Warp
from luxloop.controllers.symbol.sensing.symbol_sensor import Observation
from luxloop.controllers.symbol.stages import KEY
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.loop.simulation.protocol import Images
from luxloop.loop.studies.contracts.values import build_part, check_tensor, pure, pure_state, world
from luxloop.perception.egomotion import Ego, Sample, Sensor, ego_of
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.plugin import Guard, construct

CALLS = {"start": ("pose",), "projection": ("state", "ego"), "step": ("state", "observation")}
SCENARIO = """
name = "check_controller"
steps = 8
camera = { width_px = 320, height_px = 180, oversampling = 1 }
headlight = { model = "idealised-332x1024", lamps = ["left"] }
renderer = "raycast"
[functions.symbol]
kind = "symbol"
image = "snowflake"
start = { x_m = 17.4, y_m = 0.3, roll_deg = 2.0, pitch_deg = -1.0 }
controller = "open"
"""
FARTHEST_M = (100.0, 20.0)  # ahead and to each side, the limits of a scenario's start
STEEPEST = math.radians(45)
REMEDY = (
    "subtract a share of observation.measurement.pose_error, the pose less its target in m and rad; "
    "observation.measurement.errors are in units of the image"
)
LOST_AFTER = (0, 4)  # steps that are repeated with a lost symbol
DRIVES_AFTER = 2  # step that is repeated on a moving car
SENSED: dict[Sensor, list[float]] = {  # samples of the moving car
    "wheels": [10.0, 10.1],
    "gyro": [0.01, 0.02, 0.1],
    "attitude": [0.005, 0.002, 0.003, 0.02, 0.01, 0.001, 0.02, 0.002],
}
AWAY = 1.5  # largest final distance from the target relative to the start, for noise


def check_controller(controller: type, options: Mapping[str, Any] | None = None, device: str = "auto") -> None:
    """Check your own symbol controller against the contract of `luxloop.SymbolController`, in a few seconds.

    controller: the class, from which a scenario makes `controller(sensor, **options)`; an instance would have another scenario's sensor.
    options: those of the scenario. device: "auto", "cpu" or "cuda".

    The check runs 8 steps on a flat road with a camera of 320 x 180 px; some steps are repeated without frames, with frames that do not
    show the symbol, and on a moving car, with measured attitude and rates and without (NaN). Raises LuxloopError with likely cause and
    remedy if a method is missing, fails, changes its arguments, or gives different results for the same arguments; if a state is no data;
    if a projection differs from the start pose `[4]` in shape, dtype or device, is not finite, or not in m and rad; and if the symbol moves
    away from its target.
    """
    simulation = world(SCENARIO, device)
    symbol = simulation.symbol
    own = build_part(controller, KEY, CALLS, lambda name: construct(controller, name, KEY, {"sensor": symbol.sensor}, options or {}))
    checked = replace(simulation, controlled={"symbol": replace(symbol, controller=CheckController(own, symbol))})
    seen = [result.measurement for result in checked.run()]
    first, last = (math.hypot(*each.pose_error[:2].tolist()) for each in (seen[0], seen[-1]))
    if seen[-1].code != ExtractionStatus.SEEN or last > AWAY * first:
        end = f"it is {last:.2g} m away" if seen[-1].code == ExtractionStatus.SEEN else "it is not seen any more"
        raise LuxloopError(
            f"{KEY}: {own.name}: step moves the symbol away from its target: at first it was {first:.2g} m away, after {len(seen)} steps "
            f"{end}; {REMEDY}"
        )


@dataclass(frozen=True)
class CheckState:
    """State of a checked controller: its own state, and the number of steps so far."""

    inner: Any
    steps: int = 0


@dataclass(frozen=True)
class CheckController:
    """A controller whose calls are checked."""

    own: Guard
    symbol: ControlledSymbol

    def start(self, pose: Tensor) -> CheckState:
        """Initial state of the controller, checked to be data."""
        return CheckState(pure_state(self.own, "start", {"pose": pose}))

    def projection(self, state: CheckState, ego: Ego | None) -> ProjectionCommand:
        """Projection command of the controller, checked to be within reach."""
        projection = pure(self.own, "projection", {"state": state.inner, "ego": ego}, "projection")
        with locate(f"{self.own.key}: {self.own.name}: projection"):
            self._check(projection)
        return projection

    def step(self, state: CheckState, observation: Observation) -> CheckState:
        """State after an observation; some steps are repeated with a lost symbol or on a moving car."""
        after = self._step(state, observation)
        if state.steps in LOST_AFTER and observation.frames is not None:
            for situation, lost in self._lost(observation, observation.frames).items():
                with locate(f"in {situation}"):
                    blind = self._step(state, lost)
                    self.projection(blind, observation.ego)
                with locate(f"after {situation}"):
                    self.projection(self._step(blind, observation), observation.ego)
        if state.steps == DRIVES_AFTER:
            for situation, ego in self._driving().items():
                moving = replace(observation, ego=ego, shown=replace(observation.shown, ego=ego))
                with locate(f"on a car {situation}"):
                    self.projection(self._step(state, moving), ego)
        return after

    def _driving(self) -> dict[str, Ego | None]:
        like = self.symbol.projector.target
        samples = tuple(Sample(sensor, 0.05, 0.06, like.new_tensor(values)) for sensor, values in SENSED.items())
        wheels = tuple(each for each in samples if each.sensor == "wheels")
        return {
            "that moves": ego_of(samples, None, 0.1, 1 / 60),
            "of which nothing measures attitude and rates, which are NaN in ego": ego_of(wheels, None, 0.1, 1 / 60),
        }

    def _step(self, state: CheckState, observation: Observation) -> CheckState:
        return CheckState(pure_state(self.own, "step", {"state": state.inner, "observation": observation}), state.steps + 1)

    def _lost(self, observation: Observation, frames: Images) -> dict[str, Observation]:
        """Observations of the same light without frames, and with frames that do not show it."""
        sensor, shown, dark = self.symbol.sensor, observation.shown, (frames[1], frames[1])
        no_frame, nothing = (sensor.measure(each, shown.projection, shown.lights) for each in (None, dark))
        return {
            "a step without frames (observation.frames is None)": replace(observation, measurement=no_frame, frames=None),
            "a step whose frames do not show the symbol": replace(observation, measurement=nothing, frames=dark),
        }

    def _check(self, projection: Any) -> None:
        """Raise LuxloopError if a projection cannot be shown."""
        if not isinstance(projection, ProjectionCommand):
            raise LuxloopError(f"gives a {type(projection).__name__}; return luxloop.ProjectionCommand(pose), with the pose [4]")
        like = self.symbol.projector.target
        check_tensor(projection.pose, like, (4,), "pose")
        x, y, roll, pitch = projection.pose.tolist()
        if max(abs(roll), abs(pitch)) > STEEPEST:
            raise LuxloopError(
                f"pose has roll {roll:.3g} and pitch {pitch:.3g} rad, more than 45 deg; convert degrees with torch.deg2rad, or {REMEDY}"
            )
        if not 1 < x <= FARTHEST_M[0] or abs(y) > FARTHEST_M[1]:
            raise LuxloopError(f"pose has x {x:.3g} and y {y:.3g} m, where no lamp can draw; {REMEDY}")
        for name, value, shape in (("z", projection.z, ()), ("shape", projection.shape, (4,)), ("aim", projection.aim, (2,))):
            if value is not None:
                check_tensor(value, like, shape, name)
        if projection.warp is not None:
            self._check_warp(projection.warp, like)
        for module, u in zip(self.symbol.projector.modules, projection.raw or (), strict=False):
            check_tensor(u, like, (module.pixel_controller.headlight.n_pixels,), f"raw of {module.name}")
            _check_share(u, "raw")

    def _check_warp(self, warp: Warp, like: Tensor) -> None:
        *_, rows, columns = warp.dimming.shape
        modules = len(warp.dimming) if len(warp.dimming) in (1, len(self.symbol.projector.modules)) else 1
        check_tensor(warp.dimming, like, (modules, rows, columns), "warp.dimming")
        check_tensor(warp.source, like, (modules, 2, rows, columns), "warp.source")
        _check_share(warp.dimming, "warp.dimming")


def _check_share(values: Tensor, what: str) -> None:
    low, high = (float(each) for each in torch.aminmax(values))
    if low < 0 or high > 1:
        raise LuxloopError(f"{what} reaches from {low:.3g} to {high:.3g}; give shares of 0..1, with clamp(0, 1) say")
