"""Kinds of actions: moves of the symbol, gains of its feedback, or the road heights for which it is drawn.

An acting controller has `size`, the number of values of an action; `limits`, `[k]` each, the smallest and largest observed values of a
state; `start(pose)`, `act(state, action)` with an action `[..., size]` in -1..1, `observation(state)`, `[..., k]`: the projected pose (x, y
in m, roll, pitch in rad) or the heights in m; `projection(state, ego)` and `step(state, observation)` as of a `SymbolController`. States
may have batch dimensions, except those of `Heights`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from luxloop.controllers.symbol.feedback import ThesisPid, ThesisPidParams, ThesisPidState
from luxloop.controllers.symbol.heights.feedforward import CELL_M, region_around
from luxloop.controllers.symbol.heights.height_map import Belief, HeightMap
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.road_shape import HERE
from luxloop.controllers.symbol.sensing.symbol_sensor import Observation, SymbolSensor
from luxloop.perception.appearance import DEGREES
from luxloop.perception.camera import camera_view
from luxloop.perception.egomotion import Ego

GAIN_SPAN = 4.0  # factor on a gain by an action of 1
HEIGHT_CELLS = (8, 4)  # cells of the height map along and across the road
HEIGHT_RATE_M, HEIGHT_RANGE_M = 0.03, 0.25  # largest change of a cell's height in a step, largest height


@dataclass(frozen=True, eq=False)
class Moves:
    """Actions that move the symbol in all degrees of freedom; 1 is the largest move of `law` in a step."""

    law: ThesisPid

    @property
    def size(self) -> int:
        return len(DEGREES)

    @property
    def limits(self) -> tuple[Tensor, Tensor]:
        return self.law.gains.lower, self.law.gains.upper

    def start(self, pose: Tensor) -> Tensor:
        return pose.clamp(*self.limits)

    def act(self, state: Tensor, action: Tensor) -> Tensor:
        return (state + action * self.law.gains.rate_limit).clamp(*self.limits)

    def observation(self, state: Tensor) -> Tensor:
        return state

    def projection(self, state: Tensor, ego: Ego | None) -> ProjectionCommand:
        return ProjectionCommand(state)

    def step(self, state: Tensor, observation: Observation) -> Tensor:
        return state


@dataclass(frozen=True)
class GainsState:
    """State of `Gains`.

    law: state of the feedback. factors: `[..., 3, 4]`, on kp, ki and kd (rows) of x, y, roll and pitch (columns).
    """

    law: ThesisPidState
    factors: Tensor


@dataclass(frozen=True, eq=False)
class Gains:
    """Actions that multiply kp, ki and kd of position, then of rotation, of the feedback `law` by GAIN_SPAN ** action."""

    law: ThesisPid

    @property
    def size(self) -> int:
        return 6

    @property
    def limits(self) -> tuple[Tensor, Tensor]:
        return self.law.gains.lower, self.law.gains.upper

    def start(self, pose: Tensor) -> GainsState:
        return GainsState(self.law.start(pose.clamp(*self.limits)), pose.new_ones(*pose.shape[:-1], 3, 4))

    def act(self, state: GainsState, action: Tensor) -> GainsState:
        factors = (GAIN_SPAN ** action.unflatten(-1, (2, 3))).repeat_interleave(2, -2).mT  # [..., 3, 4]
        return replace(state, factors=factors)

    def observation(self, state: GainsState) -> Tensor:
        return state.law.pid.output

    def projection(self, state: GainsState, ego: Ego | None) -> ProjectionCommand:
        return self.law.projection(state.law, ego)

    def step(self, state: GainsState, observation: Observation) -> GainsState:
        kp, ki, kd = state.factors.unbind(-2)
        gains = self.law.gains_at(observation.latency_steps)
        scaled = replace(self.law, gains=replace(gains, kp=gains.kp * kp, ki=gains.ki * ki, kd=gains.kd * kd), later=())
        return replace(state, law=scaled.step(state.law, observation))


@dataclass(frozen=True, eq=False)
class Heights:
    """Actions that change the road heights over the plane z = 0 for which the symbol is drawn at its target.

    The heights are HEIGHT_CELLS, the far row first, each row from left to right. An action changes each by at most HEIGHT_RATE_M, within
    HEIGHT_RANGE_M.
    """

    sensor: SymbolSensor

    @property
    def size(self) -> int:
        return HEIGHT_CELLS[0] * HEIGHT_CELLS[1]

    @property
    def limits(self) -> tuple[Tensor, Tensor]:
        most = self.sensor.projector.target.new_full((self.size,), HEIGHT_RANGE_M)
        return -most, most

    def start(self, pose: Tensor) -> Tensor:
        return pose.new_zeros(HEIGHT_CELLS)

    def act(self, state: Tensor, action: Tensor) -> Tensor:
        return (state + HEIGHT_RATE_M * action.view(HEIGHT_CELLS)).clamp(-HEIGHT_RANGE_M, HEIGHT_RANGE_M)

    def observation(self, state: Tensor) -> Tensor:
        return state.flatten()

    def projection(self, state: Tensor, ego: Ego | None) -> ProjectionCommand:
        region = region_around(self.sensor)
        cells = [round((far - near) / CELL_M) for far, near in ((region.x_far_m, region.x_near_m), (region.y_left_m, region.y_right_m))]
        heights = interpolate(state[None, None], cells, mode="bilinear", align_corners=True)[0, 0]
        eye = camera_view(self.sensor.camera).origin
        relief = HeightMap(region, eye.float(), heights, torch.ones_like(heights))
        return Belief(relief, HERE, HERE).draw(self.sensor.projector)

    def step(self, state: Tensor, observation: Observation) -> Tensor:
        return state


def _law(sensor: SymbolSensor, params: Any) -> ThesisPid:
    """The scenario's thesis_pid, or thesis_pid with its defaults if the scenario has another controller."""
    return ThesisPid.prepare(params if isinstance(params, ThesisPidParams) else ThesisPidParams(), sensor.projector.target)


Acting = Moves | Gains | Heights
ACTIONS: Mapping[str, Callable[[SymbolSensor, Any], Acting]] = {
    "moves": lambda sensor, params: Moves(_law(sensor, params)),
    "gains": lambda sensor, params: Gains(_law(sensor, params)),
    "heights": lambda sensor, params: Heights(sensor),
}
