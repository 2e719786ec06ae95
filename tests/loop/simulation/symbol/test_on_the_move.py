"""The road map, the body filter and where light is exposed: against closed forms, then in a small closed loop on the move."""

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import torch
from scipy.signal import lsim
from torch import Tensor

from luxloop import Ego, load
from luxloop.controllers.symbol.heights.body_filter import CELL_M, PARTS, BodyFilter, BodyParams, mode_response
from luxloop.controllers.symbol.heights.feedforward import height_map_of
from luxloop.controllers.symbol.heights.forward_model import ForwardModel
from luxloop.controllers.symbol.heights.height_controller import HeightController, HeightControllerParams, flat_command
from luxloop.controllers.symbol.heights.registration import Heights
from luxloop.controllers.symbol.heights.road_map import RoadMap
from luxloop.perception.birdseye import Region
from luxloop.perception.egomotion import Sample, Samples, Sensor, ego_of, recent
from luxloop.perception.sensors import SensorParams, Sensors
from luxloop.world.frames import inverse, pose, rotation, transform
from luxloop.world.scene.vehicle import CourseParams, SuspensionParams, VehicleParams, body_pose, drive, ground_pose
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import simulation_of

REGION, GRID = Region(14.0, 20.0, 1.5, -1.5), (60, 30)
EYE, SWUNG = torch.tensor([-1.6, 0.0, 1.35]), torch.tensor([-1.58, 0.01, 1.38])
BODY, HERE = BodyParams(), torch.eye(4, dtype=torch.float64)
CAR, LIKE = VehicleParams(course=(CourseParams(speed_m_s=20.0),)), torch.zeros(1, dtype=torch.float64)
AHEAD = torch.tensor([17.0, 0.0, 0.0, 1.0], dtype=torch.float64)
SOFT_AND_STIFF = [0.7, 1.3]  # true natural frequencies over the usual ones: springs of half and 1.7 times the stiffness
SMALL = [f"headlight.model={SMALL_LAMP}", "camera.width_px=320", "camera.height_px=240", "camera.oversampling=2"]
NOISE = ("wheels.noise_m_s", "gyro.yaw_noise_deg_s", "gyro.noise_deg_s", "accelerometer.noise_m_s2", "suspension.noise_m")
EXACT = [f"sensors.{key}=0" for key in NOISE]


