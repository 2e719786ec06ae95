"""Simulated sensors of a moving vehicle: their samples with bias, noise and resolution, and times of arrival."""

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from pydantic import Field
from torch import Tensor

from luxloop.perception.egomotion import Sample, Sensor
from luxloop.world.params import Params
from luxloop.world.scene.vehicle import Motion, VehicleState

NOISE_KEY = 3  # key besides those of the camera's noise
DRAWN: Final[Mapping[Sensor, list[int]]] = {  # columns of each sensor in a sample's noise
    "wheels": [0],
    "gyro": [6, 7, 1],
    "attitude": [2, 3, 4, 5, 15, 16, 17, 18],
    "accelerometer": [8, 9, 10],
    "suspension": [11, 12, 13, 14],
}
ROUNDING = 1e-6  # of a sample's index, a quotient of times

Measured = tuple[list[float], list[float], float]  # values without noise, its standard deviations, and their resolution


class SamplingParams(Params):
    """Sampling rate and delay of a sensor."""

    rate_hz: float | None = Field(None, gt=0, le=1000, description="samples per second; left out: one at the start of each control step")
    delay_s: float = Field(0.0, ge=0, le=1, description="delay from measurement to arrival")

    @abstractmethod
    def values(self, now: VehicleState, before: VehicleState, period_s: float) -> Measured:
        """A sample without noise in the units of `Sample`, the standard deviations of its noise, and the step of its values, 0: continuous.
        before: state at the previous sample, period_s earlier.
        """


class WheelsParams(SamplingParams):
    """Speed of the rear wheels, mean since the previous sample."""

    scale: float = Field(1.0, gt=0, le=2, description="measured over true speed; worn tyres measure too much")
    noise_m_s: float = Field(0.0, ge=0, le=10, description="standard deviation of the measured speed")
    resolution_m_s: float = Field(0.0, ge=0, le=1, description="step of the measured speed, 0: continuous")

    def values(self, now: VehicleState, before: VehicleState, period_s: float) -> Measured:
        """Speed of the rear axle."""
        return [0.5 * (now.speed_m_s + before.speed_m_s) * self.scale], [self.noise_m_s], self.resolution_m_s


class GyroParams(SamplingParams):
    """Rates of roll and pitch, and the mean yaw rate since the previous sample."""

    bias_deg_s: float = Field(0.0, ge=-10, le=10, description="bias of measured roll and pitch rates")
    yaw_bias_deg_s: float = Field(0.0, ge=-10, le=10, description="bias of the measured yaw rate")
    yaw_noise_deg_s: float = Field(0.0, ge=0, le=10, description="standard deviation of the measured yaw rate")
    noise_deg_s: float = Field(0.0, ge=0, le=10, description="standard deviation of measured roll and pitch rates")
    resolution_deg_s: float = Field(0.0, ge=0, le=1, description="step of the measured rates, 0: continuous")

    def values(self, now: VehicleState, before: VehicleState, period_s: float) -> Measured:
        """Rates of roll, pitch and yaw."""
        bias, tilting, turning = (math.radians(each) for each in (self.bias_deg_s, self.noise_deg_s, self.yaw_noise_deg_s))
        yaw_rate = 0.5 * (now.yaw_rate_rad_s + before.yaw_rate_rad_s) + math.radians(self.yaw_bias_deg_s)
        rates = [now.roll_rate_rad_s + bias, now.pitch_rate_rad_s + bias, yaw_rate]
        return rates, [tilting, tilting, turning], math.radians(self.resolution_deg_s)


class AttitudeParams(SamplingParams):
    """An inertial unit that fuses sensors and odometry to the body's attitude over the ground and the ground's height and slope."""

    heave_noise_m: float = Field(0.0, ge=0, le=1, description="standard deviation of the body's measured height")
    roll_bias_deg: float = Field(0.0, ge=-5, le=5, description="bias of the measured roll")
    pitch_bias_deg: float = Field(0.0, ge=-5, le=5, description="bias of the measured pitch")
    noise_deg: float = Field(0.0, ge=0, le=5, description="standard deviation of measured roll and pitch")

    def values(self, now: VehicleState, before: VehicleState, period_s: float) -> Measured:
        """Heave, roll, pitch, rise; height and slope of the ground, and their rates."""
        roll, pitch = now.roll_rad + math.radians(self.roll_bias_deg), now.pitch_rad + math.radians(self.pitch_bias_deg)
        angle = math.radians(self.noise_deg)
        ground = [now.ground_m, now.slope_rad, now.climb_m_s, now.bend_rad_s]
        return [now.heave_m, roll, pitch, now.rise_m_s, *ground], [self.heave_noise_m, angle, angle, *[0.0] * 5], 0.0


