"""The vehicle's motion from the samples of its own sensors."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Final, Literal

import torch
from torch import Tensor

from luxloop.world.frames import pose, rotation
from luxloop.world.scene.vehicle import VehicleParams, body_pose, ground_pose

STANDS_M_S = 0.1  # speed below which the vehicle stands: above the noise of a speed sensor

Sensor = Literal["wheels", "gyro", "attitude", "accelerometer", "suspension"]
VALUES: Final[Mapping[Sensor, int | None]] = {"wheels": None, "gyro": 3, "attitude": 8, "accelerometer": 3, "suspension": 4}  # None: any
# Bounds of plausible values, in the units of `Sample`; for an attitude the bound of the ground's height in m.
LARGEST: Final[Mapping[Sensor, float]] = {"wheels": 200.0, "gyro": 100.0, "attitude": 1e4, "accelerometer": 1e3, "suspension": 10.0}


@dataclass(frozen=True, eq=False)
class Sample:
    """A sample of a vehicle sensor; x forward, y left, z up, pitch nose down (ISO 8855).

    sensor: its kind. measured_s: time of measurement in s. arrived_s: time of arrival in s. values: by kind; wheels: `[n]`, speeds in m/s
    of wheels that are not steered; gyro: `[3]`, rates of roll, pitch and yaw in rad/s; attitude: `[8]`, heave in m, roll and pitch in rad
    of the body over the ground, rate of heave in m/s, and of the ground height in m, slope in rad, and their rates in m/s and rad/s
    (`Ego.ground`); accelerometer: `[3]`, forward, left and up in m/s^2, without gravity; suspension: `[4]`, travel in m of the body above
    each wheel relative to rest, front left, front right, rear left, rear right.
    """

    sensor: Sensor
    measured_s: float
    arrived_s: float
    values: Tensor


Samples = tuple[Sample, ...]  # by time of measurement
KEPT_S: Final = 2.0  # longer than a frame or a sample needs to arrive, with the longest delay of the light


def recent(known: Samples, come: Iterable[Sample]) -> Samples:
    """Known samples and samples that have come: those of the last KEPT_S, and the newest of each sensor before them."""
    samples = sorted((*known, *come), key=lambda each: each.measured_s)
    old = [each for each in samples if each.measured_s <= samples[-1].measured_s - KEPT_S]
    return (*{each.sensor: each for each in old}.values(), *samples[len(old) :])


@dataclass(frozen=True)
class Ego:
    """The vehicle's measured motion.

    time_s: start of the next exposure; all samples are older. on_s: duration of the next exposure. attitude: `[3]`, heave in m, roll and
    pitch (nose down) in rad of the body over the ground, NaN if not measured. attitude_s: its time of measurement. rates: `[3]`, of heave
    in m/s, and of roll and pitch in the world in rad/s, NaN if not measured. rates_s: time of measurement of the roll and pitch rates.
    ground: `[4]` at attitude_s, height in m of the ground frame's origin over a level plane, slope of the ground (nose down) in rad, and
    their rates in m/s and rad/s; 0 if not measured. speed_m_s: `[]`, of the rear axle, mean since the previous sample, extrapolated to
    time_s by an accelerometer if there is one. speed_s: its time of measurement. yaw_rate_rad_s: `[]`, left positive, mean since the
    previous sample, 0 without a gyro. over_wheels: whether the attitude is that over the plane of the wheels, by the suspension. samples:
    recent ones, for `since`. vehicle: None if unknown.
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
    over_wheels: bool = False
    samples: Samples = ()
    vehicle: VehicleParams | None = None

    @property
    def pivot_x_m(self) -> float:
        """x in the ground frame of the axis of roll and pitch."""
        return 0.0 if self.vehicle is None else self.vehicle.pivot_x_m

    @property
    def rear_x_m(self) -> float:
        """x in the ground frame of the rear axle."""
        return 0.0 if self.vehicle is None else self.vehicle.rear_x_m

    @property
    def stands(self) -> bool:
        """Whether the vehicle stands, by its measured speed."""
        return bool(self.speed_m_s.abs() < STANDS_M_S)

    @property
    def T_ground_body(self) -> Tensor:
        """Measured pose `[4, 4]` of the body in the ground frame."""
        return body_pose(self.attitude, self.pivot_x_m)

    @property
    def T_level_ground(self) -> Tensor:
        """Pose `[4, 4]` of the ground frame at attitude_s in the level frame, which moves along on a plane that does not tilt."""
        return ground_pose(self.ground[:2])

    @property
    def level_attitude(self) -> Tensor:
        """`[3]`, heave, roll and pitch over the level plane of `T_level_ground`, to first order."""
        height, slope = self.ground[:2]
        return self.attitude + torch.stack([height - slope * self.pivot_x_m, torch.zeros_like(slope), slope])

    def since(self, after_s: float, by_s: float = math.inf) -> Iterator[tuple[float, Samples]]:
        """Times of measurement after after_s and up to by_s, ascending, each with the newest sample of each sensor."""
        known = dict[Sensor, Sample]()
        for time_s, samples in groupby(self.samples, key=lambda each: each.measured_s):
            known |= {each.sensor: each for each in samples}
            if after_s < time_s <= by_s:
                yield time_s, tuple(known.values())

    def way(self, duration_s: float) -> Tensor:
        """Pose `[4, 4]` of the level frame after a duration at constant speed and yaw rate, in the level frame at the start.

        Also the pose of the ground frame, while the slope is constant.
        """
        turn, length = self.yaw_rate_rad_s * duration_s, self.speed_m_s * duration_s
        chord = length * torch.sinc(turn / (2 * torch.pi))
        zero = torch.zeros_like(turn)
        x = chord * (turn / 2).cos() + self.rear_x_m * (1 - turn.cos())
        y = chord * (turn / 2).sin() - self.rear_x_m * turn.sin()
        return pose(torch.stack([x, y, zero]), rotation(zero, zero, turn))

    def at(self, time_s: float) -> "Ego":
        """The motion with attitude and ground extrapolated linearly to a time, where measured."""
        (climb, bend), after_s = self.ground[2:], 0.0 if math.isnan(self.attitude_s) else time_s - self.attitude_s
        over = self.rates - torch.stack([climb - bend * self.pivot_x_m, torch.zeros_like(bend), bend])
        ground = torch.cat([self.ground[:2] + after_s * self.ground[2:], self.ground[2:]])
        return replace(self, attitude=self.attitude + after_s * over.nan_to_num(), ground=ground, attitude_s=time_s)