class Waves:
    """A road of waves 3 m long, as a ground frame with the pose T_world_ground sees it."""

    def __init__(self, T_world_ground: Tensor) -> None:
        self.T = T_world_ground.numpy()

    def z(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        along, across = (self.T[k, 0] * x + self.T[k, 1] * y + self.T[k, 3] for k in (0, 1))
        return 0.02 * np.sin(2 * np.pi * along / 3) + 0.01 * across - self.T[2, 0] * x - self.T[2, 3]


def remembered(T_world_ground: Tensor, eye: Tensor) -> RoadMap:
    """What an eye knows of the waves; relief_of has cells of 0.1 m, as many as the grid."""
    heights = height_map_of(Waves(T_world_ground).z, REGION, eye).heights.flatten()
    zero, one = torch.zeros_like(heights), torch.ones_like(heights)
    return RoadMap(Heights(heights, one, zero, zero), one, REGION, GRID, eye)


def way(x: float, y: float, yaw: float, z: float = 0.0, slope: float = 0.0) -> Tensor:
    zero = torch.zeros((), dtype=torch.float64)
    return pose(torch.tensor([x, y, z], dtype=torch.float64), rotation(zero, zero + slope, zero + yaw))


@pytest.mark.parametrize("T", [way(0.667, 0.02, 0.003), way(0.667, 0.02, 0.003, 0.002, -0.001)], ids=["level", "tilted"])
def test_what_is_known_stays_on_the_road(T):
    moved, expected, still = (
        each.heights.mean.view(GRID)[12:, 2:-2]  # what was not in the region before is not known
        for each in (remembered(HERE, EYE).move(T, SWUNG), remembered(T, SWUNG), remembered(HERE, EYE))
    )
    # linear between lines of sight that meet the far side of a wave 0.24 m apart: curvature 0.02 (2 pi / 3)^2 times 0.24^2 / 8 is 0.6 mm
    torch.testing.assert_close(moved, expected, rtol=0, atol=8e-4)
    assert (still - expected).abs().max() > 0.02, "the waves have moved by a fifth"


def test_information_moves_by_whole_cells_exactly_and_is_kept_in_between():
    n, grid = GRID[0] * GRID[1], torch.arange(GRID[0] * GRID[1]).view(GRID)

    def known_at(row: int) -> Tensor:
        """Of two heights, one after the other."""
        information = torch.zeros(n)
        information[grid[[row, row + 1], 10]] = torch.tensor([4.0, 1.0])
        return information

    known = known_at(20)
    flat = RoadMap(Heights(torch.zeros(n), known, *torch.zeros(2, n)), torch.ones(n), REGION, GRID, EYE)
    by_cells, between, behind = (flat.move(way(x, y, 0.0), EYE).heights.information for x, y in ((0.3, 0.0), (0.25, 0.04), (7.0, 0.0)))
    torch.testing.assert_close(by_cells, known_at(23), rtol=0, atol=1e-3)  # float32 places of 20 m
    assert between.sum().item() == pytest.approx(known.sum().item(), rel=1e-4), "of one height of all the road"
    assert behind.abs().sum() == 0


def test_the_road_tells_a_pitch_and_not_its_own_heights():
    known = remembered(HERE, EYE)
    tilted = known.tilt(-1e-3, -2.2)  # 19 mm at 17 m
    assert tilted.pitch_between(known, -2.2) == pytest.approx(1e-3, rel=1e-3)
    assert known.pitch_between(known, -2.2) == 0
    nothing = replace(known, heights=replace(known.heights, information=torch.zeros_like(known.heights.information)))
    assert tilted.pitch_between(nothing, -2.2) is None
    heights, error = known.loosen(1e-3, -2.2).heights, tilted.heights.mean - known.heights.mean
    loose = torch.diag(heights.information) - torch.outer(heights.shared, heights.shared)
    # a pitch of one standard deviation costs at most 1; a shape without a pitch costs what it did
    assert float(error @ loose @ error) <= 1 and float(error @ error) > 0.2
    wave = torch.randn(len(error), generator=torch.Generator().manual_seed(1))
    wave -= wave @ error / (error @ error) * error
    assert float(wave @ loose @ wave) == pytest.approx(float(wave @ wave), rel=1e-3)


def nodding(time_s: float, hz: float = 1.2, amplitude: float = math.radians(0.2)) -> Ego:
    pitch, omega = math.sin(2 * math.pi * hz * time_s), 2 * math.pi * hz
    values: dict[Sensor, list[float]] = {
        "wheels": [10.0, 10.0],
        "gyro": [0.0, amplitude * omega * math.cos(omega * time_s), 0.0],
        "attitude": [0.0, 0.0, amplitude * pitch, *[0.0] * 5],
    }
    samples = tuple(Sample(sensor, time_s, time_s, torch.tensor(each)) for sensor, each in values.items())
    ego = ego_of(samples, VehicleParams(course=(CourseParams(speed_m_s=10.0),)), time_s + 1 / 30, 1 / 60)
    assert ego is not None
    return ego


def test_a_nod_is_predicted_two_periods_ahead():
    body, worst, linear = BodyFilter.first(BODY, nodding(0), 16.0, 17.0), 0.0, 0.0
    for k in range(60):
        now, then = nodding(k / 30), nodding((k + 2) / 30)
        body = body.update(now)
        if k > 10:
            worst = max(worst, float((body.T_level_body(then.attitude_s) - then.T_ground_body.double())[2, 0].abs()))
            linear = max(linear, float((now.at(then.attitude_s).T_ground_body - then.T_ground_body)[2, 0].abs()))
    # the oscillator is taken to be 8 % faster: its acceleration is off by 17 %, and known from noisy sensors a period late
    assert worst < 0.2 * linear
    assert body.update(now) is body, "the same measurement says nothing new"


@pytest.mark.parametrize("begins_s", [0.0, 4.0])
def test_a_body_is_known_where_sensors_measure_one_after_the_other(begins_s):
    sensors = Sensors(drive(CAR, cast(Any, Long()), 8.0), SensorParams(), 1 / 30, 0)
    after_s = {"wheels": 0.0, "gyro": 0.001, "accelerometer": 0.002, "suspension": 0.003}
    came = [*sensors.newest(begins_s, LIKE), *sensors.arriving(begins_s, begins_s + 3.0, LIKE)]
    ego = ego_of(
        recent((), [replace(each, measured_s=each.measured_s + after_s[each.sensor]) for each in came]), CAR, begins_s + 3.1, 1 / 60
    )
    assert ego is not None
    body = BodyFilter.first(BODY, ego, 16.0, 17.0).update(ego)
    assert body.over_wheels and math.isfinite(body.slope_rad) and bool(body.mean.isfinite().all())
    assert body.time_s == max(each.measured_s for each in ego.samples)


def test_a_body_is_estimated_anew_after_a_gap_in_which_samples_were_lost():
    simulation = simulation_of(load("driving", [*SMALL, "rate_hz=0.4", "steps=4", "functions.symbol.controller={name='luxloop'}"]))
    assert [result.step for result in simulation.run()] == [0, 1, 2, 3]


def test_a_mode_follows_what_is_under_it_as_a_linear_system_does():
    share, base = np.linspace(0, 1, PARTS + 1), np.random.default_rng(3).normal(size=PARTS + 1)
    omega, damping = 2 * np.pi * 1.4, 0.35
    # q'' + 2 d w (q' - r') + w^2 (q - r) = 0 with x = (q, q' - 2 d w r), which knows no r'
    system = (
        [[0, 1], [-(omega**2), -2 * damping * omega]],
        [[2 * damping * omega], [omega**2 * (1 - 4 * damping**2)]],
        np.eye(2),
        np.zeros((2, 1)),
    )
    before = np.array([0.3, -0.5])
    _, _, states = lsim(system, base, 0.1 * share, before - [0, 2 * damping * omega * base[0]])
    expected = states[-1] + [0, 2 * damping * omega * base[-1]]
    found = mode_response(1.4, damping, 0.1).numpy() @ np.concatenate([before, base])
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert torch.equal(mode_response(1.4, damping, 0.0), torch.eye(2, 2 + PARTS + 1).double()), "no time, no motion"


class Long:
    """A road of waves 6 m long, flat where the car starts."""

    def z(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 0.02 * (1 - np.cos(2 * np.pi * x.clip(min=0) / 6)) * (1 + 0.3 * y)


def springs(factor: float) -> dict[str, float]:
    """The usual natural frequencies, all of them off by a factor."""
    return {key: factor * getattr(BODY, key) for key in ("heave_hz", "pitch_hz", "roll_hz")}


def driven(
    known: bool,
    steps: int = 30,
    speed_m_s: float = 20.0,
    suspension: float = 1.0,
    belief: BodyParams = BODY,
    fitted: tuple[Sensor, ...] = ("wheels", "gyro", "attitude"),
) -> tuple[list[float], list[float], BodyFilter]:
    """Errors in m of the height of the symbol's place over the body, predicted 0.1 s ahead by the filter and linearly, and the filter."""
    params = VehicleParams(course=(CourseParams(speed_m_s=speed_m_s),), suspension=SuspensionParams(**springs(suspension)))
    motion, place = drive(params, cast(Any, Long()), steps / 30 + 1), torch.tensor([17.0, 1.0, 0.0, 1.0]).double()
    sensors, like = Sensors(motion, SensorParams(fitted=fitted), 1 / 30, 0), torch.zeros(1, dtype=torch.float64)
    samples: Samples = ()
    errors, linear, body = [], [], None
    for step in range(steps):
        samples = recent(samples, sensors.arriving((step - 1) / 30, step / 30, like) if step else sensors.newest(0.0, like))
        ego = ego_of(samples, params, step / 30, 1 / 60)
        assert ego is not None
        body = BodyFilter.first(belief, ego, 16.0, 17.0) if body is None else body.update(ego)
        way = body.unseen_way_m()
        heights = torch.from_numpy(np.stack([Long().z(way.numpy(), np.full(len(way), side * BODY.track_m / 2)) for side in (1, -1)]))
        if body.over_wheels:  # the road is seen from the body
            at = motion.at(ego.time_s)
            pitch = -float((ground_pose(HERE.new_tensor([at.ground_m, at.slope_rad])) @ at.T_ground_body)[2] @ AHEAD) / body.distance_m
            body = body.with_observation(ego.time_s, None)
            heights -= (body.at_last_observation().level_rad - pitch) * (way - speed_m_s * ego.time_s - body.pivot_x_m)
        body = body.with_road(way, heights, torch.full_like(heights, 1e-8 if known else 1e4))
        then = ego.time_s + 0.1
        now = motion.at(then)
        T_level_ground = ground_pose(torch.tensor([now.ground_m, now.slope_rad]).double())
        errors.append(float((T_level_ground @ now.T_ground_body - body.T_level_body(then))[2] @ place))
        linear.append(float((now.T_ground_body - ego.at(then).T_ground_body)[2] @ place))
    assert body is not None
    return errors[10:], linear[10:], body


@pytest.mark.parametrize(
    ("sensor", "most_m"),
    [
        # cells of 0.2 m are linear: curvature 0.02 (2 pi / 6)^2 times 0.2^2 / 8 is 0.1 mm at both axles, by the lever of 19 m over 2.8 m
        ("attitude", 2e-3),
        ("suspension", 12e-3),  # the road is known from the body, whose pitch is taken to be known to 7e-4 rad: 12 mm at 17 m
    ],
)
def test_a_body_is_predicted_on_a_road_that_was_seen_and_not_on_another(sensor, most_m):
    known, unknown = (driven(each, fitted=("wheels", "gyro", sensor))[0] for each in (True, False))
    assert max(map(abs, known)) < most_m
    assert max(map(abs, unknown)) > 0.02


def test_the_ground_is_found_from_the_road_without_an_attitude_unit():
    *_, body = driven(True, 60, fitted=("wheels", "gyro", "suspension"))
    now = drive(CAR, cast(Any, Long()), 3.0).at(body.time_s)
    height, slope, _ = body.ground(nodding(0), body.time_s).tolist()
    # as well as heave and pitch over the wheels are taken to be known; the waves are 40 mm high and rise by 21 mrad
    assert height == pytest.approx(now.ground_m, abs=2e-3)
    assert slope == pytest.approx(now.slope_rad, abs=7e-4)


@pytest.mark.parametrize("suspension", SOFT_AND_STIFF)
def test_springs_are_those_that_the_controller_believes_in(suspension):
    right, _, _ = driven(True, 60, suspension=suspension, belief=BodyParams(**springs(suspension)))
    wrong, linear, _ = driven(True, 60, suspension=suspension)
    assert max(map(abs, right)) < 2e-3, "as with usual springs"
    assert max(map(abs, wrong)) > 0.02
    assert np.std(wrong) < 0.75 * np.std(linear), "where soft springs hardly follow waves of 6 m, which the road has alone"


@pytest.mark.parametrize("speed_m_s", [0.0, 3.7, 40.0])
def test_what_is_known_of_the_body_stays_a_covariance(speed_m_s):
    *_, body = driven(True, 60, speed_m_s)
    assert torch.equal(body.covariance, body.covariance.T)
    assert float(torch.linalg.eigvalsh(body.covariance)[0]) > -1e-12  # of squares of cm
    # the strip goes along with the wheels, by whole cells
    assert body.start_m + CELL_M <= body.way_m + body.axles_m[1] or speed_m_s == 0
    assert body.way_m == pytest.approx(speed_m_s * body.time_s)


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.03, 0.01, -0.017)])
def test_a_symbol_is_laid_on_the_ground_from_a_tilted_body(attitude):
    body = body_pose(torch.tensor(attitude, dtype=torch.float64), -2.2)
    target = torch.tensor([17.0, 0.5, 0.0, 0.0], dtype=torch.float64)
    projector, projection = simulation_of(load("flat", SMALL)).symbol.projector, flat_command(target, inverse(body))
    flat, corners = (projector.primitive(each).corners().squeeze(0) for each in (target, projection.pose))
    corners[:, 2] += 0.0 if projection.z is None else float(projection.z)
    # the yaw that is left out is the product of roll and pitch, 1.7e-4 rad over 2 m
    torch.testing.assert_close(transform(body, corners.T).T, flat, rtol=0, atol=6e-4)


