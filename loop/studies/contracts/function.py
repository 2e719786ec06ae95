"""Contract of a user's own lighting function."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from luxloop.controllers.functions.own import KEY, CheckedFunction, OwnFunction, check_primitives, function_of
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.situation import Situation
from luxloop.loop.simulation.result import StepResult
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.contracts.values import check_calls, name_of, pure, pure_state, world
from luxloop.world.errors import LuxloopError, locate

Result = TypeVar("Result")
CALLS = {"primitives": ("now",)}
ADAPTIVE_CALLS = {"start": (), "step": ("state", "now"), "adapted": ("state", "now"), "base_share": ("state",)}
NAME = "checked"
SCENARIO = """
name = "check_function"
steps = 5
rate_hz = 10.0
camera = { width_px = 320, height_px = 180, oversampling = 1 }
headlight.model = "hd84"
light.ambient_lx = 0.02
renderer = "raycast"
lighting.base.beam = "low"
vehicle.course = [{ speed_m_s = 0.0 }, { time_s = 0.5, speed_m_s = 1.5, curvature_1_m = 0.01 }]
conditions = [{}, { time_s = 0.2, wet = true, street_lit = true }]
[[objects]]
kind = "pedestrian"
name = "walker"
appears_s = 0.05
vanishes_s = 0.35
track = [{ position_m = [20.0, 2.0, 0.0] }]
[[objects]]
kind = "car"
name = "car"
appears_s = 0.05
vanishes_s = 0.35
track = [{ position_m = [28.0, -2.0, 0.0], yaw_deg = 180.0 }]
"""


def check_function(function: type, options: Mapping[str, Any] | None = None, device: str = "auto") -> None:
    """Check your own lighting function against the contract of `[functions.NAME]`, in a few seconds.

    function: the class, from which a scenario makes `function(**options)`. options: those of `[functions.NAME]`. device: "auto", "cpu" or
    "cuda", of the lamps; a situation lies on the CPU.

    The check runs 5 steps at 10 Hz: the car stands on an empty road, then drives round a bend, wet and under street lamps from 0.2 s on; a
    pedestrian and another car exist from the second step to the fourth. Each step is repeated without objects. Raises LuxloopError with
    likely cause and remedy if `primitives`, `commands` if defined, or one of `start`, `step`, `adapted` and `base_share` of an adaptive
    function is missing, fails, changes its arguments, or gives different results for the same arguments; if a state is no data, or a share
    of the base beam is not within 0..1; if the result is no list of primitives from `rectangle`, finite and with possible setpoints; and if
    no primitive changes the light.
    """
    name, simulation = name_of(function), world(SCENARIO, device)
    with locate("check_function"):
        made = function_of(function, OwnFunction(kind=name, options=dict(options or {})))
        calls = ADAPTIVE_CALLS if made.adaptive else CALLS
        check_calls(made.own, calls | ({"commands": ("now",)} if made.commanding else {}))
        watched = WatchedFunction(made.own, made.adaptive, made.commanding)
        results = _steps(replace(simulation, planner=replace(simulation.planner, functions={NAME: watched})))
        if made.commanding:
            for each in results:
                _twice(lambda now: pure(made.own, "commands", {"now": now}, "commands"), each.now)
        drawn = {k: each.plan.primitives.origin[0] for k, each in enumerate(results) if each.plan.primitives}
        bare = _steps(simulation) if drawn else []
        if drawn and all(one.equal(other) for k in drawn for one, other in zip(results[k].lights, bare[k].lights, strict=True)):
            corner = [round(value, 3) for value in next(iter(drawn.values())).tolist()]
            raise LuxloopError(
                f"functions.{NAME}: {KEY}: {name}: its primitives change no lamp's light, such as one with a corner at {corner} m; "
                "places are in m in the world, from the car's frame (x ahead, y left, z up) by now.T_world_vehicle; normals, by default "
                "d1 x d2, point to the lamps; primitives thinner than the spacing of the lamps' rays are missed"
            )


def _steps(simulation: Simulation) -> list[StepResult]:
    state, results = simulation.start(), []
    for _ in range(simulation.scenario.steps):
        state, result = simulation.step(state)
        results.append(result)
    return results


class WatchedFunction(CheckedFunction):
    """A lighting function whose calls are checked."""

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """Checked primitives."""
        return _twice(lambda now: check_primitives(pure(self.own, "primitives", {"now": now}, "primitives"), self.own, "primitives"), now)

    def start(self) -> Any:
        """Initial state, checked to be data."""
        return pure_state(self.own, "start", {})

    def step(self, state: Any, now: Situation) -> Any:
        """State after a frame, checked to be data."""
        return _twice(lambda now: pure_state(self.own, "step", {"state": state, "now": now}), now)

    def adapted(self, state: Any, now: Situation) -> tuple[Primitives, ...]:
        """Checked primitives."""
        own = self.own
        return _twice(lambda now: check_primitives(pure(own, "adapted", {"state": state, "now": now}, "primitives"), own, "adapted"), now)


def _twice(call: Callable[[Situation], Result], now: Situation) -> Result:
    """Result of a call, which is repeated without objects."""
    with locate("where now.objects is empty"):
        call(replace(now, objects=()))
    return call(now)
