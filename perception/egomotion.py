"""What the samples of a vehicle's own sensors say of its motion."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

import torch
from torch import Tensor

from world.frames import pose, rotation
from world.scene.vehicle import VehicleParams, body_pose, ground_pose

STANDS_M_S = 0.1  # slower than anybody drives, and more than the noise of a speed sensor at rest

Sensor = Literal["wheels", "gyro", "attitude", "accelerometer", "suspension"]
VALUES: Final[Mapping[Sensor, int | None]] = {"wheels": None, "gyro": 3, "attitude": 8, "accelerometer": 3, "suspension": 4}  # None: any


@dataclass(frozen=True, eq=False)
class Sample:
    """What a sensor of the vehicle tells; x forward, y left, z up, pitch nose down (ISO 8855).

    sensor: its kind. measured_s: the time in s that it is of. arrived_s: when it arrived, in s. values: by kind; wheels: `[n]`, speeds
    in m/s of wheels that are not steered; gyro: `[3]`, rates of roll, pitch and yaw in rad/s; attitude: `[8]`, heave in m, roll and
    pitch in rad of the body over the ground, how fast it rises in m/s, and of the ground height in m, slope in rad, and their rates in
    m/s and rad/s (`Ego.ground`); accelerometer: `[3]`, forward, left and up in m/s^2, without gravity; suspension: `[4]`, how many m
    the body is farther above a wheel than at rest, front left, front right, rear left, rear right.
    """

    sensor: Sensor
    measured_s: float
    arrived_s: float
    values: Tensor


Samples = Mapping[Sensor, Sample]


def newest(known: Samples, come: Iterable[Sample]) -> Samples:
    """The sample of each sensor that was measured last, of those that were known and those that have come."""
    return {each.sensor: each for each in sorted((*known.values(), *come), key=lambda each: each.measured_s)}


@dataclass(frozen=True)
class Ego:
    """The vehicle's motion as its sensors have told it.

    time_s: when the next exposure begins; nothing newer is in it. on_s: how long that exposure lasts. attitude: `[3]`, heave in m, roll and
    pitch (nose down) in rad of the body over the ground, NaN where no sensor tells it. attitude_s: when it was measured. rates: `[3]`,
    of the body's rise and of its roll and pitch in the world, a second, NaN where no sensor tells them. rates_s: when those of roll and
    pitch were measured. ground: `[4]` at attitude_s, height in m over a level plane of the ground frame's origin, slope of the ground
    (nose down) in rad, and their rates in m/s and rad/s; 0 where no sensor tells them. speed_m_s: `[]`, of the rear axle, mean since
    the sample before, which an accelerometer carries on to time_s. speed_s: when it was measured. yaw_rate_rad_s: `[]`, to the left
    positive, mean since the sample before, 0 without a gyro. pivot_x_m: x in the ground frame about which the body rolls and pitches.
    rear_x_m: x of the rear axle there.
    """

    time_s: float
    on_s: float
    attitude: Tensor
    attitude_s: float
    rates: Tensor
    rates_s: float
    ground: Tensor
    speed_m_s: Tensor
    speed_s: float
    yaw_rate_rad_s: Tensor
    pivot_x_m: float = 0.0
    rear_x_m: float = 0.0

    @property
    def stands(self) -> bool:
        """Whether the vehicle stands, as far as its sensors can say."""
        return bool(self.speed_m_s.abs() < STANDS_M_S)

    @property
    def T_ground_body(self) -> Tensor:
        """Measured pose `[4, 4]` of the body in the ground frame."""
        return body_pose(self.attitude, self.pivot_x_m)

    @property
    def T_level_ground(self) -> Tensor:
        """Pose `[4, 4]` of the ground frame at attitude_s in the level one, which drives along with it on a plane that does not tilt."""
        return ground_pose(self.ground[:2])

    @property
    def level_attitude(self) -> Tensor:
        """`[3]`, heave, roll and pitch over the level plane of `T_level_ground`, to first order."""
        height, slope = self.ground[:2]
        return self.attitude + torch.stack([height - slope * self.pivot_x_m, torch.zeros_like(slope), slope])

    @property
    def told_s(self) -> tuple[float, ...]:
        """Ascending times at which anything was measured."""
        return tuple(sorted({time_s for time_s in (self.attitude_s, self.rates_s, self.speed_s) if not math.isnan(time_s)}))

    def way(self, duration_s: float) -> Tensor:
        """Pose `[4, 4]` of the level frame after `duration_s` s at this speed and yaw rate, in that at their beginning.

        The same holds for the ground frame as long as its slope does not change.
        """
        turn, length = self.yaw_rate_rad_s * duration_s, self.speed_m_s * duration_s
        chord = length * torch.sinc(turn / (2 * torch.pi))
        zero = torch.zeros_like(turn)
        x = chord * (turn / 2).cos() + self.rear_x_m * (1 - turn.cos())
        y = chord * (turn / 2).sin() - self.rear_x_m * turn.sin()
        return pose(torch.stack([x, y, zero]), rotation(zero, zero, turn))

    def at(self, time_s: float) -> "Ego":
        """Attitude and ground predicted to another time, linearly, as far as they are known."""
        (climb, bend), after_s = self.ground[2:], 0.0 if math.isnan(self.attitude_s) else time_s - self.attitude_s
        over = self.rates - torch.stack([climb - bend * self.pivot_x_m, torch.zeros_like(bend), bend])
        ground = torch.cat([self.ground[:2] + after_s * self.ground[2:], self.ground[2:]])
        return replace(self, attitude=self.attitude + after_s * over.nan_to_num(), ground=ground, attitude_s=time_s)


def ego_of(samples: Samples, vehicle: VehicleParams | None, time_s: float, period_s: float) -> Ego | None:
    """What samples say at a time; None without wheel speeds, which say whether the vehicle moves at all."""
    if "wheels" not in samples:
        return None
    wheels = samples["wheels"]
    unknown = Sample("gyro", math.nan, math.nan, wheels.values.new_tensor([math.nan] * 8))
    gyro = samples.get("gyro", unknown)
    travel = samples.get("suspension")
    body = samples.get("attitude", unknown if vehicle is None or travel is None else _sprung(travel, vehicle))
    acceleration = samples.get("accelerometer", unknown).values[0].nan_to_num()
    return Ego(
        time_s,
        period_s,
        body.values[:3],
        body.measured_s,
        torch.cat([body.values[3:4], gyro.values[:2]]),
        gyro.measured_s,
        body.values[4:].nan_to_num(),
        wheels.values.mean() + acceleration * (time_s - wheels.measured_s),
        wheels.measured_s,
        gyro.values[2].nan_to_num(),
        *((0.0, 0.0) if vehicle is None else (vehicle.pivot_x_m, vehicle.rear_x_m)),
    )


def _sprung(travel: Sample, vehicle: VehicleParams) -> Sample:
    """The attitude over the plane of the wheels; nobody tells its rise, nor what the ground does."""
    fl, fr, rl, rr = travel.values
    roll, pitch = (fl + rl - fr - rr) / (2 * vehicle.track_m), (rl + rr - fl - fr) / (2 * vehicle.wheelbase_m)
    return replace(travel, values=torch.cat([torch.stack([travel.values.mean(), roll, pitch]), travel.values.new_full((5,), math.nan)]))
