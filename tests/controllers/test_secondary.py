"""Secondary rays against geometry that can be written down."""

import pytest
import torch
import trimesh

from controllers.secondary import Light, less_street_light, scene_caster, seen_by, shares, street_light
from world.body import Body, PoseTrack
from world.frames import pose_from_degrees
from world.presets import idealised
from world.scene import Scene, StreetLamp

LAMP = idealised(10, 16)
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
LEFT, RIGHT = (Light.of(LAMP, pose_from_degrees((0.0, y, 0.75))) for y in (0.6, -0.6))


def road_points(n: int = 400, seed: int = 0) -> torch.Tensor:
    xy = torch.rand(2, n, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return torch.stack([10 + 25 * xy[0], 6 * xy[1] - 3, torch.zeros(n, dtype=torch.float64)])


def box(x: float, y: float, z: float, size: tuple[float, float, float] = (0.2, 0.4, 0.6)) -> Body:
    return Body("box", trimesh.creation.box(size), track=PoseTrack.static(pose_from_degrees((x, y, z))))


def test_shares_add_up_to_one_wherever_a_lamp_gets_to() -> None:
    points = road_points()
    taken = shares([LEFT, RIGHT], points)
    reached = (LEFT.possible(points) + RIGHT.possible(points)) > 0
    assert 50 < reached.sum() < len(reached)
    torch.testing.assert_close(taken.sum(0), reached.double())
    assert ((taken >= 0) & (taken <= 1)).all()


def test_three_times_the_light_takes_three_quarters() -> None:
    """The example of T 7.5.1."""
    brighter = Light(LAMP, 3 * LEFT.full, LEFT.T_world_headlight)
    taken = shares([brighter, LEFT], torch.tensor([[20.0], [0.6], [0.3]], dtype=torch.float64))
    torch.testing.assert_close(taken[:, 0], torch.tensor([0.75, 0.25], dtype=torch.float64))


def test_light_falls_with_the_square_of_the_distance() -> None:
    near, far = LEFT.possible(torch.tensor([[10.0, 20.0], [0.6, 0.6], [0.7, 0.65]], dtype=torch.float64))
    assert near / far == pytest.approx(4, rel=1e-4)  # 0.29 deg below the axis both times


def test_a_blocked_lamp_is_compensated_by_the_other() -> None:
    occluded = scene_caster(Scene((Body("road", trimesh.creation.box((1, 1, 1))), box(1.0, 0.6, 0.75))).at(0.0))
    points = road_points()
    free, taken = shares([LEFT, RIGHT], points), shares([LEFT, RIGHT], points, occluded)
    assert not taken[0].any()  # the box stands right before the left lamp
    torch.testing.assert_close(taken[1], (free[1] > 0).double())


def test_an_observer_does_not_see_behind_a_box() -> None:
    occluded = scene_caster(Scene((Body("road", trimesh.creation.box((1000, 1000, 0.02))), box(10, 0, 1, (1, 2, 2)))).at(0.0))
    eye = torch.tensor([0.0, 0.0, 1.2], dtype=torch.float64)
    points = torch.tensor([[5.0, 20, 20, 9.5], [0, 0, 5, 0], [0, 0, 0, 1]], dtype=torch.float64)  # the last lies on the box
    assert seen_by(points, eye, occluded).tolist() == [True, False, True, True]
    batch = torch.stack([points, points.flip(-1)])
    assert seen_by(batch, eye, occluded).tolist() == [[True, False, True, True], [True, True, False, True]]


def test_street_light_is_taken_off_and_never_below_zero() -> None:
    lamp = StreetLamp(position_m=(15.0, 0.0, 5.0), intensity_cd=500.0)
    points = road_points()
    street = street_light(points, UP[:, None], [lamp])
    below = street_light(torch.tensor([[15.0], [0.0], [0.0]], dtype=torch.float64), UP[:, None], [lamp])
    assert below.item() == pytest.approx(500 / 25)
    wanted_lx, position = 10.0, torch.tensor([0.0, 0.6, 0.75], dtype=torch.float64)
    away = position[:, None] - points
    d = away.norm(dim=0)
    factor = (away[2] / d) / d**2
    together = less_street_light(wanted_lx / factor, street, points, UP[:, None], position) * factor + street
    torch.testing.assert_close(together, street.clamp(min=wanted_lx))
    dark = street_light(points, UP[:, None], [lamp], lambda p, _: torch.ones(p.shape[1], dtype=torch.bool))
    assert not dark.any()
