"""Feedback laws: the thesis' PIDs (T 9.4), Gauss-Newton on the features, and a model reference.

The latter two correct the target's pose by four numbers. Gauss-Newton integrates `-J^-1 (measured features - target features)`. The model
reference models the road as a constant pose offset, `J^-1 (measured features - features of the same light on a flat road)`, and subtracts
it. As it compares with the light of the measured frames, neither latency nor a cut-off symbol affects it.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.controllers.pid import PidGains, PidParams, PidState, pid_gains, pid_reset, pid_step
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Observation, SymbolSensor
from luxloop.controllers.symbol.stages import StagedParams
from luxloop.perception import appearance
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world.params import Degrees, Length, Metres, Params, PositiveShare, Real


class PoseParams(StagedParams):
    """Limits of y, roll and pitch, and the number of losses before a reset."""

    y_range_m: tuple[Metres, Metres] = Field((-6.0, 6.0), description="limits of y or its correction")
    roll_range_deg: tuple[Degrees, Degrees] = Field((-7.0, 7.0), description="limits of the roll or its correction")
    pitch_range_deg: tuple[Degrees, Degrees] = Field((-4.0, 2.2), description="limits of the pitch or its correction, nose down positive")
    losses_to_reset: int = Field(
        2, ge=1, le=1_000_000, description="consecutive failed extractions after which the flat-road primitive is shown again"
    )


class FeedbackParams(PoseParams):
    """Common parameters of Gauss-Newton and model reference."""

    dof: Literal["z", "x"] = Field("z", description="coordinate of the rectangle that moves the symbol along the road: height z or place x")
    gain: PositiveShare = Field(0.7, description="share of the computed correction applied in a step")
    shift_range_m: tuple[Metres, Metres] = Field(
        (-9.0, 23.0), description="limits of the correction along x, or of the equivalent of a height correction"
    )


class GaussNewtonParams(FeedbackParams):
    """Gauss-Newton steps on four features of the symbol: the full Jacobian instead of four gains."""

    name: Literal["gauss_newton"] = "gauss_newton"


class ModelReferenceParams(FeedbackParams):
    """Corrects by the difference to the features of the same light on a flat road, so that latency has no effect."""

    name: Literal["model_reference"] = "model_reference"


@dataclass(frozen=True)
class FeedbackState:
    """State. correction: `[..., 4]` of x or z in m, y in m, roll, pitch in rad. losses: `[...]` int64, failed extractions in a row.

    pose: `[..., 4]`, start pose; None after the first step.
    """

    correction: Tensor
    losses: Tensor
    pose: Tensor | None = None


@dataclass(frozen=True, eq=False)
class Feedback:
    """Gauss-Newton or model reference.

    target: `[4]`, the flat-road pose. m_per_z: displacement in m for 1 m of height. inverse: `[4, 4]`, of the flat model's Jacobian.
    low, high: `[..., 4]`, limits of the correction. gain: `[..., 1]`, losses_to_reset: `[...]`, as in params, and per copy in a batch.
    """

    params: FeedbackParams
    sensor: SymbolSensor
    target: Tensor
    m_per_z: float
    inverse: Tensor
    low: Tensor
    high: Tensor
    gain: Tensor
    losses_to_reset: Tensor

    @classmethod
    def prepare(cls, params: FeedbackParams, sensor: SymbolSensor) -> "Feedback":
        """Measure the flat model's Jacobian by central differences."""
        target = sensor.projector.target
        height = torch.stack([module.T_body_headlight[2, 3] for module in sensor.projector.modules]).mean()
        m_per_z = float(target[0] / height) if params.dof == "z" else 1.0
        limits = [degree.limits(params, "shift" if degree.name == "x" else None) for degree in appearance.DEGREES]
        low, high = target.new_tensor(limits).unbind(-1)
        if params.dof == "z":  # heights that cast the same light as shifts in x
            places = [max(float(target[0]) + end, 1.0) for end in params.shift_range_m]
            low[0], high[0] = (float(height * (1 - target[0] / place)) for place in places)
        probe = appearance.probes(target)
        probe[0, 0] /= m_per_z

        def expected(correction: Tensor) -> Tensor:
            projection = _command(params, target, correction)
            return sensor.render(projection, sensor.projector.draw(projection))

        columns = [(expected(h) - expected(-h)) / (2 * h.sum()) for h in probe]
        inverse = torch.linalg.pinv(torch.stack(columns, -1).double()).to(target)
        losses = torch.tensor(params.losses_to_reset, device=target.device)
        return cls(params, sensor, target, m_per_z, inverse, low, high, target.new_tensor([params.gain]), losses)

    def start(self, pose: Tensor) -> FeedbackState:
        """State that shows the pose `[..., 4]` first."""
        correction = pose - self.target
        if self.params.dof == "z":
            height = self.target[0] / self.m_per_z
            correction = torch.cat([height * (1 - self.target[:1] / pose[..., :1]), correction[..., 1:]], -1)
        losses = torch.zeros(pose.shape[:-1], dtype=torch.int64, device=pose.device)
        return FeedbackState(correction.clamp(self.low, self.high), losses, pose)

    def projection(self, state: FeedbackState, ego: Ego | None) -> ProjectionCommand:
        """The undistorted symbol at the corrected target."""
        return _command(self.params, self.target, state.correction) if state.pose is None else ProjectionCommand(state.pose)

    def step(self, state: FeedbackState, observation: Observation) -> FeedbackState:
        """Correct by the measurement; hold while the symbol is lost; show the flat-road primitive after repeated loss."""
        errors = observation.measurement.errors
        usable, losses = _count(state.losses, observation.measurement.code, errors)
        offset = torch.where(usable[..., None], errors, 0.0)
        if isinstance(self.params, ModelReferenceParams):
            rendered = self.sensor.render(observation.shown.projection, observation.shown.lights)
            offset = torch.where(usable[..., None], offset + self.sensor.model.target - rendered, 0.0)
            wanted = -offset @ self.inverse.T
        else:
            wanted = state.correction - offset @ self.inverse.T
        moved = torch.lerp(state.correction, wanted, self.gain).clamp(self.low, self.high)
        reset = losses >= self.losses_to_reset
        correction = torch.where(usable[..., None], moved, state.correction)
        return FeedbackState(torch.where(reset[..., None], 0.0, correction), torch.where(reset, 0, losses))


