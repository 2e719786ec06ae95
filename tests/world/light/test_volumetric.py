"""Light scattered once, against closed forms and numerical quadrature."""

import math

import numpy as np
import pytest
import scipy.sparse as sp
import torch
import trimesh
from scipy.integrate import quad

from luxloop.world.headlight import Headlight
from luxloop.world.light.emitters import Source
from luxloop.world.light.volumetric import airlight, phase, shadow_map
from luxloop.world.rendering.surfaces import face_source
from luxloop.world.scene.air import Medium
from luxloop.world.scene.body import Body
from luxloop.world.scene.scene import Scene
from luxloop.world.spmv import Csr

I_CD = 1000.0
CLEAR = Medium(1e-9, 1e-9, 0.0)  # scatters a little and dims nothing
BESIDE = torch.tensor([1.0, 5.0, 0.0], dtype=torch.float64)  # 5 m to the left of the lamp, looking across its beam
ACROSS = torch.tensor([[0.6], [-0.8], [0.0]], dtype=torch.float64)
FAR = torch.tensor([1000.0], dtype=torch.float64)


def uniform(half_deg: float = 45.0, device: torch.device | str = "cpu") -> Source:
    """A point that shines with the same intensity into all of a square pyramid."""
    t = math.tan(math.radians(half_deg))
    matrix = Csr.from_scipy(sp.csr_array(np.full((16, 1), I_CD)))
    light = Headlight(name="uniform", rows=4, cols=4, left=t, right=-t, bottom=-t, top=t, matrix=matrix, pixel_rows=1, pixel_cols=1)
    texture = torch.full((4, 4), I_CD, dtype=torch.float64, device=device)
    return Source(light, texture, torch.eye(4, dtype=torch.float64))


def angles(origin: torch.Tensor, ray: torch.Tensor, near: float, far: float) -> tuple[float, float, float]:
    """Distance of a ray from the lamp, and the angles at the lamp, from its nearest point on, of the ray's ends."""
    closest = -float(origin @ ray)
    height = float((origin + closest * ray).norm())
    return height, math.atan((near - closest) / height), math.atan((far - closest) / height)


def test_phase_function_is_a_share():
    for g in (-0.5, 0.0, 0.8):
        total = quad(lambda c, g=g: 2 * math.pi * float(phase(torch.tensor(c, dtype=torch.float64), g)), -1, 1)[0]
        mean = quad(lambda c, g=g: 2 * math.pi * c * float(phase(torch.tensor(c, dtype=torch.float64), g)), -1, 1)[0]
        assert (total, mean) == pytest.approx((1, g), abs=1e-6)


def test_airlight_of_a_uniform_source_in_thin_air_is_an_angle(device):
    # Without extinction the integral of ds / d^2 is the angle under which the lamp sees the lit part of the ray, by its distance.
    enter = 5 / 1.4 - 1 / 1.4  # where y = x: the ray is at (1 + 0.6 s, 5 - 0.8 s)
    leave = 6 / 0.2  # where y = -x
    height, first, last = angles(BESIDE, ACROSS[:, 0], enter, leave)
    expected = CLEAR.scattering_per_m * I_CD / (4 * math.pi) * (last - first) / height
    found = airlight(uniform(device=device), BESIDE.to(device), ACROSS.to(device), FAR.to(device), CLEAR)
    assert float(found[0]) == pytest.approx(expected, rel=1e-6)  # midpoints of a constant; extinction takes 1e-8


@pytest.mark.parametrize("asymmetry", [0.0, 0.8])
def test_airlight_agrees_with_quadrature_and_converges(asymmetry):
    medium = Medium(0.02, 0.05, asymmetry)

    def integrand(s: float) -> float:
        p = BESIDE + s * ACROSS[:, 0]
        d = float(p.norm())
        towards = float(-(p / d) @ ACROSS[:, 0])
        return 0.02 * float(phase(torch.tensor(towards, dtype=torch.float64), asymmetry)) * I_CD / d**2 * math.exp(-0.05 * (d + s))

    exact = quad(integrand, 4 / 1.4, 30.0, epsrel=1e-10)[0]
    error = [abs(float(airlight(uniform(), BESIDE, ACROSS, FAR, medium, n)[0]) / exact - 1) for n in (4, 16, 64)]
    assert error[2] < 3e-4, "64 midpoints"
    assert error[2] < error[1] / 10 < error[0] / 100, "midpoints converge with the square of their number"


def test_light_ends_at_surfaces_and_at_the_eye():
    medium = Medium(0.02, 0.02, 0.0)
    near, far = (airlight(uniform(), BESIDE, ACROSS, torch.tensor([m], dtype=torch.float64), medium, 256) for m in (10.0, 30.0))
    rest = airlight(uniform(), BESIDE + 10 * ACROSS[:, 0], ACROSS, FAR, medium, 256)
    # What lies beyond 10 m is dimmed by these 10 m. The midpoint rule is good to 1e-5 here.
    assert float(near + rest * math.exp(-0.2)) == pytest.approx(float(far), rel=1e-4)
    assert float(airlight(uniform(), BESIDE, ACROSS, torch.tensor([2.0], dtype=torch.float64), medium)) == 0, "before the beam"
    assert float(airlight(uniform(), BESIDE, -ACROSS, FAR, medium)) == 0, "away from the beam"


def test_a_board_casts_a_shadow_into_the_fog():
    source = uniform()
    board = trimesh.creation.box((0.1, 40.0, 40.0))
    board.apply_translation((2.05, 0, 0))
    shadow = shadow_map(
        Scene((Body("board", board),)).at(0.0), source.headlight.view(source.T_world_source, 64, 64), face_source("raycast")
    )
    medium = Medium.fog(200.0)
    # Light reaches x = 2 m only: the ray is there at s = 1.67 m, before it enters the beam.
    assert float(airlight(source, BESIDE, ACROSS, FAR, medium, shadow=shadow)) == 0
    crossing = torch.tensor([[0.0], [-1.0], [0.0]], dtype=torch.float64)
    plain = airlight(source, BESIDE, crossing, FAR, medium)
    torch.testing.assert_close(airlight(source, BESIDE, crossing, FAR, medium, shadow=shadow), plain)


def test_visibility_is_where_contrast_falls_to_five_per_cent():
    assert math.exp(-150 * Medium.fog(150.0).extinction_per_m) == pytest.approx(0.05)
