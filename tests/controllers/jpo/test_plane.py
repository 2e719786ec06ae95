"""Light wanted on the road or a wall: cells have the illuminance of their points, and a light that can be had is found."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from luxloop.controllers.pixels.jpo_plane import PlaneModule, Raster, fit_plane, lighting
from luxloop.world.frames import inverse, pose_from_degrees, transform
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.presets import lamp
from tests.refusal import refusal

RASTER = Raster(8.0, 40.0, -8.0, 8.0, 64, 32)
T_BODY_WALL = torch.tensor([[0.0, 0, -1, 25], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)
POSES = (pose_from_degrees((0.0, 0.6, 0.75)), pose_from_degrees((0.0, -0.6, 0.75)))


@pytest.fixture(scope="module")
def lights() -> tuple[Headlight, Headlight]:
    return tuple(lamp("hd84", side).modules[0].headlight for side in ("left", "right"))  # type: ignore[return-value]


def fitted(light: Headlight, pose: Tensor, u: Tensor) -> PlaneModule:
    """A module without limits."""
    return PlaneModule(light, pose, u, torch.ones_like(u))


def illuminance(light: Headlight, pose: Tensor, u: Tensor, points: Tensor) -> Tensor:
    """Of the ground at points `[3, N]`: `I cos / d^2`."""
    local = transform(inverse(pose), points)
    distance = (points - pose[:3, 3:]).norm(dim=0)
    return light.intensity(light.light_texture(u), local.float()) * pose[2, 3] / distance**3


def test_cells_have_the_light_of_their_points(lights):
    generator = torch.Generator().manual_seed(0)
    u = [torch.rand(light.n_pixels, generator=generator) for light in lights]
    points = RASTER.points(8)
    of_points = torch.stack([illuminance(light, pose, each, points.flatten(1)) for light, pose, each in zip(lights, POSES, u, strict=True)])
    wanted = of_points.sum(0).view(points.shape[1:]).mean(0)
    everywhere = torch.ones(64 * 32, dtype=torch.bool)
    same = fit_plane(list(map(fitted, lights, POSES, u)), RASTER, wanted.float(), everywhere, iterations=0)
    assert (same.lx - wanted).abs().mean() < 0.05 * wanted.mean()  # borders of pixels are sharper than texels


def test_light_that_can_be_had_is_found_again(lights):
    generator, everywhere = torch.Generator().manual_seed(0), torch.ones(64 * 128, dtype=torch.bool)
    wall = Raster(-3.0, 5.0, -15.0, 15.0, 64, 128)  # larger than the lamps' field, so that nothing beside it is to stay dark
    u = [torch.rand(light.n_pixels, generator=generator) for light in lights]
    now = [fitted(light, inverse(T_BODY_WALL) @ pose, each) for light, pose, each in zip(lights, POSES, u, strict=True)]
    same = fit_plane(now, wall, torch.zeros(64 * 128), everywhere, iterations=0)
    dark = [replace(each, u=torch.where(chosen, 0.0, each.u)) for each, chosen in zip(now, same.chosen, strict=True)]
    found = fit_plane(dark, wall, same.lx, everywhere, iterations=3000)
    assert all(chosen.any() for chosen in found.chosen)
    assert (found.lx - same.lx).square().mean().sqrt() < 0.01 * same.lx.mean()  # in 255 steps


def test_pixels_that_light_nothing_of_it_keep_their_light_and_so_does_the_road_beside_it(lights):
    where = torch.zeros(64, 32, dtype=torch.bool)
    where[:, 14:18] = True  # as long as the light of the lamps' few rows
    now = [fitted(light, pose, torch.full((light.n_pixels,), 0.3)) for light, pose in zip(lights, POSES, strict=True)]
    dark = fit_plane(now, RASTER, torch.zeros(64 * 32), where.flatten())
    for u, chosen in zip(dark.u, dark.chosen, strict=True):
        assert 0 < chosen.sum() < 84 and (u[~chosen] == 0.3).all()
    same = fit_plane(now, RASTER, torch.zeros(64 * 32), where.flatten(), iterations=0)
    assert dark.lx[where.flatten()].mean() < 0.5 * same.lx[where.flatten()].mean()
    apart = torch.ones(64, 32, dtype=torch.bool)
    apart[:, 10:22] = False  # 2 m to both sides, over which a pixel spreads at the far end
    assert (dark.lx - same.lx)[apart.flatten()].abs().max() < 0.1 * same.lx.max()


def test_light_is_that_of_pixels_below_their_limits(lights):
    where = torch.zeros(64, 32, dtype=torch.bool)
    where[:, 12:20] = True
    limit = (255 * torch.linspace(0, 1, 84)).floor() / 255
    now = [PlaneModule(light, pose, torch.ones(84), limit) for light, pose in zip(lights, POSES, strict=True)]
    found = fit_plane(now, RASTER, torch.full((64 * 32,), 100.0), where.flatten())
    assert all((u[chosen] > limit[chosen]).any() for u, chosen in zip(found.u, found.chosen, strict=True))
    dimmed = [
        replace(each, u=torch.where(chosen, u.minimum(limit), 1.0)) for each, u, chosen in zip(now, found.u, found.chosen, strict=True)
    ]
    shown = fit_plane([replace(each, limit=torch.ones(84)) for each in dimmed], RASTER, found.lx, where.flatten(), iterations=0)
    torch.testing.assert_close(found.lx, shown.lx)


def test_where_no_lamp_shines_nothing_can_be_had(lights):
    behind = Raster(-20.0, -10.0, -5.0, 5.0, 4, 4)
    with refusal("no pixel lights the place"):
        fit_plane([fitted(lights[0], POSES[0], torch.zeros(84))], behind, torch.ones(16), torch.ones(16, dtype=torch.bool))


@pytest.mark.parametrize("name", ["hd84", "idealised-332x1024"])
def test_the_pixels_of_a_place_are_those_that_light_it(name):
    light, pose = lamp(name).modules[0].headlight, POSES[0]
    point = torch.tensor([22.0, 0.4, 0.0], dtype=torch.float64)
    pixels, cd = lighting(light, pose, point)
    local = transform(inverse(pose), point[:, None]).float()
    for pixel, each in zip(pixels.tolist()[:5], cd, strict=False):
        one = torch.zeros(light.n_pixels)
        one[pixel] = 1
        torch.testing.assert_close(light.intensity(light.light_texture(one), local)[0], each, rtol=1e-4, atol=0)  # single precision
    every = light.intensity(light.light_texture(torch.ones(light.n_pixels)), local)[0]
    assert 0 < len(pixels) < 30 and 0.3 * every < cd.sum() <= 1.0001 * every
    assert not len(lighting(light, pose, torch.tensor([-5.0, 0.0, 0.0]))[0])


def test_cells_of_a_wall_have_the_light_of_their_points(lights):
    raster = Raster(-1.0, 3.0, -15.0, 15.0, 40, 300)  # beyond the borders of the lamps' field
    u = [torch.rand(light.n_pixels, generator=torch.Generator().manual_seed(1)) for light in lights]
    points = transform(T_BODY_WALL, raster.points(3).flatten(1))
    wanted = torch.zeros(points.shape[1], dtype=torch.float64)
    for light, pose, each in zip(lights, POSES, u, strict=True):
        away = points - pose[:3, 3:]
        wanted += light.intensity(light.light_texture(each), transform(inverse(pose), points).float()) * away[0] / away.norm(dim=0) ** 3
    cells = wanted.view(9, -1).mean(0)
    now = [fitted(light, inverse(T_BODY_WALL) @ pose, each) for light, pose, each in zip(lights, POSES, u, strict=True)]
    given = fit_plane(now, raster, cells.float(), torch.ones(40 * 300, dtype=torch.bool), iterations=0)
    assert (given.lx - cells).abs().mean() < 0.02 * cells.mean()  # of 3 x 3 points in place of a mean by area
    assert (given.lx - cells).abs().max() < 0.2 * cells.max()  # at sharp borders of pixels
    assert torch.unravel_index(given.lx.argmax(), (40, 300))[0] in range(4, 24)  # upwards: the brightest lies about the lamps' height