def _count(losses: Tensor, code: Tensor, errors: Tensor) -> tuple[Tensor, Tensor]:
    """Whether errors `[..., 4]` are usable, and the losses in a row `[...]`; a missing frame is not a loss."""
    usable = (code == ExtractionStatus.SEEN) & errors.isfinite().all(-1)
    return usable, torch.where(usable, 0, losses + (~usable & (code != ExtractionStatus.NO_FRAME)))


def _command(params: FeedbackParams, target: Tensor, correction: Tensor) -> ProjectionCommand:
    if params.dof == "x":
        return ProjectionCommand(target + correction)
    shift = torch.cat([torch.zeros_like(correction[..., :1]), correction[..., 1:]], -1)
    return ProjectionCommand(target + shift, correction[..., 0])


class PidTuning(Params):
    """Gains of the position loops or of the rotation loops (T 9.4.3)."""

    kp: Real = Field(examples=[0.3], description="proportional gain")
    ki: Real = Field(examples=[0.1], description="integral gain a step")
    kd: Real = Field(examples=[0.0], description="derivative gain in steps")
    tracking_steps: float | None = Field(
        None, gt=0, le=1e6, description="time constant of the anti-windup's back-calculation, none if left out"
    )


# (kp, kd) of all loops by latency in steps, the last for longer ones; ki = 0, since the incremental law integrates once without it. Of 0
# steps by `luxloop tune --robust` on flat, snowflake, speed_bump and belgian_block; of others the least robust cost of a plant of gain 1,
# which settled sooner on worlds of benchmarks/places.py with seed 5 than what 12 trials had found (2026-11-30, docs/tuning.md).
LATENCY_GAINS = ((0.35, 0.18), (0.3, 0.1), (0.24, 0.2), (0.19, 0.22))