def test_the_off_frame_is_seen_from_where_the_on_frame_was():
    """Raw frames differ by all the road's texture, which moves by a third of a metre between them."""
    more = ["camera.oversampling=4", "light.ambient_lx=4", "camera.noise=false", "functions.symbol.controller={name='luxloop'}"]
    simulation = simulation_of(load("driving", [*EXACT, *more]))
    _, result = simulation.step(simulation.start())
    world, seer, controller = simulation.world, simulation.symbol.sensor, simulation.symbol.controller
    assert result.frames is not None and isinstance(controller, HeightController)
    on_s, off_s = result.time_s, result.time_s + 0.5 / simulation.scenario.rate_hz
    now, later = (world.motion.at(t) for t in (on_s, off_s))
    driven = inverse(now.T_world_ground) @ later.T_world_ground
    where = (seer, controller.region, (0.2, 0.15), 2, 3, now.T_ground_body)
    raw, warped = (ForwardModel.prepare(*where, T_off) for T_off in (now.T_ground_body, driven @ later.T_ground_body))
    unlit = simulation.plant.exposed(world.lit(on_s).base, world.lit(on_s).base, 0, 0)
    errors = []
    for forward_model in (raw, warped):
        contrast, _ = forward_model.observe(result.frames)
        truth, _ = replace(forward_model, off_place=None).observe((result.frames[0], unlit))
        errors.append(float((contrast - truth).square().mean().sqrt()))
    # half of a pixel's grain is of the rays that sample it, which meet other points of the road from there
    assert errors[1] < 0.6 * errors[0]


