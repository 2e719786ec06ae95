"""A bank of PID loops as tensors: explicit time step, filtered derivative, output and rate limits, anti-windup, bumpless reset.

The output is `kp * error + ...`; for a plant of negative gain, negate the error. All time constants and rates are in the time unit of `dt`:
seconds, or control steps with `dt = 1`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.params import NotNegative, Params, Real, in_order

Form = Literal["position", "incremental"]
UNLIMITED = {"lower": -math.inf, "upper": math.inf, "rate_limit": math.inf, "tracking_time": math.inf}  # defaults of parameters


class PidParams(Params):
    """Parameters of one loop; by default limits are infinite and options off."""

    kp: Real = Field(0.0, description="proportional gain")
    ki: Real = Field(0.0, description="integral gain, per unit of time")
    kd: Real = Field(0.0, description="derivative gain, in units of time")
    derivative_time: NotNegative = Field(0.0, description="time constant of the derivative's low-pass filter, 0 for none")
    lower: float | None = Field(None, ge=-1e9, le=1e9, description="smallest output")
    upper: float | None = Field(None, ge=-1e9, le=1e9, description="largest output")
    rate_limit: float | None = Field(None, gt=0, le=1e6, description="largest change of the output per unit of time")
    tracking_time: float | None = Field(
        None, gt=0, le=1e6, description="time constant of the back-calculation that unwinds the integral at a limit"
    )
    form: Form = Field("position", description="whether the PID sum is the output (position) or the output's rate of change (incremental)")

    _limits_in_order = in_order("lower", "upper")


@dataclass(frozen=True)
class PidGains:
    """Gains of a bank of n loops, tensors `[..., n]` or broadcastable. Infinite limits are off; so is anti-windup with a tracking time of
    infinity or 0.
    """

    kp: Tensor
    ki: Tensor
    kd: Tensor
    derivative_time: Tensor
    lower: Tensor
    upper: Tensor
    rate_limit: Tensor
    tracking_time: Tensor
    form: Form = "position"


@dataclass(frozen=True)
class PidState:
    """State of a bank, each `[..., n]`.

    integral: integral term of the PID sum, including its gain, so that gains can change without a jump. derivative: filtered derivative of
    the error. previous_error, output: of the last step. initialised: bool, false between a reset and the first step.
    """

    integral: Tensor
    derivative: Tensor
    previous_error: Tensor
    output: Tensor
    initialised: Tensor


def pid_gains(loops: Sequence[PidParams], dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu") -> PidGains:
    """Gains `[n]` of n loops.

    Raises: LuxloopError if the loops' forms differ.
    """
    forms = {loop.form for loop in loops}
    if len(forms) != 1:
        raise LuxloopError(f"a bank of PIDs needs one form, got {sorted(forms)}: give every loop the same 'form'")

    def bank(name: str) -> Tensor:
        values = (getattr(loop, name) for loop in loops)
        return torch.tensor([UNLIMITED[name] if value is None else value for value in values], dtype=dtype, device=device)

    return PidGains(**{name: bank(name) for name in PidParams.model_fields if name != "form"}, form=loops[0].form)


def pid_reset(gains: PidGains, output: Tensor) -> PidState:
    """State `[..., n]` from which the next step continues without a jump from `output` `[..., n]`.

    The first step has no derivative. In position form it returns `output` itself, whatever the error: the integral absorbs the difference
    (permanently if ki is 0). In incremental form it moves from `output` by the proportional and integral parts.
    """
    output = output.expand(np.broadcast_shapes(output.shape, gains.kp.shape))  # torch.broadcast_shapes would import sympy
    zero = torch.zeros_like(output)
    return PidState(zero, zero, zero, output, torch.zeros_like(output, dtype=torch.bool))


def pid_step(state: PidState, error: Tensor, dt: float | Tensor, gains: PidGains) -> PidState:
    """Advance the bank (T 9.4.1, 9.4.3) by `dt` with errors `[..., n]`: the new state, with its limited output.

    Backward Euler: `C(z) = kp + ki dt z / (z - 1) + kd (z - 1) / ((T + dt) z - T)` with T the derivative time; in incremental form times
    `dt z / (z - 1)`. Limits hold even after a reset outside them, where they override the rate limit.
    """
    previous_error = torch.where(state.initialised, state.previous_error, error)
    derivative = (gains.derivative_time * state.derivative + error - previous_error) / (gains.derivative_time + dt)
    integral = state.integral + gains.ki * error * dt
    if gains.form == "position":
        integral = torch.where(state.initialised, integral, state.output - gains.kp * error)
    pid_sum = gains.kp * error + integral + gains.kd * derivative
    wanted = pid_sum if gains.form == "position" else state.output + dt * pid_sum

    reach = gains.rate_limit * dt
    output = torch.clamp(wanted, state.output - reach, state.output + reach)
    output = torch.clamp(output, gains.lower, gains.upper)

    # Tracking faster than one step would overshoot.
    unwind = torch.where(gains.tracking_time > 0, (dt / gains.tracking_time).clamp(max=1.0), 0.0)
    excess = output - wanted
    integral = integral + unwind * (excess if gains.form == "position" else excess / dt)
    return PidState(integral, derivative, error, output, torch.ones_like(state.initialised))