class ThesisPidParams(PoseParams):
    """Four PIDs, by default with the gains of T 9.4.3. The limits prevent an edge-on primitive, at atan(h/x) = 2.5 deg nose-down."""

    name: Literal["thesis_pid"] = "thesis_pid"
    gain_schedule: Literal["latency"] | None = Field(
        None,
        description="what chooses the gains in each step: the measured latency, from gains tuned for it, in place of `position` and "
        "`rotation`; left out: nothing",
    )
    position: PidTuning = Field(PidTuning(kp=0.75, ki=0.5, kd=0.26, tracking_steps=1.1), description="gains of the x and y loops")
    rotation: PidTuning = Field(PidTuning(kp=0.5, ki=0.1, kd=0.1, tracking_steps=1.3), description="gains of the roll and pitch loops")
    x_range_m: tuple[Metres, Metres] = Field((8.0, 40.0), description="limits of the primitive's x")
    x_rate_m: Length = Field(1.5, description="largest move along x a step")
    y_rate_m: Length = Field(0.9, description="largest move along y a step")
    roll_rate_deg: float = Field(2.4, gt=0, le=180, description="largest turn in roll a step")
    pitch_rate_deg: float = Field(1.35, gt=0, le=180, description="largest turn in pitch a step")

    @model_validator(mode="after")
    def _one_source_of_gains(self) -> "ThesisPidParams":
        for name in ("position", "rotation"):
            if self.gain_schedule and getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f'{name}: gain_schedule = "{self.gain_schedule}" has its own gains; leave out {name} or gain_schedule')
        return self

    @property
    def schedule(self) -> list[tuple[PidTuning, PidTuning]]:
        """Gains of the position and the rotation loops by latency in steps; fixed gains are those of every latency."""
        if self.gain_schedule is None:
            return [(self.position, self.rotation)]
        return [(PidTuning(kp=kp, ki=0.0, kd=kd),) * 2 for kp, kd in LATENCY_GAINS]


@dataclass(frozen=True)
class ThesisPidState:
    """State. pid: loops x, y, roll, pitch, whose outputs are the pose `[..., 4]`. losses: `[...]` int64, failed extractions in a row."""

    pid: PidState
    losses: Tensor


@dataclass(frozen=True, eq=False)
class ThesisPid:
    """Four PIDs (T 9.4.1).

    gains: limits, and the gains at latency 0. target: the flat-road pose `[4]` (x, y in m, roll, pitch in rad). losses_to_reset: as in
    ThesisPidParams, or `[...]` per copy in a batch. later: gains by latency from one step on, the last for any longer one; empty: `gains`.
    """

    gains: PidGains
    target: Tensor
    losses_to_reset: int | Tensor
    later: tuple[PidGains, ...] = ()

    @classmethod
    def prepare(cls, params: ThesisPidParams, target: Tensor) -> "ThesisPid":
        """The PIDs of a scenario's parameters for a target pose `[4]`."""
        first, *later = (cls._bank(params, *gains, target) for gains in params.schedule)
        return cls(first, target, params.losses_to_reset, tuple(later))

    @staticmethod
    def _bank(params: ThesisPidParams, position: PidTuning, rotation: PidTuning, like: Tensor) -> PidGains:
        loops = []
        for degree in appearance.DEGREES:
            tuning, (low, high) = position if degree.unit == "m" else rotation, degree.limits(params)
            rate = degree.of_file(getattr(params, f"{degree.name}_rate_{degree.suffix}"))
            gains = tuning.model_dump(exclude={"tracking_steps"})
            loops.append(
                PidParams(**gains, tracking_time=tuning.tracking_steps, lower=low, upper=high, rate_limit=rate, form="incremental")
            )
        return pid_gains(loops, like.dtype, like.device)

    def gains_at(self, latency_steps: int) -> PidGains:
        """Gains at a measured latency."""
        return (self.gains, *self.later)[min(latency_steps, len(self.later))]

    def start(self, pose: Tensor) -> ThesisPidState:
        """State that shows the pose `[..., 4]` first."""
        return ThesisPidState(pid_reset(self.gains, pose), torch.zeros(pose.shape[:-1], dtype=torch.int64, device=pose.device))

    def projection(self, state: ThesisPidState, ego: Ego | None) -> ProjectionCommand:
        """The undistorted symbol at the outputs `[..., 4]` of the four loops."""
        return ProjectionCommand(state.pid.output)

    def step(self, state: ThesisPidState, observation: Observation) -> ThesisPidState:
        """Move the primitive against the errors; hold it while the symbol is lost; show the flat-road primitive after repeated loss.

        A missing frame is no loss: the pose is held and the loss is not counted.
        """
        seen = observation.measurement
        usable, losses = _count(state.losses, seen.code, seen.pose_error)
        reset = losses >= self.losses_to_reset
        error = torch.where(usable[..., None], -seen.pose_error, 0.0)  # zero instead of NaN, whose gradient would survive the selection
        moved = pid_step(state.pid, error, 1.0, self.gains_at(observation.latency_steps))
        pid = _where(usable[..., None], moved, state.pid)
        pid = _where(reset[..., None], pid_reset(self.gains, self.target.expand_as(pid.output)), pid)
        return ThesisPidState(pid, torch.where(reset, 0, losses))


def _where(condition: Tensor, a: PidState, b: PidState) -> PidState:
    return PidState(**{name: torch.where(condition, value, getattr(b, name)) for name, value in vars(a).items()})
