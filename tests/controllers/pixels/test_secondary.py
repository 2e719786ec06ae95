"""Secondary rays against geometry that can be written down."""

from dataclasses import replace

import pytest
import torch
import trimesh

from luxloop.controllers.pixels.primitives import Observer, rectangle
from luxloop.controllers.pixels.rthc import trace
from luxloop.controllers.pixels.secondary import (
    Caster,
    Light,
    SecondaryRays,
    less_street_light,
    scene_caster,
    seen_by,
    shares,
    street_light,
)
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.world.frames import inverse, pose_from_degrees, transform
from luxloop.world.lamps.presets import idealised
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.scene.scene import Scene, StreetLamp

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


def test_beside_and_behind_a_lamp_there_is_none_of_its_light() -> None:
    """Where x is zero too: the other lamp takes all there."""
    beside = LEFT.T_world_headlight[:3, 3].float()[:, None] + torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-5.0, 0.0, 0.0]]).T
    assert (LEFT.possible(beside) == 0).all()
    ahead = replace(RIGHT, T_world_headlight=pose_from_degrees((-20.0, 0.0, 0.75)))
    assert shares([LEFT, ahead], beside)[:, 0].tolist() == [0.0, 1.0]


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


def test_an_observer_sees_out_of_their_own_body() -> None:
    occluded = scene_caster(Scene((Body("road", trimesh.creation.box((1, 1, 1))), box(8, 0, 0.85, (1.8, 0.5, 1.7)))).at(0.0))
    eye = torch.tensor([8.0, 0.0, 1.6], dtype=torch.float64)
    assert seen_by(torch.tensor([[15.0], [0.6], [0.0]], dtype=torch.float64), eye, occluded).all()
    assert not seen_by(torch.tensor([[15.0], [0.0], [0.0]], dtype=torch.float64), eye - torch.tensor([8.0, 0, 0.5]), occluded).any()


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


FINE = idealised(166, 512)
POSES = [pose_from_degrees((0.0, y, 0.75)) for y in (0.6, -0.6)]
WANTED_LX = 4.0


def carpet(width_m: float = 1.6, near_m: float = 12.0, far_m: float = 18.0, **more):  # type: ignore[no-untyped-def]
    origin, d1, d2 = torch.tensor([[far_m, width_m / 2, 0], [0, -width_m, 0], [near_m - far_m, 0, 0]])
    return rectangle(origin, d1, d2, WANTED_LX, "E_v", normal=UP, **more)


def illuminance(  # type: ignore[no-untyped-def]
    points: torch.Tensor,
    primitives,
    occluded: Caster | None = None,
    street: tuple = (),  # type: ignore[type-arg]
    poses: list[torch.Tensor] = POSES,
) -> torch.Tensor:
    """lx on the road at points, of each lamp that sees them: `[2, N]`."""
    ssc = Ssc.prepare(FINE)
    lights = tuple((name, Light.of(FINE, T)) for name, T in zip(("left hires", "right hires"), poses, strict=True))
    total = []
    for own, T in enumerate(poses):
        u = ssc.utilisation(primitives, T, SecondaryRays(lights, own, street, occluded)).u
        intensity = FINE.intensity(FINE.light_texture(u), transform(inverse(T), points).float())
        away = T[:3, 3:] - points
        light = intensity * away[2] / away.norm(dim=0) ** 3
        total.append(light if occluded is None else light * ~occluded(points, T[:3, 3]))
    return torch.stack(total)


