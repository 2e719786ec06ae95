"""Traffic along a drive keeps to its lanes, out of the vehicle's way and on the road, and comes from its seed, however long the drive."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from luxloop.world.roads.base import Floats, MeshGrid
from luxloop.world.roads.shapes import Flat
from luxloop.world.scene.body import Figure
from luxloop.world.scene.vehicle import Motion, VehicleParams, drive
from luxloop.world.traffic.generator import TrafficParams
from luxloop.world.traffic.objects import ObjectParams
from luxloop.world.traffic.roles import FIRST
from luxloop.world.traffic.route import LANE_M, OWN_M
from tests.refusal import refusal

DRIVE_S = 20.0
SPEEDS = ((0, 14, 0), (2, 14, 0), (4, 11, 0.015), (9, 11, 0.015), (11, 0, 0), (13, 0, 0), (16, 12, -0.01))
BEND = VehicleParams(course=tuple({"time_s": t, "speed_m_s": v, "curvature_1_m": c} for t, v, c in SPEEDS))
TRAFFIC = TrafficParams(seed=3, animals=1, cars=2)


def along(seed: int = 3, duration_s: float = DRIVE_S) -> tuple[ObjectParams, ...]:
    return TRAFFIC.model_copy(update={"seed": seed}).along(BEND, duration_s)


def kind_of(item: ObjectParams) -> str:
    return item.name.rstrip("0123456789").rstrip("_")


def seen(item: ObjectParams, motion: Motion, times_s: Floats) -> Floats:
    """x ahead of the lamps and y to the left `[2, K]` in the ground frame at those of the times at which it is there."""
    since, until = item.appears_s or 0.0, np.inf if item.vanishes_s is None else item.vanishes_s
    t = times_s[(times_s >= since) & (times_s < until)]
    moments, places = np.array([each.time_s for each in item.track]), np.array([each.position_m for each in item.track])
    x, y, yaw = (np.interp(t, motion.times_s, column) for column in motion.states[:, :3].T)
    dx, dy = np.interp(t, moments, places[:, 0]) - x, np.interp(t, moments, places[:, 1]) - y
    return np.stack([dx * np.cos(yaw) + dy * np.sin(yaw), dy * np.cos(yaw) - dx * np.sin(yaw)])


@pytest.fixture(scope="module")
def motion() -> Motion:
    return drive(BEND, Flat(), DRIVE_S)


def test_the_same_seed_gives_the_same_traffic_and_a_longer_drive_the_same_at_first():
    short, long = along(duration_s=10.0), {each.name: each for each in along()}
    assert short == along(duration_s=10.0) != along(4, 10.0)
    assert len(long) > len(short) > 30
    for item in short:
        other = long[item.name]
        track, same = item.pose_track(), other.pose_track()
        for t in np.arange(0, 10, 0.5):
            assert track.visible_at(t) == same.visible_at(t) and torch.equal(track.pose_at(t), same.pose_at(t))
    later = long.keys() - {each.name for each in short}
    assert all((long[name].appears_s or 0) >= 10 for name in later)


def test_round_a_bend_everybody_keeps_to_the_lane(motion):
    x, y, yaw = motion.states[::20, :3].T
    way = np.stack([x + motion.rear_x_m * np.cos(yaw), y + motion.rear_x_m * np.sin(yaw)])
    left, checked = np.stack([-np.sin(yaw), np.cos(yaw)]), 0
    for item in along(1):
        if kind_of(item) not in ("car", "cyclist"):
            continue
        track, offsets = item.pose_track(), []
        for t in np.arange(0, DRIVE_S, 0.25):
            away = track.pose_at(t)[:2, 3:].numpy() - way
            k = int(np.hypot(*away).argmin())
            if track.visible_at(t) and 0 < k < len(yaw) - 1:  # else it is beyond the drive's ends
                offsets.append(float((away * left)[:, k].sum()))
        if offsets:
            checked += 1
            # 2 m of a bend of 67 m between keyframes leave it by 1 cm; 0.6 m between points of the way by less
            assert max(offsets) - min(offsets) < 0.03
            if kind_of(item) == "car":
                assert min(abs(offsets[0] - LANE_M), abs(offsets[0])) < 0.8  # four standard deviations beside a lane's middle
    assert checked >= 10


def test_nothing_is_ever_in_the_own_way(motion):
    times, led = np.arange(0, DRIVE_S, 0.1), 0
    for seed in range(20):
        for item in along(seed):
            half_m, width_m = FIRST[kind_of(item)][3]
            x, y = seen(item, motion, times)
            # 0.1 m: by which the lamps leave the rear axle's way in a bend, 0.015 * 3.6^2 / 2
            beside = np.abs(y) > LANE_M / 2 + width_m - 0.1
            assert (beside | (x > half_m) | (x < -OWN_M - half_m)).all(), f"{item.name} of seed {seed}"
            led += kind_of(item) == "car" and len(x) == len(times) and bool((np.abs(y[x < 20]) < 1.0).all())
    assert led > 0  # cars that go ahead are among them


def test_nothing_moves_where_nothing_shall():
    still = TRAFFIC.model_copy(update={"moving": False}).along(BEND, DRIVE_S)
    assert len(still) > 40 and all(len(each.track) == 1 for each in still)


def test_more_traffic_than_memory_holds_is_refused():
    with refusal(r"traffic: [\d,]+ objects .* raise far_m"):
        TRAFFIC.along(VehicleParams(course=({"speed_m_s": 50.0},)), 1000.0)


class Hill:
    """Waves 120 m long, whose steepest grade is 5 %, and a cross-fall."""

    def z(self, x, y):
        k = 2 * np.pi / 120
        return 0.05 / k * (1 - np.cos(k * np.asarray(x, np.float64))) + 0.02 * np.asarray(y, np.float64)

    def grid(self) -> MeshGrid:
        return MeshGrid()


LOWEST_M = {
    # wheels at other places than where the slope is taken, on a crest whose radius is 380 m
    "car": 0.005,
    "cyclist": 0.03,  # does not lean with the cross-fall; the tyres are flat tori
    "pedestrian": 0.04,  # stays upright: a foot half a stride ahead on 5 %, or beside on 2 %
    "traffic_sign": 0.04,  # the post's foot is a half ball of 3 cm, in the ground
}


def test_on_a_hill_all_stand_on_the_road():
    road, kinds = Hill(), set()
    for item in TRAFFIC.along(BEND, DRIVE_S):
        body = item.build()
        track = replace(body.track, road=road, wheels_m=item.wheels_m)
        for t in np.arange(0, DRIVE_S, 6.0):
            if item.kind in LOWEST_M and track.visible_at(t):
                corners = (body.at(t) if isinstance(body, Figure) else body).corners.reshape(-1, 3)
                T = track.pose_at(t)
                x, y, z = (T[:3, :3] @ corners.T + T[:3, 3:]).numpy()
                assert abs((z - road.z(x, y)).min()) < LOWEST_M[item.kind], f"{item.name} at {t} s"
                kinds.add(item.kind)
                if item.kind == "car":  # the body's x axis lies along the road
                    nose, tail = ((T @ torch.tensor([end, 0, 0, 1.0], dtype=torch.float64)).numpy() for end in (1.3, -1.3))
                    slope = (road.z(*nose[:2]) - road.z(*tail[:2])) / 2.6
                    assert (nose[2] - tail[2]) / 2.6 == pytest.approx(slope, abs=2e-4)
    assert kinds == set(LOWEST_M)
