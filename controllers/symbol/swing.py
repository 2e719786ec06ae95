"""How the body swings on its springs: a Kalman filter of what is measured, which predicts the time until light is exposed."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from scipy.linalg import expm, solve_discrete_are
from torch import Tensor

from perception.egomotion import Ego
from world.vehicle import body_pose

RATE_HZ, DAMPING = 1.3, 0.2  # with which bodies of cars swing
JERK = (0.8, 0.5, 0.5)  # m/s^3 and rad/s^3, root of the density of what the road adds to heave, roll and pitch
NOISE = ((1e-3, 5e-3), (2e-4, 2e-3), (2e-4, 2e-3))  # usual, of measured heave, roll and pitch and of their rates
SEEN = 1e-4  # rad, how well the road tells the pitch
PARTS = 16  # of a period, over which noise is added up


@dataclass(frozen=True)
class Swing:
    """Heave in m, roll and pitch in rad (columns) of the body at time_s: `[3, 3]` float64 on the CPU, values, rates and accelerations.

    pivot_x_m: where on the ground the body rolls and pitches.
    """

    time_s: float
    modes: Tensor
    pivot_x_m: float

    def updated(self, ego: Ego) -> "Swing":
        """After another measurement; one that was there before changes nothing."""
        if ego.time_s <= self.time_s:
            return self
        before = _moved(ego.time_s - self.time_s) @ self.modes
        news = torch.stack([_exact(ego.attitude), _exact(ego.rates)]) - before[:2]
        return Swing(ego.time_s, before + torch.einsum("kij,jk->ik", _filter(ego.period_s)[0], news), ego.pivot_x_m)

    def foretold(self, time_s: float) -> bool:
        """Whether nothing was measured yet at a time."""
        return time_s > self.time_s + 1e-6

    def corrected(self, time_s: float, pitch_rad: Tensor) -> tuple["Swing", Tensor]:
        """After the road has told that the body pitched by `[]` rad more at a time than was foretold; also how much of it is believed."""
        gain = _filter(time_s - self.time_s)[1]
        modes = _moved(time_s - self.time_s) @ self.modes
        modes[:, 2] += gain * _exact(pitch_rad)
        return Swing(time_s, modes, self.pivot_x_m), gain[0].to(pitch_rad) * pitch_rad

    def T_ground_body(self, time_s: float) -> Tensor:
        """Pose `[4, 4]` of the body over the ground at another time."""
        return body_pose((_moved(time_s - self.time_s) @ self.modes)[0], self.pivot_x_m)


def swung(before: Swing | None, ego: Ego | None) -> Swing | None:
    """What is known of the swing after a measurement, if there is one; the first is taken as it is."""
    if ego is None or before is not None:
        return before if ego is None or before is None else before.updated(ego)
    values, rates = _exact(ego.attitude), _exact(ego.rates)
    return Swing(ego.time_s, torch.stack([values, rates, torch.zeros_like(rates)]), ego.pivot_x_m)


def _moved(duration_s: float) -> Tensor:
    return torch.from_numpy(_transition(duration_s))


def _transition(duration_s: float) -> np.ndarray:
    """A damped oscillator about a place that holds: `[3, 3]` on value, rate and acceleration."""
    omega = 2 * math.pi * RATE_HZ
    return np.asarray(expm(duration_s * np.array([[0, 1, 0], [0, 0, 1], [0, -(omega**2), -2 * DAMPING * omega]])), np.float64)


@lru_cache(maxsize=8)
def _filter(period_s: float) -> tuple[Tensor, Tensor]:
    """Kalman gains in the steady state: `[3, 3, 2]` of the three modes for sensors, `[3]` of pitch for what the road tells."""
    F, H = _transition(period_s), np.eye(3)[:2]
    ways = [_transition((k + 0.5) * period_s / PARTS)[:, 2:] for k in range(PARTS)]
    shaken = sum(way @ way.T for way in ways) * (period_s / PARTS)
    gains = []
    for jerk, noise in zip(JERK, NOISE, strict=True):
        R = np.diag(np.square(noise))
        P = solve_discrete_are(F.T, H.T, jerk**2 * shaken, R)
        gains.append(P @ H.T @ np.linalg.inv(H @ P @ H.T + R))
    return torch.from_numpy(np.stack(gains)), torch.from_numpy(P[:, 0] / (P[0, 0] + SEEN**2))


def _exact(values: Tensor) -> Tensor:
    return values.detach().cpu().double()
