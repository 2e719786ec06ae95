"""What the vehicle's own sensors say of its motion: odometry and inertial sensors, with noise, bias and delay."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from world.frames import pose, rotation
from world.params import Params
from world.scene.vehicle import Motion, body_pose

NOISE_KEY = 3  # beside the camera's generators of a step


class SensorParams(Params):
    """Errors of odometry and inertial sensors; all zero: they tell the truth at once."""

    speed_scale: float = Field(1.0, gt=0, le=2, description="measured speed for each m/s driven: a worn tyre shows more")
    speed_noise_m_s: float = Field(0.0, ge=0, le=10, description="standard deviation of the measured speed")
    yaw_rate_bias_deg_s: float = Field(0.0, ge=-10, le=10, description="added to the measured yaw rate")
    yaw_rate_noise_deg_s: float = Field(0.0, ge=0, le=10, description="standard deviation of the measured yaw rate")
    heave_noise_m: float = Field(0.0, ge=0, le=1, description="standard deviation of the body's measured height")
    roll_bias_deg: float = Field(0.0, ge=-5, le=5, description="added to the measured roll")
    pitch_bias_deg: float = Field(0.0, ge=-5, le=5, description="added to the measured pitch")
    angle_noise_deg: float = Field(0.0, ge=0, le=5, description="standard deviation of measured roll and pitch")
    rate_noise_deg_s: float = Field(0.0, ge=0, le=10, description="standard deviation of measured roll and pitch rates")
    delay_steps: int = Field(0, ge=0, le=10, description="control steps by which all of this is known late")


EXACT: Final = SensorParams()


STANDS_M_S = 0.1  # slower than anybody drives, and more than the noise of a speed sensor at rest


@dataclass(frozen=True)
class Ego:
    """The vehicle's motion as its sensors measured it.

    time_s: of the measurement. age_s: from then until the step's on frame is exposed. period_s: the control period. attitude: `[3]`, heave
    in m, roll and pitch (nose down) in rad of the body over the ground. rates: `[3]`, the same a second. speed_m_s: `[]`, of the rear axle,
    mean of the last control period. yaw_rate_rad_s: `[]`, to the left positive, mean of the last control period. pivot_x_m: x in the ground
    frame about which the body rolls and pitches. rear_x_m: x of the rear axle there.
    """

    time_s: float
    age_s: float
    period_s: float
    attitude: Tensor
    rates: Tensor
    speed_m_s: Tensor
    yaw_rate_rad_s: Tensor
    pivot_x_m: float
    rear_x_m: float

    @property
    def exposed_s(self) -> float:
        """When the exposure begins for which this is the newest that is known."""
        return self.time_s + self.age_s

    @property
    def stands(self) -> bool:
        """Whether the vehicle stands, as far as its sensors can say."""
        return bool(self.speed_m_s.abs() < STANDS_M_S)

    @property
    def T_ground_body(self) -> Tensor:
        """Measured pose `[4, 4]` of the body in the ground frame."""
        return body_pose(self.attitude, self.pivot_x_m)

    def way(self, duration_s: float) -> Tensor:
        """Pose `[4, 4]` of the ground frame after `duration_s` s at this speed and yaw rate, in that at their beginning."""
        turn, length = self.yaw_rate_rad_s * duration_s, self.speed_m_s * duration_s
        chord = length * torch.sinc(turn / (2 * torch.pi))
        zero = torch.zeros_like(turn)
        x = chord * (turn / 2).cos() + self.rear_x_m * (1 - turn.cos())
        y = chord * (turn / 2).sin() - self.rear_x_m * turn.sin()
        return pose(torch.stack([x, y, zero]), rotation(zero, zero, turn))

    def after(self, duration_s: float) -> "Ego":
        """The attitude predicted `duration_s` s ahead, linearly; `ego.after(ego.age_s)` is that of the step's on frame."""
        return replace(
            self, time_s=self.time_s + duration_s, age_s=self.age_s - duration_s, attitude=self.attitude + self.rates * duration_s
        )


def measured(motion: Motion, params: SensorParams, step: int, period_s: float, seed: int, like: Tensor) -> Ego:
    """What is known at a step of the motion, on the device and in the dtype of `like`; no state is carried from step to step."""
    at = max(step - params.delay_steps, 0)
    now, before = motion.at(at * period_s), motion.at((at - 1) * period_s)
    angles = np.deg2rad([params.angle_noise_deg] * 2)
    spread = np.array([params.speed_noise_m_s, np.deg2rad(params.yaw_rate_noise_deg_s), params.heave_noise_m, *angles])
    spread = np.concatenate([spread, [0.0], np.deg2rad([params.rate_noise_deg_s] * 2)])
    noise = spread * np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(at, NOISE_KEY))).standard_normal(len(spread))
    speed = 0.5 * (now.speed_m_s + before.speed_m_s) * params.speed_scale
    yaw_rate = 0.5 * (now.yaw_rate_rad_s + before.yaw_rate_rad_s) + np.deg2rad(params.yaw_rate_bias_deg_s)
    attitude = [now.heave_m, now.roll_rad + np.deg2rad(params.roll_bias_deg), now.pitch_rad + np.deg2rad(params.pitch_bias_deg)]
    rates = [now.heave_rate_m_s, now.roll_rate_rad_s, now.pitch_rate_rad_s]
    values = like.new_tensor(np.array([speed, yaw_rate, *attitude, *rates]) + noise)
    return Ego(
        at * period_s, (step - at) * period_s, period_s, values[2:5], values[5:8], values[0], values[1], motion.pivot_x_m, motion.rear_x_m
    )