class AccelerometerParams(SamplingParams):
    """Accelerations forward, left and, as mean since the previous sample, up; without gravity."""

    bias_m_s2: float = Field(0.0, ge=-5, le=5, description="bias of each measured acceleration")
    noise_m_s2: float = Field(0.0, ge=0, le=10, description="standard deviation of each measured acceleration")
    resolution_m_s2: float = Field(0.0, ge=0, le=1, description="step of the measured accelerations, 0: continuous")

    def values(self, now: VehicleState, before: VehicleState, period_s: float) -> Measured:
        """Accelerations forward, left, up."""
        values = now.acceleration_m_s2, now.lateral_m_s2, (now.rise_m_s - before.rise_m_s) / period_s
        return [each + self.bias_m_s2 for each in values], [self.noise_m_s2] * 3, self.resolution_m_s2


class TravelParams(SamplingParams):
    """Travel of the body above each wheel, relative to rest."""

    bias_m: float = Field(0.0, ge=-0.1, le=0.1, description="bias of each measured suspension travel, such as by load")
    noise_m: float = Field(0.0, ge=0, le=0.1, description="standard deviation of each measured suspension travel")
    resolution_m: float = Field(0.0, ge=0, le=0.01, description="step of the measured suspension travels, 0: continuous")

    def values(self, now: VehicleState, before: VehicleState, period_s: float) -> Measured:
        """Travel front left, front right, rear left, rear right."""
        travels = now.travel_fl_m, now.travel_fr_m, now.travel_rl_m, now.travel_rr_m
        return [each + self.bias_m for each in travels], [self.noise_m] * 4, self.resolution_m


class SensorParams(Params):
    """Sensors of the vehicle's motion; without bias, noise, resolution and delay they are perfect."""

    fitted: tuple[Sensor, ...] | None = Field(
        None, description="sensors fitted to the vehicle; left out: all but `attitude`, and `attitude` where its table is given"
    )
    wheels: WheelsParams = Field(WheelsParams(), description="wheel speed sensors; without them the vehicle is assumed to stand")
    gyro: GyroParams = Field(GyroParams(), description="gyroscope: rates of roll, pitch and yaw")
    attitude: AttitudeParams | None = Field(None, description="inertial unit: fused heave, roll and pitch")
    accelerometer: AccelerometerParams = Field(AccelerometerParams(), description="accelerometer")
    suspension: TravelParams = Field(
        TravelParams(), description="suspension travel sensors; they give heave, roll and pitch if no inertial unit is fitted"
    )

    @property
    def present(self) -> tuple[Sensor, ...]:
        """Sensors that the vehicle has."""
        unit: tuple[Sensor, ...] = ("attitude",) if self.attitude is not None else ()
        return ("wheels", "gyro", "accelerometer", "suspension", *unit) if self.fitted is None else self.fitted


EXACT: Final = SensorParams()


@dataclass(frozen=True, eq=False)
class Sensors:
    """The sensors of a moving vehicle. period_s: control period."""

    motion: Motion
    params: SensorParams
    period_s: float
    seed: int

    def newest(self, by_s: float, like: Tensor) -> tuple[Sample, ...]:
        """The newest sample of each sensor that has arrived by a time, with the device and dtype of `like`; samples of time 0 have no
        delay.
        """
        return tuple(self._sample(sensor, max(self._last(sensor, by_s), 0), like) for sensor in self.params.present)

    def arriving(self, after_s: float, by_s: float, like: Tensor) -> tuple[Sample, ...]:
        """All samples that arrive after after_s and up to by_s, in order of arrival."""
        found = list[Sample]()
        for sensor in self.params.present:
            past, last = (self._last(sensor, time_s) for time_s in (after_s, by_s))
            found += [self._sample(sensor, number, like) for number in range(max(past, 0) + 1, last + 1)]
        return tuple(sorted(found, key=lambda each: each.arrived_s))

    def _last(self, sensor: Sensor, by_s: float) -> int:
        """Index of the last sample that has arrived, negative if none has."""
        params, period_s = self._of(sensor)
        return math.floor((by_s - params.delay_s) / period_s + ROUNDING)

    def _sample(self, sensor: Sensor, number: int, like: Tensor) -> Sample:
        params, period_s = self._of(sensor)
        at_s, before_s = number * period_s, (number - 1) * period_s
        values, spread, step = params.values(self.motion.at(at_s), self.motion.at(before_s), period_s)
        generator = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number, NOISE_KEY)))
        noise = generator.standard_normal(1 + max(DRAWN[sensor]))[DRAWN[sensor]]
        measured = np.array(values) + np.array(spread) * noise
        measured = step * np.round(measured / step) if step else measured
        return Sample(sensor, at_s, at_s + params.delay_s if number else 0.0, like.new_tensor(measured))

    def _of(self, sensor: Sensor) -> tuple[SamplingParams, float]:
        """Parameters of a sensor, and its period in s."""
        params: SamplingParams = getattr(self.params, sensor) or AttitudeParams()
        return params, self.period_s if params.rate_hz is None else 1 / params.rate_hz
