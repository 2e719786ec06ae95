"""Secondary rays against geometry that can be written down."""

import math

import pytest
import torch
import trimesh

from controllers.secondary import Light, drawing_rectangle, less_street_light, scene_caster, seen_by, seen_symbol, shares, street_light
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


def flying() -> tuple[torch.Tensor, ...]:
    """A symbol 1.6 m wide and 0.6 m high, upright 10 m ahead, seen by a driver."""
    origin = torch.tensor([10.0, 0.8, 1.0], dtype=torch.float64)
    return origin, *torch.tensor([[0.0, -1.6, 0.0], [0.0, 0.0, -0.6]], dtype=torch.float64), torch.tensor([-1.0, 0.3, 1.3]).double()


def test_the_rectangle_holds_what_is_seen_and_is_no_larger_than_any_other() -> None:
    origin, d1, d2, eye = flying()
    p, a, b = drawing_rectangle(origin, d1, d2, eye, torch.zeros(3).double(), UP)
    assert torch.linalg.cross(a, b)[2] > 0 and p[2] == a[2] == b[2] == 0
    edge = torch.linspace(0, 1, 9, dtype=torch.float64)
    through = origin + edge[:, None, None] * d1 + edge[:, None] * d2 - eye
    seen = (eye + through * (-eye[2] / through[..., 2:])).reshape(-1, 3) - p
    u, v = seen @ a / (a @ a), seen @ b / (b @ b)
    for each in (u, v):
        assert each.min().item() == pytest.approx(0, abs=1e-9) and each.max().item() == pytest.approx(1, abs=1e-9)
    area = a.norm() * b.norm()
    for angle in torch.linspace(0, math.pi / 2, 91).tolist():
        turned = seen[:, :2] @ torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]).double()
        assert area <= (turned.amax(0) - turned.amin(0)).prod() + 1e-9


def test_what_is_above_the_horizon_cannot_be_drawn() -> None:
    origin, d1, d2, eye = flying()
    above = drawing_rectangle(origin + 2 * UP, d1, d2, eye, torch.zeros(3).double(), UP)
    assert torch.isnan(torch.stack(above)).any()


def test_the_observer_sees_the_image_upright(device: torch.device) -> None:
    image = torch.rand(4, 6, dtype=torch.float64, device=device)
    origin, d1, d2, eye = (v.to(device) for v in flying())
    u, v = torch.meshgrid((torch.arange(6) + 0.5) / 6, (torch.arange(4) + 0.5) / 4, indexing="xy")
    on_symbol = origin + u.flatten()[:, None].to(image) * d1 + v.flatten()[:, None].to(image) * d2
    ray = on_symbol - eye
    points = (eye + ray * (-eye[2] / ray[:, 2:])).T
    torch.testing.assert_close(seen_symbol(points, eye, origin, d1, d2, image), image.flatten())
    assert not seen_symbol(points * 3, eye, origin, d1, d2, image).any()
    batch = seen_symbol(torch.stack([points, points]), torch.stack([eye, eye]), origin, d1, d2, image)
    torch.testing.assert_close(batch[1], image.flatten())
