"""Image-based visual servoing: the interaction matrix is learnt from what the symbol's own moves do to its features.

    luxloop new --like visual_servo.py
    luxloop run snowflake --controller visual_servo:VisualServo

With the pose p and the error e of the features, in the pose's units, the law is p <- p - gain J^-1 e. J starts as the flat road's, which is
1 in these units; each move dp that shows the change de corrects it (Broyden): J <- J + (de - J dp) dp^T / (dp^T dp).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop import Ego, ExtractionStatus, Observation, ProjectionCommand, SymbolSensor


@dataclass(frozen=True)
class State:
    """pose: `[4]`. J: `[4, 4]`, interaction matrix. before: `[2, 4]`, shown pose and error of the last observation, None at first."""

    pose: Tensor
    J: Tensor
    before: Tensor | None = None


class VisualServo:
    """gain: share of the error taken off a step. learning: share of a secant that is learnt. scale: 1 of the pose, m and rad."""

    def __init__(self, sensor: SymbolSensor, gain: float = 0.7, learning: float = 1.0) -> None:
        self.gain, self.learning = gain, learning
        self.target = sensor.projector.target
        self.scale = self.target.new_tensor([0.3, 0.1, 0.02, 0.01])

    def start(self, pose: Tensor) -> State:
        return State(pose, torch.eye(4).to(pose))

    def projection(self, state: State, ego: Ego | None) -> ProjectionCommand:
        return ProjectionCommand(state.pose)

    def step(self, state: State, observation: Observation) -> State:
        if observation.measurement.code != ExtractionStatus.SEEN:
            return state
        now = torch.stack([observation.shown.projection.pose, observation.measurement.pose_error]) / self.scale
        J = state.J
        if state.before is not None:
            dp, de = now - state.before
            if dp.norm() > 0.1:
                J = J + self.learning * torch.outer(de - J @ dp, dp) / (dp @ dp)
        move = -self.gain * (torch.linalg.pinv(J, rtol=0.1) @ now[1])
        limit = 10.0
        move = move * (limit / move.norm().clamp(min=limit))
        return State((now[0] + move) * self.scale, J, now)