def ego_of(samples: Samples, vehicle: VehicleParams | None, time_s: float, on_s: float = 0.0) -> Ego | None:
    """The motion at a time from samples; None without wheel speeds. on_s: duration of the next exposure with symbols."""
    newest = {each.sensor: each for each in samples}
    if "wheels" not in newest:
        return None
    wheels = newest["wheels"]
    unknown = Sample("gyro", math.nan, math.nan, wheels.values.new_tensor([math.nan] * 8))
    gyro = newest.get("gyro", unknown)
    travel = newest.get("suspension")
    body = newest.get("attitude", unknown if vehicle is None or travel is None else _sprung(travel, vehicle))
    acceleration = newest.get("accelerometer", unknown).values[0].nan_to_num()
    return Ego(
        time_s,
        on_s,
        body.values[:3],
        body.measured_s,
        torch.cat([body.values[3:4], gyro.values[:2]]),
        gyro.measured_s,
        body.values[4:].nan_to_num(),
        wheels.values.mean() + acceleration * (time_s - wheels.measured_s),
        wheels.measured_s,
        gyro.values[2].nan_to_num(),
        body.sensor == "suspension",
        samples,
        vehicle,
    )


def _sprung(travel: Sample, vehicle: VehicleParams) -> Sample:
    """The attitude over the plane of the wheels; its rate of heave and the ground's motion are not measured."""
    fl, fr, rl, rr = travel.values
    roll, pitch = (fl + rl - fr - rr) / (2 * vehicle.track_m), (rl + rr - fl - fr) / (2 * vehicle.wheelbase_m)
    return replace(travel, values=torch.cat([torch.stack([travel.values.mean(), roll, pitch]), travel.values.new_full((5,), math.nan)]))
