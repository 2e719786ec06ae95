"""Fog between lamps, road and camera, against closed forms and numerical quadrature."""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from luxloop.world.frames import View, pose_from_degrees
from luxloop.world.light.backscatter import Backscatter
from luxloop.world.light.emitters import ambient_luminance
from luxloop.world.light.illumination import illuminance, lit_surface, luminance
from luxloop.world.rendering.gbuffer import flat_road
from luxloop.world.scene.air import AirParams, Medium
from luxloop.world.scene.scene import Scene, StreetLamp
from tests.world.grids import camera
from tests.world.light.test_volumetric import I_CD, uniform

VIEW = camera(640, 360)
LAMP = pose_from_degrees((0.0, 0.6, 0.75), pitch_deg=2.0)
TEXTURE = torch.full((4, 4), I_CD)
LIGHT = TEXTURE.flatten()
PIXELS = ((180, 320), (250, 100), (300, 500), (60, 320))  # row, column: near the horizon, on the road, above it


def along(view: View, row: int, column: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Origin, unit direction and length to the plane z = 0 of a pixel's ray."""
    ray = (
        view.T_world_view[:3, :3] @ torch.tensor([(column + 0.5 - view.cx) / view.fx, (row + 0.5 - view.cy) / view.fy, 1.0]).double()
    ).numpy()
    ray, origin = ray / np.linalg.norm(ray), view.origin.numpy()
    return origin, ray, -origin[2] / ray[2] if ray[2] < 0 else 400.0


def single_scattering(row: int, column: int, visibility_m: float) -> float:
    """Luminance in cd/m^2 of the air in front of a pixel, lit by a point of 1000 cd in a square pyramid of 45 deg, by quadrature."""
    origin, ray, far_m = along(VIEW, row, column)
    place, x, y, z = LAMP[:3, 3].numpy(), *LAMP[:3, :3].numpy().T
    sigma, g = -math.log(0.05) / visibility_m, 0.8

    def integrand(s: float) -> float:
        to = origin + s * ray - place
        if not to @ x > max(abs(to @ y), abs(to @ z)):
            return 0.0
        d = float(np.linalg.norm(to))
        cosine = -float(to @ ray) / d
        henyey_greenstein = (1 - g * g) / (4 * math.pi) / (1 + g * g - 2 * g * cosine) ** 1.5
        return sigma * henyey_greenstein * I_CD / d**2 * math.exp(-sigma * (d + s))

    enter = min((s for s in np.linspace(0, 20, 4001) if integrand(s)), default=0.0)  # the beam's edge, to 5 mm
    return float(quad(integrand, enter, far_m, limit=500, points=[enter + 1, enter + 5] if far_m > enter + 5 else None)[0])


@pytest.mark.parametrize("visibility_m", [50.0, 100.0, 200.0])
def test_backscatter_agrees_with_quadrature(visibility_m, device):
    air = Backscatter(Medium.fog(visibility_m), VIEW)
    found = air.luminance([(uniform(device=device).headlight, LAMP, LIGHT)], VIEW.whole, True)
    for row, column in PIXELS:
        assert float(found[row, column]) == pytest.approx(single_scattering(row, column, visibility_m), rel=0.02)


def test_backscatter_is_linear_and_a_part_of_it_equals_that_part():
    air, lamp = Backscatter(Medium.fog(100.0), VIEW), uniform().headlight
    texture = torch.rand(2, 16, generator=torch.Generator().manual_seed(0))
    whole = air.luminance([(lamp, LAMP, texture)], VIEW.whole, True)
    part = slice(101, 203), slice(57, 399)
    assert air.luminance([(lamp, LAMP, texture)], part, True).equal(whole[..., *part])
    both = air.luminance([(lamp, LAMP, texture[0]), (lamp, LAMP, 2 * texture[1])], VIEW.whole, True)
    torch.testing.assert_close(both, whole[0] + 2 * whole[1])
    of_pixels = air.luminance([(lamp, LAMP, torch.tensor([0.3]))], VIEW.whole, False)
    torch.testing.assert_close(of_pixels, air.luminance([(lamp, LAMP, 0.3 * LIGHT)], VIEW.whole, True))
    assert air.luminance([], VIEW.whole, True) == 0.0


@pytest.mark.parametrize("visibility_m", [50.0, 100.0, 200.0])
def test_air_takes_light_on_its_way_to_the_road_and_to_the_camera(visibility_m):
    clear, sigma = flat_road(VIEW, 0.2), -math.log(0.05) / visibility_m
    lit, through = (lit_surface(each, uniform().headlight, LAMP) for each in (clear, clear.in_air(Medium.fog(visibility_m), VIEW.origin)))
    assert through.index.equal(lit.index)
    points = clear.position.flatten(1)[:, lit.index].double()
    from_lamp, to_eye = ((points - each[:, None]).norm(dim=0) for each in (LAMP[:3, 3], VIEW.origin))
    lx, cd_m2 = ((f(through, TEXTURE) / f(lit, TEXTURE)).double() for f in (illuminance, luminance))
    torch.testing.assert_close(lx, torch.exp(-sigma * from_lamp), rtol=1e-4, atol=1e-12)
    torch.testing.assert_close(cd_m2, torch.exp(-sigma * (from_lamp + to_eye)), rtol=1e-4, atol=1e-12)


def test_surfaces_fade_into_the_horizon_of_the_fog():
    fog, lamps = Medium.fog(100.0), (StreetLamp(position_m=(20.0, 3.0, 6.0), intensity_cd=1000.0),)
    clear = flat_road(VIEW, 0.2)
    seen = ambient_luminance(clear.in_air(fog, VIEW.origin), 1.0)
    horizon = 1 / (2 * math.pi)  # Koschmieder: half of a sky of E / pi
    row = 300
    distance = float((clear.position[:, row, 320] - VIEW.origin).norm())
    share = 0.05 ** (distance / 100.0)
    assert float(seen[row, 320]) == pytest.approx(share * 0.2 / math.pi + (1 - share) * horizon, rel=1e-5)
    assert float(seen[0, 0]) == pytest.approx(horizon), "the sky"
    point = torch.tensor([20.0, 3.0, 0.0])
    at = int((clear.position.flatten(1) - point[:, None]).norm(dim=0).argmin())
    without, lit = (ambient_luminance(clear, 0.0, lamps), ambient_luminance(clear.in_air(fog, VIEW.origin), 0.0, lamps))
    length = 6.0 + float((clear.position.flatten(1)[:, at] - VIEW.origin).norm())
    assert float(lit.flatten()[at] / without.flatten()[at]) == pytest.approx(0.05 ** (length / 100.0), rel=2e-3)  # the pixel is 7 cm beside


def test_visibility_changes_over_time():
    scene = Scene((), air=(AirParams(time_s=1.0, visibility_m=50.0), AirParams(time_s=2.0)))
    assert [scene.air_at(t_s) for t_s in (0.0, 1.5, 2.0)] == [Medium.fog(50.0), Medium.fog(50.0), None]
    assert Scene(()).air_at(0.0) is None
