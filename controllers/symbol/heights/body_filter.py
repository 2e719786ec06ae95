"""A Kalman filter of the sprung body and of the road under and ahead of its wheels, and the body's poses when light is shown and seen.

The rear wheels follow the front wheels, and the front wheels roll over road that the camera has seen, so most excitation of the body is
known beforehand.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.symbol.sensing.road_shape import HERE
from luxloop.controllers.symbol.sensing.symbol_sensor import Observation
from luxloop.perception.egomotion import KEPT_S, Ego, Samples, ego_of
from luxloop.world.frames import inverse
from luxloop.world.roads.base import smoothstep
from luxloop.world.scene.vehicle import LEARNT_M, LOW_PASS_M, SpringParams, VehicleParams, body_pose, ground_pose

PARTS: Final = 8  # intervals of a prediction, in which a mode's input is linear
TIME_DIGITS: Final = 9  # of a duration in s, so that its rounding does not miss the caches
OTHER_HZ: Final = 1.3  # frequency of other disturbances of the body, undamped


@lru_cache(maxsize=64)
def mode_response(rate_hz: float, damping: float, duration_s: float) -> Tensor:
    """Exact response `[2, 2 + PARTS + 1]` (value and rate) of a spring-damper mode after a duration.

    Columns: initial value and rate, and the input at evenly spaced times, linear in between.
    """
    omega, part_s = 2 * math.pi * rate_hz, duration_s / PARTS
    spring, damper = omega**2, 2 * damping * omega
    found = torch.eye(2, 2 + PARTS + 1, dtype=torch.float64)
    if duration_s == 0:
        return found
    step = _exponential([[0, 1, 0, 0], [-spring, -damper, spring, damper], [0, 0, 0, 1], [0, 0, 0, 0]], part_s)[:2]
    for part in range(2, 2 + PARTS):
        found = step[:, :2] @ found
        found[:, part] += step[:, 2] - step[:, 3] / part_s
        found[:, part + 1] += step[:, 3] / part_s
    return found


@lru_cache(maxsize=64)
def disturbance_transition(duration_s: float) -> Tensor:
    """Transition `[3, 3]` of value, rate and acceleration of a disturbance: an undamped oscillator about a constant offset."""
    return _exponential([[0, 1, 0], [0, 0, 1], [0, -((2 * math.pi * OTHER_HZ) ** 2), 0]], duration_s)


@lru_cache(maxsize=64)
def process_noise(duration_s: float) -> Tensor:
    """Process noise `[3, 3]` of value, rate and acceleration from jerks of density 1."""
    ways = torch.stack([disturbance_transition((part + 0.5) * duration_s / PARTS)[:, 2] for part in range(PARTS)])
    return ways.T @ ways * (duration_s / PARTS)


def _exponential(rates: Sequence[Sequence[float]], duration_s: float) -> Tensor:
    return torch.linalg.matrix_exp(duration_s * torch.tensor(rates, dtype=torch.float64))


ROUGH_M: Final = 1e-4  # m^2/m, random walk of a wheel's height: between classes C and D of ISO 8608, 2 pi^2 n0^2 Gd(n0)
CELL_M: Final = 0.2  # length of the road strip's cells
BEHIND_M: Final = 2.0  # length of the strip behind the rear axle
TRAIL: Final = round(LOW_PASS_M[1] / 2 / CELL_M)  # cells behind the strip that the low-passes of the ground need
JERK: Final = (0.8, 0.5, 0.5)  # m/s^3 and rad/s^3, root of the jerk density of other disturbances: heave, roll, pitch
NOISE: Final = ((1e-3, 2e-4, 2e-4), (5e-3, 2e-3, 2e-3))  # standard deviations of measured heave, roll and pitch, and of their rates
WHEELS_NOISE: Final = (2e-3, 7e-4, 7e-4)  # of heave, roll and pitch over the wheels, with the road between the strip's cells
FIRST: Final = (0.02, 0.1, 0.02, 0.1, 0.5)  # m or rad: initial deviations: value, rate by the road; value, rate, acceleration by others
BIASED: Final = 3e-4  # rad/s, initial deviation of the gyroscope's biases after a calibration at rest; more lets slopes drift
UNEVEN_M: Final = 0.05  # initial deviation of the road's height
PITCH_SEEN: Final = 1.5e-4  # rad, error of the pitch between two observations
OTHER: Final = slice(6, 15)  # states of other disturbances
LEVEL: Final = 15  # state: pitch at the last observation of the road
BIAS: Final = slice(16, 18)  # states: biases of the measured rates of roll and pitch
BODY: Final = 18  # states before the strip's


class BodyParams(SpringParams):
    """The controller's model of its car: suspension and wheel positions."""

    track_m: float = Field(1.6, gt=0.5, le=3, description="distance of the wheels of an axle")


