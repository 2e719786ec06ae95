"""The thesis' controller (T 9.4): four PIDs on position and rotation of the symbol's primitive.

The gains fit an incremental law with a time step of one control step: each step moves the primitive by the negated PID sum of the error,
and an error is divided by its own plant gain, so that one metre of error asks for one metre of primitive.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.pid import PidGains, PidParams, PidState, pid_gains, pid_reset, pid_step
from luxloop.controllers.symbol.laws.stages import StagedParams
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import Observation
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world.params import Degrees, Metres, Params


class PidTuning(Params):
    """Gains of one kind of loop (T 9.4.3)."""

    kp: float = Field(ge=-1e6, le=1e6, examples=[0.3], description="proportional gain")
    ki: float = Field(ge=-1e6, le=1e6, examples=[0.1], description="integral gain a step")
    kd: float = Field(ge=-1e6, le=1e6, examples=[0.0], description="derivative gain in steps")
    tracking_steps: float | None = Field(
        None, gt=0, le=1e6, description="time constant of the anti-windup's back-calculation, none if left out"
    )


class ThesisPidParams(StagedParams):
    """Four PIDs with the gains of T 9.4.3. Limits keep the primitive from turning edge-on, as at atan(h/x) = 2.5 deg nose-down."""

    name: Literal["thesis_pid"] = "thesis_pid"
    position: PidTuning = Field(PidTuning(kp=0.75, ki=0.5, kd=0.26, tracking_steps=1.1), description="gains of the x and y loops")
    rotation: PidTuning = Field(PidTuning(kp=0.5, ki=0.1, kd=0.1, tracking_steps=1.3), description="gains of the roll and pitch loops")
    x_range_m: tuple[Metres, Metres] = Field((8.0, 40.0), description="limits of the primitive's x")
    y_range_m: tuple[Metres, Metres] = Field((-6.0, 6.0), description="limits of the primitive's y")
    roll_range_deg: tuple[Degrees, Degrees] = Field((-7.0, 7.0), description="limits of the primitive's roll")
    pitch_range_deg: tuple[Degrees, Degrees] = Field((-4.0, 2.2), description="limits of the primitive's pitch, nose down positive")
    x_rate_m: float = Field(1.5, gt=0, le=10_000, description="largest move along x a step")
    y_rate_m: float = Field(0.9, gt=0, le=10_000, description="largest move along y a step")
    roll_rate_deg: float = Field(2.4, gt=0, le=180, description="largest turn in roll a step")
    pitch_rate_deg: float = Field(1.35, gt=0, le=180, description="largest turn in pitch a step")
    losses_to_reset: int = Field(
        2, ge=1, le=1_000_000, description="consecutive failed extractions after which the flat-road primitive is shown again"
    )


@dataclass(frozen=True)
class ThesisPidState:
    """pid: the four loops x, y, roll, pitch, whose outputs are the pose `[..., 4]`. losses: `[...]` int64, failed extractions in a row."""

    pid: PidState
    losses: Tensor


@dataclass(frozen=True, eq=False)
class ThesisPid:
    """Four PIDs (T 9.4.1); target: the flat-road pose `[4]` (x, y in m, roll, pitch in rad). losses_to_reset: as in its parameters, `[...]`
    where it differs in a batch.
    """

    gains: PidGains
    target: Tensor
    losses_to_reset: int | Tensor

    @classmethod
    def prepare(cls, params: ThesisPidParams, target: Tensor) -> "ThesisPid":
        """target: as above."""
        radians = math.radians
        loops = [
            (params.position, params.x_range_m, params.x_rate_m),
            (params.position, params.y_range_m, params.y_rate_m),
            (params.rotation, tuple(map(radians, params.roll_range_deg)), radians(params.roll_rate_deg)),
            (params.rotation, tuple(map(radians, params.pitch_range_deg)), radians(params.pitch_rate_deg)),
        ]
        gains = pid_gains(
            [
                PidParams(
                    kp=tuning.kp,
                    ki=tuning.ki,
                    kd=tuning.kd,
                    tracking_time=tuning.tracking_steps,
                    lower=low,
                    upper=high,
                    rate_limit=rate,
                    form="incremental",
                )
                for tuning, (low, high), rate in loops
            ],
            target.dtype,
            target.device,
        )
        return cls(gains, target, params.losses_to_reset)

    def start(self, pose: Tensor) -> ThesisPidState:
        """State that shows the pose `[..., 4]` first."""
        return ThesisPidState(pid_reset(self.gains, pose), torch.zeros(pose.shape[:-1], dtype=torch.int64, device=pose.device))

    def projection(self, state: ThesisPidState, ego: Ego | None) -> ProjectionCommand:
        """The symbol as it is at the outputs of the four loops, `[..., 4]`."""
        return ProjectionCommand(state.pid.output)

    def step(self, state: ThesisPidState, observation: Observation) -> ThesisPidState:
        """Move the primitive against the errors; hold it while the symbol is lost; show the flat-road primitive after repeated loss.

        A missing frame says nothing about the symbol: the pose is held and the loss is not counted.
        """
        seen = observation.measurement
        usable = (seen.code == ExtractionStatus.SEEN) & seen.pose_error.isfinite().all(-1)
        lost = ~usable & (seen.code != ExtractionStatus.NO_FRAME)
        losses = torch.where(usable, 0, state.losses + lost)
        reset = losses >= self.losses_to_reset
        error = torch.where(usable[..., None], -seen.pose_error, 0.0)  # not NaN, whose gradient would survive the choice below
        moved, _ = pid_step(state.pid, error, 1.0, self.gains)
        pid = _where(usable[..., None], moved, state.pid)
        pid = _where(reset[..., None], pid_reset(self.gains, self.target.expand_as(pid.output)), pid)
        return ThesisPidState(pid, torch.where(reset, 0, losses))


def _where(condition: Tensor, a: PidState, b: PidState) -> PidState:
    return PidState(**{name: torch.where(condition, value, getattr(b, name)) for name, value in vars(a).items()})