def inner(n: int = 300) -> torch.Tensor:
    xy = torch.rand(2, n, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return torch.stack([12.5 + 5 * xy[0], 1.2 * xy[1] - 0.6, torch.zeros(n, dtype=torch.float64)])


def test_two_lamps_give_together_what_is_wanted() -> None:
    """Within 3 %: a pixel averages over the rays that it lights, between which the setpoint changes."""
    light = illuminance(inner(), carpet())
    assert light.amin() > 0.3 * WANTED_LX
    torch.testing.assert_close(light.sum(0), torch.full((300,), WANTED_LX).double(), rtol=0.03, atol=0)


def test_two_cars_draw_together() -> None:
    """A lamp of a car that comes the other way is a light like any other; it gives more where it is nearer."""
    points = inner()
    light = illuminance(points, carpet(), poses=[POSES[0], pose_from_degrees((31.0, 0.6, 0.75), yaw_deg=180)])
    torch.testing.assert_close(light.sum(0), torch.full((300,), WANTED_LX).double(), rtol=0.03, atol=0)
    near, far = points[0] < 15, points[0] > 16
    assert (light[0] > light[1])[near].all() and (light[0] < light[1])[far].all()


def test_only_modules_that_may_draw_take_a_share() -> None:
    light = illuminance(inner(), carpet(modules=("left",)))
    torch.testing.assert_close(light[0], torch.full((300,), WANTED_LX).double(), rtol=0.03, atol=0)


def test_the_free_lamp_makes_up_for_the_blocked_one() -> None:
    occluded = scene_caster(Scene((Body("road", trimesh.creation.box((1, 1, 1))), box(6.0, 0.35, 0.4, (0.1, 0.3, 0.8)))).at(0.0))
    points = inner()
    blocked = occluded(points, POSES[0][:3, 3])
    assert 20 < blocked.sum() < 200
    light = illuminance(points, carpet(), occluded).sum(0)
    free = ~occluded(points, POSES[1][:3, 3])
    # Beside the shadow's edge, pixels average over rays with and without it.
    assert ((light[free] - WANTED_LX).abs() < 0.05 * WANTED_LX).double().mean() > 0.85


def test_street_lamps_are_made_up_to_what_is_wanted() -> None:
    street = (StreetLamp(position_m=(15.0, 0.0, 6.0), intensity_cd=100.0),)
    points = inner()
    given = street_light(points, UP[:, None], street)
    torch.testing.assert_close(
        illuminance(points, carpet(), street=street).sum(0) + given, torch.full((300,), WANTED_LX).double(), rtol=0.03, atol=0
    )


def test_hits_lie_on_the_primitive() -> None:
    """What shadow rays start from: points on the road, within the rectangle."""
    asked: list[torch.Tensor] = []

    def occluded(points: torch.Tensor, _: torch.Tensor) -> torch.Tensor:
        asked.append(points)
        return torch.zeros_like(points[0], dtype=torch.bool)

    hit = trace(carpet(), FINE, POSES[0], secondary=SecondaryRays((("left", Light.of(FINE, POSES[0])),), 0, (), occluded)).hit
    (points,) = asked
    assert points.shape[1] == hit.sum()
    assert points[2].abs().max() < 1e-5
    assert points[0].min() == pytest.approx(12.26, abs=0.05) and points[0].max() == pytest.approx(18, abs=0.05)  # 3.5 deg down
    assert points[1].abs().max() == pytest.approx(0.8, abs=0.01)


def test_what_the_observer_cannot_see_is_off() -> None:
    """A box stands before the eye; the picture that he shall see, all white, is far larger than the carpet."""
    occluded = scene_caster(Scene((Body("road", trimesh.creation.box((1, 1, 1))), box(4, 0, 0.6, (0.2, 1.0, 0.8)))).at(0.0))
    eye, corner, right, down = torch.tensor([[0.0, 0.0, 1.3], [8.0, 50, 1.2], [0, -100, 0], [0, 0, -2.5]])[:, None]
    watched = replace(carpet(), quantity=torch.tensor([2]), observer=Observer(eye, corner, right, down, torch.tensor([True])))
    rays = SecondaryRays((("left", Light.of(FINE, POSES[0])),), 0, occluded=occluded)
    assert rays.ask(watched, 0) and not rays.ask(replace(watched, observer=None), 0)
    free, asked = trace(watched, FINE, POSES[0]), trace(watched, FINE, POSES[0], secondary=rays)
    y, z = (each.double() for each in FINE.tangents(torch.float64, torch.device("cpu")))
    points = torch.stack([torch.ones_like(z[:, None] * y), y.expand(len(z), -1), z[:, None].expand(-1, len(y))])[:, free.hit]
    hidden = occluded(POSES[0][:3, 3:] - points * POSES[0][2, 3] / points[2], eye[0])
    assert 100 < hidden.sum() < len(hidden) - 100
    assert (free.value[free.hit] == WANTED_LX).all()
    torch.testing.assert_close(asked.value[free.hit], free.value[free.hit] * ~hidden)


def test_utilisations_are_not_shared() -> None:
    scene = replace(carpet(), quantity=torch.tensor([2]))
    lights = tuple((str(k), Light.of(FINE, T)) for k, T in enumerate(POSES))
    assert not SecondaryRays(lights, 0).ask(scene, 0) and SecondaryRays(lights, 0).ask(carpet(), 0)
    assert not SecondaryRays(lights[:1], 0).ask(carpet(), 0)


def test_a_primitive_may_turn_sharing_off() -> None:
    light = illuminance(inner(), carpet(shared=False))
    torch.testing.assert_close(light, torch.full((2, 300), WANTED_LX).double(), rtol=0.03, atol=0)