@dataclass(frozen=True, eq=False)
class BodyFilter:
    """Kalman estimate of body and road at time_s: mean `[n]` and covariance `[n, n]` of the state, float64 on the CPU.

    Reference is a fixed level plane (`Ego.level_attitude`). State: heave in m, roll and pitch in rad caused by the road, and their rates;
    heave, roll and pitch caused by other disturbances, their rates and accelerations; pitch in rad at the last processed observation;
    biases in rad/s of the measured rates of roll and pitch; road height in m along the wheel tracks in cells from start_m on, first the
    mean of both tracks, then left minus right. way_m: distance driven. known_m: way up to which the camera has seen the road. slope_rad:
    slope of the ground, assumed beyond known_m. axles_m: x of front and rear axle on the ground. distance_m: distance of the symbol from
    the midpoint of the axles, which converts rise into apparent pitch. over_wheels: as in `Ego`. trail: `[k]`, mean heights in m of the
    cells that the strip has left. observations: times of pending observations, each with the pitch in rad since the previous one, None if
    unknown.
    """

    params: BodyParams
    time_s: float
    way_m: float
    speed_m_s: float
    start_m: float
    known_m: float
    slope_rad: float
    axles_m: tuple[float, float]
    mean: Tensor
    covariance: Tensor
    distance_m: float
    over_wheels: bool = False
    trail: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.float64))
    observations: tuple[tuple[float, float | None], ...] = ()

    @classmethod
    def first(cls, params: BodyParams, ego: Ego, reach_m: float, symbol_x_m: float) -> "BodyFilter":
        """The estimate after the first measurements, with a road strip up to reach_m ahead."""
        over_wheels, begins_s = ego.over_wheels, ego.samples[-1].measured_s - KEPT_S  # the first samples alone do not tell; after any gap
        ego = next(filter(None, (ego_of(samples, ego.vehicle, time_s) for time_s, samples in ego.since(begins_s))))
        front, rear = 2 * ego.pivot_x_m - ego.rear_x_m, ego.rear_x_m
        start = math.floor((rear - BEHIND_M) / CELL_M) * CELL_M
        count = math.ceil((reach_m - start) / CELL_M)
        covariance = torch.diag(torch.tensor(FIRST, dtype=torch.float64).square().repeat_interleave(3))  # [15, 15]
        # P [n, n], n = BODY + 2 count: the mean of two independent tracks has half their variance, the difference twice.
        bias = BIASED**2 * torch.eye(2, dtype=torch.float64)
        covariance = torch.block_diag(covariance, covariance[:1, :1], bias, *(share * (UNEVEN_M**2 + _walk(count)) for share in (0.5, 2.0)))
        mean = torch.zeros(BODY + 2 * count, dtype=torch.float64)
        height, slope, *_ = ego.ground.tolist()
        mean[[0, 2]] = mean.new_tensor([height - slope * ego.pivot_x_m, slope])  # heave at the pivot, and pitch
        mean[BODY : BODY + count] = height - slope * (start + CELL_M * torch.arange(count, dtype=torch.float64))
        distance_m = symbol_x_m - ego.pivot_x_m
        body = cls(params, ego.time_s, 0.0, float(ego.speed_m_s), start, start, slope, (front, rear), mean, covariance, distance_m)
        rest = torch.eye(len(mean), dtype=torch.float64)
        rest[:3, BODY:] = body._bases(torch.zeros(1, dtype=torch.float64))[0]  # the body rests on the road: P = R P R'
        body = replace(body, covariance=rest @ covariance @ rest.T, over_wheels=over_wheels)
        if body.over_wheels:  # the wheels define the level plane
            rows = torch.cat([torch.zeros(3, BODY, dtype=torch.float64), rest[:3, BODY:]], 1)
            body = body._correct(rows, mean.new_zeros(3), mean.new_tensor(WHEELS_NOISE).square())
        return body.measure(ego)

    @property
    def pivot_x_m(self) -> float:
        """Pivot of roll and pitch on the ground."""
        return sum(self.axles_m) / 2

    @property
    def pitch_rad(self) -> float:
        """Apparent pitch at time_s: pitch and rise."""
        return float(self._pitch() @ self.mean)

    @property
    def level_rad(self) -> float:
        """Present estimate of the apparent pitch at the last processed observation."""
        return float(self.mean[LEVEL])

    def update(self, ego: Ego, by_s: float = math.inf) -> "BodyFilter":
        """The estimate after all measurements after time_s and up to by_s."""
        body = self
        for time_s, samples in ego.since(self.time_s, by_s):
            body = _take(body, time_s, samples, ego.vehicle)
        return body

    def with_observation(self, time_s: float, pitched_rad: float | None) -> "BodyFilter":
        """The estimate with a pending observation and the body's pitch since the previous observation."""
        return replace(self, observations=(*self.observations, (time_s, pitched_rad)))

    def at_last_observation(self) -> "BodyFilter":
        """The estimate after processing all pending observations, at the time of the last."""
        body = self
        for time_s, pitched_rad in self.observations:
            body = body.at(time_s)
            row = body._pitch()
            row[LEVEL] -= 1  # H, pitch now less that of the last observation, [n]
            if pitched_rad is not None:
                body = body._correct(row[None], torch.tensor([pitched_rad]).double(), torch.tensor([PITCH_SEEN**2]).double())
            pitch, mean, covariance = body._pitch(), body.mean.clone(), body.covariance.clone()
            mean[LEVEL] = pitch @ body.mean  # x = G x, P = G P G'; row LEVEL of G is the pitch now
            covariance[LEVEL] = covariance[:, LEVEL] = pitch @ body.covariance
            covariance[LEVEL, LEVEL] = pitch @ body.covariance @ pitch
            body = replace(body, mean=mean, covariance=covariance)
        return replace(body, observations=())

    def unseen_way_m(self) -> Tensor:
        """Way `[k]` m of the road cells that the camera has not seen."""
        cells = self._cells()
        return cells[cells > self.known_m + CELL_M / 2]

    def with_road(self, way_m: Tensor, heights: Tensor, variance: Tensor) -> "BodyFilter":
        """The estimate after road heights `[2, k]` m of left and right track at way `[k]` m, with variance `[2, k]` m^2.

        Without an attitude unit, an error of the body's pitch at the last observation has tilted them about the pivot.
        """
        if not len(way_m):
            return self
        body, tilt = self, torch.zeros(len(way_m), BODY, dtype=torch.float64)
        if self.over_wheels:
            body = self.at_last_observation()
            tilt[:, LEVEL] = way_m - body.way_m - body.pivot_x_m
        at, values = body._weights(way_m), exact(heights) + tilt[:, LEVEL] * body.level_rad
        # H of the left track, mean + difference / 2, and of the right one, mean - difference / 2: [k, n] each.
        rows = torch.cat([torch.cat([tilt, at, side * at / 2], 1) for side in (1, -1)])
        body = replace(body, known_m=float(way_m[-1]))._correct(rows, values.flatten(), exact(variance).flatten())
        return body.at(max(self.time_s, body.time_s))

    def T_level_body(self, time_s: float) -> Tensor:
        """Predicted pose `[4, 4]` of the body in the level frame at a time."""
        body = self._transition(round(time_s - self.time_s, TIME_DIGITS)) @ self.mean  # [BODY]
        return body_pose(_output_rows(0, BODY) @ body, self.pivot_x_m)

    def ground(self, ego: Ego, time_s: float) -> Tensor:
        """Height in m, slope in rad and its change in rad/m `[3]` of the ground frame at a time.

        Without an attitude unit those of the low-passed road strip, as in `luxloop.world.scene.vehicle.ground_levels`, where it is nearest.
        """
        if not self.over_wheels:
            height, slope, _, bend = ego.at(time_s).ground
            return exact(torch.stack([height, slope, bend / ego.speed_m_s.clamp(min=1.0)]))
        cells = self._cells()
        heights = torch.cat([self.trail, self.mean[BODY : BODY + len(cells)]])  # [k] m
        places = torch.cat([self.start_m + CELL_M * torch.arange(-len(self.trail), 0, dtype=torch.float64), cells])
        first, last = (float(each) - self.axles_m[1] for each in places[[0, -1]])  # ways of the rear axle
        way_m = min(max(self.way_m + self.speed_m_s * (time_s - self.time_s), first), last)
        ahead = places - way_m - self.axles_m[1]  # of the rear axle
        near, far = ((1 + (2 * math.pi * ahead / width).cos()) * (ahead.abs() < width / 2) for width in LOW_PASS_M)
        fit = torch.stack([torch.ones_like(ahead), ahead - CELL_M / 2])[:, 1:]  # of the slope: weighted least squares
        climb, curvature = torch.linalg.solve(far[1:] * fit @ fit.T, far[1:] * fit @ heights.diff() / CELL_M)
        height, learnt = near @ (heights - climb * ahead) / near.sum(), float(smoothstep(way_m, 0.0, LEARNT_M))
        return torch.stack([learnt * (height - self.axles_m[1] * climb), -learnt * climb, -curvature])

    def measure(self, ego: Ego) -> "BodyFilter":
        """Kalman update with the measurements taken at time_s."""
        rows = torch.cat([_output_rows(0, len(self.mean)), _output_rows(1, len(self.mean))])
        rows[4:, BIAS] = torch.eye(2, dtype=torch.float64)
        if self.over_wheels:
            rows[:3, BODY:] -= self._bases(torch.tensor([self.way_m]).double())[0]
        values = torch.cat([exact(ego.level_attitude), exact(ego.rates)])
        times_s = values.new_tensor([ego.attitude_s] * 4 + [ego.rates_s] * 2)  # [6]; the rate of heave is measured with the attitude
        told = (times_s == self.time_s) & values.isfinite()
        noise = (WHEELS_NOISE, NOISE[1]) if self.over_wheels else NOISE
        return self._correct(rows[told], values[told], torch.tensor(noise, dtype=torch.float64).square().flatten()[told])

    def _correct(self, rows: Tensor, values: Tensor, variance: Tensor) -> "BodyFilter":
        """Kalman update with measured values z `[k]` of variance r `[k]`; H: `[k, n]`."""
        shared = rows @ self.covariance  # H P [k, n]
        gain = torch.linalg.solve(shared @ rows.T + torch.diag(variance), shared).T  # K = P H' (H P H' + diag r)^-1 [n, k]
        covariance = self.covariance - gain @ shared  # P - K H P [n, n]; the mean becomes x + K (z - H x) [n]
        return replace(self, mean=self.mean + gain @ (values - rows @ self.mean), covariance=(covariance + covariance.T) / 2)

    def _pitch(self) -> Tensor:
        heave, _, pitch = _output_rows(0, len(self.mean))
        return pitch - heave / self.distance_m  # H [n]

    def at(self, time_s: float) -> "BodyFilter":
        """Kalman prediction to a time at constant speed, `x = F x`, `P = F P F' + Q`; the road strip moves by whole cells."""
        duration_s = round(time_s - self.time_s, TIME_DIGITS)
        body, strip = self._transition(duration_s), slice(BODY, None)
        shared = body @ self.covariance  # F P [BODY, n]
        covariance = self.covariance.clone()
        covariance[:BODY, :BODY] = shared @ body.T  # F P F'; Q: jerks of other disturbances, and new road
        covariance[OTHER, OTHER] += torch.kron(
            process_noise(max(duration_s, 0.0)), torch.diag(torch.tensor(JERK, dtype=torch.float64).square())
        )
        covariance[:BODY, strip], covariance[strip, :BODY] = shared[:, strip], shared[:, strip].T
        mean, way_m = torch.cat([body @ self.mean, self.mean[strip]]), self.way_m + self.speed_m_s * duration_s
        count, shift = len(self._cells()), max(math.floor((way_m + self.axles_m[1] - BEHIND_M - self.start_m) / CELL_M), 0)
        trail = torch.cat([self.trail, mean[BODY + torch.arange(shift).clamp(max=count - 1)]])[-TRAIL:]
        if shift:
            kept = (torch.arange(count) + shift).clamp(max=count - 1)  # the road continues from its last seen height
            order = torch.cat([torch.arange(BODY), BODY + kept, BODY + count + kept])  # [n]
            mean, covariance = mean[order], covariance[order].T[order]  # which is symmetric
            mean[BODY : BODY + count] -= self.slope_rad * CELL_M * (torch.arange(count) + shift - kept)  # new cells only
            for end, share in ((BODY + count, 0.5), (BODY + 2 * count, 2.0)):
                new = slice(end - min(shift, count), end)
                covariance[new, new] += share * _walk(min(shift, count))
        start_m = self.start_m + shift * CELL_M
        return replace(self, time_s=time_s, way_m=way_m, start_m=start_m, mean=mean, covariance=covariance, trail=trail)

    def _transition(self, duration_s: float) -> Tensor:
        """Transition `[BODY, n]` of the body states over a duration at constant speed."""
        share = torch.linspace(0, 1, PARTS + 1, dtype=torch.float64)
        bases = self._bases(self.way_m + self.speed_m_s * duration_s * share)  # [PARTS + 1, 3, 2 * cells]
        found = bases.new_zeros(BODY, len(self.mean))
        for mode, rate_hz in enumerate((self.params.heave_hz, self.params.roll_hz, self.params.pitch_hz)):
            answer, at = mode_response(rate_hz, self.params.damping, duration_s), [mode, 3 + mode]  # [2, 2 + PARTS + 1], value and rate
            found[at, mode], found[at, 3 + mode] = answer[:, 0], answer[:, 1]
            found[at, BODY:] = answer[:, 2:] @ bases[:, mode]
        found[OTHER, OTHER] = torch.kron(disturbance_transition(duration_s), torch.eye(3, dtype=torch.float64))  # [9, 9]
        found[LEVEL:, LEVEL:BODY] = torch.eye(BODY - LEVEL, dtype=torch.float64)
        return found

    def _bases(self, way_m: Tensor) -> Tensor:
        """Road inputs of heave, roll and pitch at way `[k]`, as weights of the cells of both strips, `[k, 3, 2 * cells]`."""
        front, rear = (self._weights(way_m + axle) for axle in self.axles_m)  # [k, cells] each
        none = torch.zeros_like(front)
        heave, pitch = (front + rear) / 2, (rear - front) / (self.axles_m[0] - self.axles_m[1])  # [k, cells] each; nose down is positive
        modes = ((heave, none), (none, heave / self.params.track_m), (pitch, none))  # of the tracks' mean and of left minus right
        return torch.stack([torch.cat(mode, 1) for mode in modes], 1)

    def _weights(self, way_m: Tensor) -> Tensor:
        """Interpolation weights `[k, cells]` of the cells at way `[k]`."""
        cells = self._cells()
        return (1 - (way_m.clamp(cells[0], cells[-1])[:, None] - cells).abs() / CELL_M).clamp(min=0)

    def _cells(self) -> Tensor:
        return self.start_m + CELL_M * torch.arange((len(self.mean) - BODY) // 2, dtype=torch.float64)


@lru_cache(maxsize=32)  # drawings between two frames repeat the measurements since the last one: 9 instead of 17 ms a drawing
def _take(body: BodyFilter, time_s: float, samples: Samples, vehicle: VehicleParams | None) -> BodyFilter:
    """The estimate after the measurements of a time, by the newest sample of each sensor."""
    if (ego := ego_of(samples, vehicle, time_s)) is None:
        return body
    past = tuple(observation for observation in body.observations if observation[0] <= time_s)
    slope_rad = float(body.ground(ego, time_s)[1])
    known = replace(body, speed_m_s=float(ego.speed_m_s), slope_rad=slope_rad, observations=past).at_last_observation()
    return replace(known.at(time_s).measure(ego), observations=body.observations[len(past) :])


def _walk(count: int) -> Tensor:
    """Covariance `[count, count]` of the road height in the cells after a cell of known height: a random walk."""
    steps = torch.arange(1, count + 1, dtype=torch.float64)
    return ROUGH_M * CELL_M * torch.minimum(steps[:, None], steps)


def _output_rows(derivative: int, states: int) -> Tensor:
    """Output matrix `[3, n]` of heave, roll and pitch; derivative: 0 for the values, 1 for their rates."""
    rows = torch.zeros(3, states, dtype=torch.float64)
    for mode in range(3):
        rows[mode, [3 * derivative + mode, 6 + 3 * derivative + mode]] = 1  # contributions of road and other disturbances add up
    return rows


def exact(values: Tensor) -> Tensor:
    """The values in float64 on the CPU."""
    return values.detach().cpu().double()


EVEN = 2e-3  # in m and rad: smaller movements of a standing body count as sensor noise
LATER_S = 0.2  # a quarter of a slow oscillation, from its zero crossing to its peak


@dataclass(frozen=True)
class BodyPrediction:
    """Predicted poses at the exposure of the next projection, `[4, 4]` float64 on the CPU.

    until: ground frame at that exposure, in the ground frame of the last observation. body: `T_ground_body` at that exposure.
    """

    until: Tensor = HERE
    body: Tensor = HERE

    @classmethod
    def of(cls, ego: Ego | None, body: BodyFilter, since_s: float, ground: Tensor) -> "BodyPrediction":
        """The prediction of a body filter. since_s: time of the last observation. ground: `T_level_ground` `[4, 4]` at since_s."""
        if ego is None:
            return cls()
        now = ground_pose(body.ground(ego, ego.time_s)[:2])
        if ego.stands and _rests(body, now, ego.time_s):
            return cls()
        # T_ground_level (then) T_then_now T_level_ground (now), and T_ground_level T_level_body (both now).
        return cls(inverse(ground) @ exact(ego.way(ego.time_s - since_s)) @ now, inverse(now) @ body.T_level_body(ego.time_s))

    @property
    def still(self) -> bool:
        """Whether the vehicle stands on level wheels."""
        return self.body is HERE


AT_REST: Final = BodyPrediction()


@dataclass(frozen=True)
class BodyPoses:
    """Poses at an observation, `[4, 4]` float64 on the CPU.

    time_s: time of the on frame. ground: `T_level_ground` at time_s. since: ground frame at time_s in the ground frame of the previous
    observation. on, off: `T_ground_body` at on and off frame, both in the ground frame of time_s.
    """

    time_s: float = 0.0
    ground: Tensor = HERE
    since: Tensor = HERE
    on: Tensor = HERE
    off: Tensor = HERE

    @classmethod
    def of(cls, observation: Observation, body: BodyFilter | None, before_s: float, before: Tensor | None) -> "BodyPoses":
        """Poses estimated by a body filter; None: the vehicle stands on level wheels.

        before_s, before: time_s and ground of the previous observation; None without one.
        """
        then = observation.shown.ego
        if observation.ego is None or then is None or body is None:
            return cls()
        seen_s, on_s = then.time_s, then.on_s
        ground = ground_pose(body.ground(then, seen_s)[:2])
        if then.stands and _rests(body, ground, seen_s) and BodyPrediction.of(observation.ego, body, seen_s, ground).still:
            return cls(seen_s, ground)
        T_ground_level, way = inverse(ground), exact(then.way(seen_s - before_s))
        since = inverse(ground if before is None else before) @ way @ ground  # T_ground_level (before) T_before_then T_level_ground (then)
        off = exact(then.way(on_s)) @ body.T_level_body(seen_s + on_s)  # T_level_body, in the level frame of the on frame
        return cls(seen_s, ground, since, T_ground_level @ body.T_level_body(seen_s), T_ground_level @ off)

    @property
    def still(self) -> bool:
        """Whether the vehicle stood on level wheels at the observation."""
        return self.on.equal(HERE) and self.off.equal(HERE)

    def over(self, T_ground_plane: Tensor) -> "BodyPoses":
        """Poses in the frame of a plane at `[4, 4]` instead of the ground frame, for a standing vehicle."""
        T = inverse(T_ground_plane)
        return replace(self, on=T @ self.on, off=T @ self.off)


def _rests(body: BodyFilter, ground: Tensor, time_s: float) -> bool:
    """Whether the body is level at a time and still level LATER_S afterwards; its heave may oscillate, as no sensor measures its rate."""
    # Third row of T_ground_body - 1, [4]: to first order -pitch, roll, 0, and heave + pitch times the pivot's x.
    away, later = ((inverse(ground) @ body.T_level_body(t_s) - HERE)[2].abs() for t_s in (time_s, time_s + LATER_S))
    return bool((away < EVEN).all() and (later[:3] < EVEN).all())