def test_the_road_ahead_is_taken_to_bend_on_as_the_ground_does():
    """On a crest of 1500 m at 20 m/s, in a ground frame that is tilted by then: a parabola that touches it under the rear axle."""
    controller, radius_m = simulation_of(load("flat", [*SMALL, "functions.symbol.controller=luxloop"])).symbol.controller, 1500.0
    assert isinstance(controller, HeightController)
    ego = replace(nodding(1.0), ground=torch.tensor([-0.3, 0.02, -0.4, 20 / radius_m]), speed_m_s=torch.tensor(20.0))
    body = BodyFilter.first(BODY, ego, 16.0, 17.0)
    nothing = controller.start(torch.tensor([17.0, 0.0, 0.0, 0.0])).road_map
    assert not controller._heights(controller._curved_shape(ego, body), nothing).any(), "the ground has still to learn the road"
    base = controller._heights(controller._curved_shape(ego, replace(body, way_m=20.0)), nothing)
    nodes, eye = nothing.nodes(), nothing.eye[:, None]
    road = nodes + (eye - nodes) * (base / nothing.eye[2])  # on the lines of sight
    torch.testing.assert_close(road[2], -((road[0] - ego.rear_x_m) ** 2) / (2 * radius_m), rtol=0, atol=1e-5)
    assert float(base.min()) < -HeightControllerParams().highest_m, "more than is looked for around the plane"
    known = remembered(HERE, EYE)
    for road_map, mean in ((nothing, base), (known, known.heights.mean)):
        over = road_map.over(base if road_map is nothing else known.brightness)
        assert over.heights.mean.equal(mean), "what is known stays, whatever is expected"
    rising = replace(nothing, heights=replace(nothing.heights, mean=base + 0.1 + 0.03 * nodes[0], information=torch.ones_like(base)))
    torch.testing.assert_close(rising.over(base).heights.base, rising.heights.mean, rtol=0, atol=1e-5)  # it goes on as it is known


def test_a_nodding_car_keeps_its_symbol_in_place():
    nods = ["road.kind=flat", "vehicle={course=[{speed_m_s=10}], oscillation={pitch_deg=0.3}}", "steps=8"]
    simulation = simulation_of(load("driving", [*SMALL, *EXACT, *nods, "functions.symbol.controller={name='luxloop'}"]))
    symbol = simulation.symbol
    still = simulation.of_all(symbol, symbol.projector.light(symbol.projector.target))
    for result in [*simulation.evaluations()][4:]:
        # edges of half a camera row are left; the open loop's symbol is off by half of its length
        assert result.symbol.metrics.iou > 0.7 > 0.5 > symbol.evaluator.metrics(still, result.time_s).iou
