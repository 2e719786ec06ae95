"""Secondary rays against geometry that can be written down."""

from dataclasses import replace

import pytest
import torch
import trimesh

from luxloop.controllers.pixels.primitives import rectangle
from luxloop.controllers.pixels.secondary import PotentialLight, SecondaryRays, scene_caster, shares, street_light, visible_from
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.world.frames import inverse, pose_from_degrees, transform
from luxloop.world.lamps.presets import idealised
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.scene.scene import Scene, StreetLamp

LAMP = idealised(10, 16)
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
LEFT, RIGHT = (PotentialLight.of(LAMP, pose_from_degrees((0.0, y, 0.75))) for y in (0.6, -0.6))


def box(x: float, y: float, z: float, size: tuple[float, float, float] = (0.2, 0.4, 0.6)) -> Body:
    return Body("box", trimesh.creation.box(size), track=PoseTrack.static(pose_from_degrees((x, y, z))))


def test_three_times_the_light_takes_three_quarters():
    """The example of T 7.5.1."""
    brighter = PotentialLight(LAMP, 3 * LEFT.full, LEFT.T_world_headlight)
    taken = shares([brighter, LEFT], torch.tensor([[20.0], [0.6], [0.3]], dtype=torch.float64))
    torch.testing.assert_close(taken[:, 0], torch.tensor([0.75, 0.25], dtype=torch.float64))


def test_beside_and_behind_a_lamp_there_is_none_of_its_light():
    """Where x is zero too: the other lamp takes all there."""
    beside = LEFT.T_world_headlight[:3, 3].float()[:, None] + torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-5.0, 0.0, 0.0]]).T
    assert (LEFT.possible(beside) == 0).all()
    ahead = replace(RIGHT, T_world_headlight=pose_from_degrees((-20.0, 0.0, 0.75)))
    assert shares([LEFT, ahead], beside)[:, 0].tolist() == [0.0, 1.0]


def test_an_observer_does_not_see_behind_a_box():
    occluded = scene_caster(Scene((Body("road", trimesh.creation.box((1000, 1000, 0.02)), ground=True), box(10, 0, 1, (1, 2, 2)))).at(0.0))
    eye = torch.tensor([0.0, 0.0, 1.2], dtype=torch.float64)
    points = torch.tensor([[5.0, 20, 20, 9.5], [0, 0, 5, 0], [0, 0, 0, 1]], dtype=torch.float64)  # the last lies on the box
    assert visible_from(points, eye, occluded).tolist() == [True, False, True, True]
    batch = torch.stack([points, points.flip(-1)])
    assert visible_from(batch, eye, occluded).tolist() == [[True, False, True, True], [True, True, False, True]]


def test_casters_of_one_scene_share_its_embree_copy():
    triangles = Scene((Body("road", trimesh.creation.box((9, 9, 0.02)), ground=True), box(10, 0, 1, (1, 2, 2)))).at(0.0)
    first, second = ([group.off_road.embree for group in triangles.groups] for _ in range(2))
    assert all(a is b for a, b in zip(first, second, strict=True))


def test_an_observer_sees_out_of_their_own_body():
    occluded = scene_caster(Scene((Body("road", trimesh.creation.box((1, 1, 1)), ground=True), box(8, 0, 0.85, (1.8, 0.5, 1.7)))).at(0.0))
    eye = torch.tensor([8.0, 0.0, 1.6], dtype=torch.float64)
    assert visible_from(torch.tensor([[15.0], [0.6], [0.0]], dtype=torch.float64), eye, occluded).all()
    assert not visible_from(torch.tensor([[15.0], [0.0], [0.0]], dtype=torch.float64), eye - torch.tensor([8.0, 0, 0.5]), occluded).any()


FINE = idealised(166, 512)
POSES = [pose_from_degrees((0.0, y, 0.75)) for y in (0.6, -0.6)]
WANTED_LX = 4.0


def carpet():
    return rectangle(torch.tensor([18.0, 0.8, 0]), [0, -1.6, 0], [-6.0, 0, 0], WANTED_LX, "E_v", normal=UP)


def illuminance(points: torch.Tensor, primitives, street: tuple) -> torch.Tensor:
    """lx on the road at points, of each lamp: `[2, N]`."""
    ssc = Ssc.prepare(FINE)
    lights = tuple((name, PotentialLight.of(FINE, T)) for name, T in zip(("left hires", "right hires"), POSES, strict=True))
    total = []
    for own, T in enumerate(POSES):
        u = ssc.utilisation(primitives, T, SecondaryRays(lights, own, street)).u
        intensity = FINE.intensity(FINE.light_texture(u), transform(inverse(T), points).float())
        away = T[:3, 3:] - points
        total.append(intensity * away[2] / away.norm(dim=0) ** 3)
    return torch.stack(total)


def inner() -> torch.Tensor:
    xy = torch.rand(2, 300, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return torch.stack([12.5 + 5 * xy[0], 1.2 * xy[1] - 0.6, torch.zeros(300, dtype=torch.float64)])


@pytest.mark.parametrize("street", [(), (StreetLamp(position_m=(15.0, 0.0, 6.0), intensity_cd=100.0),)], ids=["dark", "street lamp"])
def test_two_lamps_and_street_lamps_give_together_what_is_wanted(street):
    """Within 3 %: a pixel averages over the rays that it lights, between which the setpoint changes."""
    points = inner()
    light = illuminance(points, carpet(), street)
    assert street or light.amin() > 0.3 * WANTED_LX
    torch.testing.assert_close(
        light.sum(0) + street_light(points, UP[:, None], street), torch.full((300,), WANTED_LX).double(), rtol=0.03, atol=0
    )


def test_utilisations_are_not_shared():
    scene = replace(carpet(), quantity=torch.tensor([2]))
    lights = tuple((str(k), PotentialLight.of(FINE, T)) for k, T in enumerate(POSES))
    assert not SecondaryRays(lights, 0).ask(scene, 0) and SecondaryRays(lights, 0).ask(carpet(), 0)
    assert not SecondaryRays(lights[:1], 0).ask(carpet(), 0)
