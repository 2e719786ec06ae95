"""Linear-quadratic-Gaussian control of a symbol's pose, at any latency.

    luxloop new --like lqg.py
    luxloop run snowflake --controller lqg:Lqg --set camera.latency_steps=2

In each of x, y, roll and pitch the error of the symbol is seen as e = p + d + noise: p is the shown pose from the target, d what the road
does, a random walk. A Kalman filter estimates d from the pose that the frames show, however late they are. The command moves p by
u = -K (p + d), which minimises the sum of (p + d)^2 + effort u^2.
"""

from dataclasses import dataclass

import torch
from scipy.linalg import solve_discrete_are
from torch import Tensor

from luxloop import Ego, ExtractionStatus, Observation, ProjectionCommand, SymbolSensor


@dataclass(frozen=True)
class State:
    """pose: `[4]`. road: `[4]`, estimate of d. variance: of the estimate, relative to that of the noise."""

    pose: Tensor
    road: Tensor
    variance: float


class Lqg:
    """drift: standard deviation of d's change in a step, relative to that of the noise. effort: weight of moves against errors."""

    def __init__(self, sensor: SymbolSensor, drift: float = 1.0, effort: float = 0.2) -> None:
        self.target, self.drift = sensor.projector.target, drift
        P = solve_discrete_are([[1.0]], [[1.0]], [[1.0]], [[effort]])[0, 0]  # of an integrator
        self.K = float(P / (P + effort))

    def start(self, pose: Tensor) -> State:
        return State(pose, torch.zeros_like(pose), 1e3)

    def projection(self, state: State, ego: Ego | None) -> ProjectionCommand:
        return ProjectionCommand(state.pose)

    def step(self, state: State, observation: Observation) -> State:
        road, variance = state.road, state.variance + self.drift**2
        if observation.measurement.code == ExtractionStatus.SEEN:
            innovation = observation.measurement.pose_error - (observation.shown.projection.pose - self.target) - road
            gain = variance / (variance + 1)
            road, variance = road + gain * innovation, (1 - gain) * variance
        return State(state.pose - self.K * (state.pose - self.target + road), road, variance)
