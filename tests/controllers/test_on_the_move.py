"""Road memory, the body's swing and where light is exposed: against closed forms, then in a small closed loop on the move."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from controllers.symbol.feedforward import relief_of
from controllers.symbol.luxloop import Luxloop, laid
from controllers.symbol.memory import Memory
from controllers.symbol.registration import Heights
from controllers.symbol.sight import Sight
from controllers.symbol.swing import Swing, swung
from loop.scenario import load
from loop.simulation import Simulation
from perception.birdseye import Region
from perception.egomotion import Ego
from world.frames import inverse, pose, rotation, transform
from world.vehicle import body_pose

REGION, GRID = Region(14.0, 20.0, 1.5, -1.5), (60, 30)
EYE, SWUNG = torch.tensor([-1.6, 0.0, 1.35]), torch.tensor([-1.58, 0.01, 1.38])
SMALL = ["camera.width_px=320", "camera.height_px=240", "camera.oversampling=2"]
EXACT = [f"sensors.{key}=0" for key in ("speed_noise_m_s", "yaw_rate_noise_deg_s", "angle_noise_deg", "rate_noise_deg_s", "heave_noise_m")]


class Waves:
    """A road of waves 3 m long, as a ground frame with the pose T_world_ground sees it."""

    def __init__(self, T_world_ground: Tensor) -> None:
        self.T = T_world_ground.numpy()

    def z(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        along, across = (self.T[k, 0] * x + self.T[k, 1] * y + self.T[k, 3] for k in (0, 1))
        return 0.02 * np.sin(2 * np.pi * along / 3) + 0.01 * across


def remembered(T_world_ground: Tensor, eye: Tensor) -> Memory:
    """What an eye knows of the waves; relief_of has cells of 0.1 m, as many as the grid."""
    given: Any = SimpleNamespace(road=Waves(T_world_ground), offset_m=0.0)
    heights = relief_of(given, REGION, eye).heights.flatten()
    return Memory(Heights(heights, torch.eye(len(heights))), torch.ones_like(heights), REGION, GRID, eye)


def way(x: float, y: float, yaw: float) -> Tensor:
    zero = torch.zeros((), dtype=torch.float64)
    return pose(torch.tensor([x, y, 0.0], dtype=torch.float64), rotation(zero, zero, zero + yaw))


def test_what_is_known_stays_on_the_road() -> None:
    T = way(0.667, 0.02, 0.003)
    moved = remembered(torch.eye(4, dtype=torch.float64), EYE).moved(T, SWUNG).heights.mean.view(GRID)
    expected = remembered(T, SWUNG).heights.mean.view(GRID)
    inside = (slice(8, None), slice(2, -2))  # what was not in the region before is not known
    # linear between lines of sight that meet the far side of a wave 0.24 m apart: curvature 0.02 (2 pi / 3)^2 times 0.24^2 / 8 is 0.6 mm
    torch.testing.assert_close(moved[inside], expected[inside], rtol=0, atol=8e-4)
    still = remembered(torch.eye(4, dtype=torch.float64), EYE).heights.mean.view(GRID)
    assert (still - expected)[inside].abs().max() > 0.02, "the waves have moved by a fifth"


def test_information_moves_by_whole_cells_exactly_and_is_kept_in_between() -> None:
    n = GRID[0] * GRID[1]
    grid, eye = torch.arange(n).view(GRID), EYE
    known = torch.zeros(n, n)
    known[grid[20, 10], grid[20, 10]], known[grid[20, 10], grid[21, 10]], known[grid[21, 10], grid[20, 10]] = 4.0, 1.0, 1.0
    flat = Memory(Heights(torch.zeros(n), known), torch.ones(n), REGION, GRID, eye)
    by_cells = flat.moved(way(0.3, 0.0, 0.0), eye).heights.information
    expected = torch.zeros(n, n)
    expected[grid[23, 10], grid[23, 10]], expected[grid[23, 10], grid[24, 10]], expected[grid[24, 10], grid[23, 10]] = 4.0, 1.0, 1.0
    torch.testing.assert_close(by_cells, expected, rtol=0, atol=1e-3)  # float32 places of 20 m
    between = flat.moved(way(0.25, 0.04, 0.0), eye).heights.information
    assert between.sum().item() == pytest.approx(known.sum().item(), rel=1e-4), "of one height of all the road"
    assert torch.allclose(between, between.T, atol=1e-6)
    assert flat.moved(way(7.0, 0.0, 0.0), eye).heights.information.abs().sum() == 0, "behind"


def test_the_road_tells_a_pitch_and_not_its_own_heights() -> None:
    known = remembered(torch.eye(4, dtype=torch.float64), EYE)
    tilted = known.levelled(torch.tensor(-1e-3), -2.2)  # 19 mm at 17 m
    assert float(tilted.pitched(known, -2.2)) == pytest.approx(1e-3, rel=1e-3)
    assert float(known.pitched(known, -2.2)) == 0
    loose, error = known.loosened(1e-3, -2.2).heights.information, tilted.heights.mean - known.heights.mean
    # a pitch of one standard deviation costs at most 1; a shape without a pitch costs what it did
    assert float(error @ loose @ error) <= 1 and float(error @ error) > 0.2
    wave = torch.randn(len(error), generator=torch.Generator().manual_seed(1))
    wave -= wave @ error / (error @ error) * error
    assert float(wave @ loose @ wave) == pytest.approx(float(wave @ wave), rel=1e-3)


def nodding(time_s: float, hz: float = 1.2, amplitude: float = math.radians(0.2)) -> Ego:
    pitch, omega = math.sin(2 * math.pi * hz * time_s), 2 * math.pi * hz
    attitude = torch.tensor([0.0, 0.0, amplitude * pitch])
    rates = torch.tensor([0.0, 0.0, amplitude * omega * math.cos(omega * time_s)])
    return Ego(time_s, 1 / 30, 1 / 30, attitude, rates, torch.tensor(10.0), torch.tensor(0.0), -2.2, -3.6)


def test_a_swing_is_foretold_two_periods_ahead() -> None:
    swing, worst, linear = None, 0.0, 0.0
    for k in range(60):
        now = nodding(k / 30)
        swing = swung(swing, now)
        assert isinstance(swing, Swing)
        then = nodding((k + 2) / 30)
        if k > 10:
            worst = max(worst, float((swing.T_ground_body(then.time_s) - then.T_ground_body.double())[2, 0].abs()))
            linear = max(linear, float((now.after(2 / 30).T_ground_body - then.T_ground_body)[2, 0].abs()))
    # the oscillator is taken to be 8 % faster, and damped by 0.2: 2 T omega 0.2 / 3 of what a straight line misses is 0.07, twice if late
    assert worst < 0.2 * linear
    assert swung(swing, now) == swing, "the same measurement says nothing new"
    assert swung(swing, None) == swing and swung(None, None) is None


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.03, 0.01, -0.017)])
def test_a_symbol_is_laid_on_the_ground_from_a_tilted_body(attitude: tuple[float, ...]) -> None:
    body = body_pose(torch.tensor(attitude, dtype=torch.float64), -2.2)
    target = torch.tensor([17.0, 0.5, 0.0, 0.0], dtype=torch.float64)
    simulation = Simulation.prepare(load("flat", SMALL))
    drawn, z = laid(target, inverse(body))
    corners = simulation.projector.primitive(drawn).corners().squeeze(0) + torch.tensor([0.0, 0.0, 0.0 if z is None else float(z)])
    flat = simulation.projector.primitive(target).corners().squeeze(0)
    # the yaw that is left out is the product of roll and pitch, 1.7e-4 rad over 2 m
    torch.testing.assert_close(transform(body, corners.T).T, flat, rtol=0, atol=6e-4)


def test_the_off_frame_is_seen_from_where_the_on_frame_was() -> None:
    """Raw frames differ by all the road's texture, which moves by a third of a metre between them."""
    more = ["camera.oversampling=4", "light.ambient_lx=4", "camera.noise=false", "controller={name='luxloop'}"]
    simulation = Simulation.prepare(load("driving", [*EXACT, *more]))
    _, result = simulation.step(simulation.start())
    world, seer, controller = simulation.world, simulation.observer, simulation.controller
    assert result.frames is not None and isinstance(controller, Luxloop)
    on_s, off_s = world.exposures(0)
    now, later = (world.motion.at(t) for t in (on_s, off_s))
    driven = inverse(now.T_world_ground) @ later.T_world_ground
    where = (simulation.projector, seer.camera, seer.params, seer.model.albedo, controller.region, (0.2, 0.15), 2, 3, now.T_ground_body)
    raw, warped = (Sight.prepare(*where, T_off) for T_off in (now.T_ground_body, driven @ later.T_ground_body))
    unlit = world.exposed(world.lit(on_s).off, world.lit(on_s).base, 0, 0)
    errors = []
    for sight in (raw, warped):
        contrast, _ = sight.observe(result.frames)
        truth, _ = replace(sight, off_place=None).observe((result.frames[0], unlit))
        errors.append(float((contrast - truth).square().mean().sqrt()))
    # half of a pixel's grain is of the rays that sample it, which meet other points of the road from there
    assert errors[1] < 0.6 * errors[0]


def test_a_nodding_car_keeps_its_symbol_in_place() -> None:
    changes = [*SMALL, *EXACT, "road.kind=flat", "vehicle={course=[{speed_m_s=10}], oscillation={pitch_deg=0.3}}", "steps=8"]
    simulation = Simulation.prepare(load("driving", [*changes, "controller={name='luxloop'}"]))
    still = simulation.projector.light(simulation.projector.target)
    for result in simulation.run():
        if result.step > 3:
            # edges of half a camera row are left; the open loop's symbol is off by half of its length
            assert result.verdict.iou > 0.7
            assert simulation.judge(still, result.time_s).iou < 0.5
