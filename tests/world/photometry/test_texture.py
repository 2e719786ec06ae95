"""Light textures of distributions: averages and interpolation, flux, and an error that falls with resolution."""

import math

import numpy as np
import pytest

from luxloop.world.photometry import Distribution, light_texture, rmse
from luxloop.world.photometry.distribution import Kind
from luxloop.world.photometry.texture import angles_about, samples, solid_angles
from luxloop.world.texels import TexelGrid


def beam(step_deg: float, kind: Kind = "A") -> Distribution:
    """A smooth beam with a hot spot aside, in steps of so many degrees."""
    h, v = np.arange(-40, 40 + step_deg / 2, step_deg), np.arange(-20, 20 + step_deg / 2, step_deg)
    light = np.exp(-(((h[:, None] - 3) / 12) ** 2) - ((v + 2) / 5) ** 2)
    return Distribution(kind, v, h, 3e4 * light)


def grid(rows: int, cols: int, half_deg: float = 20, half_v_deg: float = 10) -> TexelGrid:
    return TexelGrid.from_degrees(rows, cols, half_deg, -half_deg, -half_v_deg, half_v_deg)


def centres(g: TexelGrid) -> np.ndarray:
    y, z = (each.numpy() for each in g.tangents())
    y, z = np.broadcast_arrays(y, z[:, None])
    return np.stack([np.ones_like(y), y, z])


def samples_of(d: Distribution, g: TexelGrid) -> tuple[np.ndarray, np.ndarray]:
    return samples(d, *angles_about(d, g, "beam", None, (np.arange(g.rows), np.arange(g.cols))))


def test_solid_angles_add_up_to_that_of_the_whole_plane():
    assert solid_angles(grid(7, 13, 45, 45)).sum() == pytest.approx(4 * math.pi / 6, rel=1e-12)  # a face of a cube
    small = solid_angles(TexelGrid(rows=1, cols=1, left=0.501, right=0.5, bottom=0.2, top=0.201))[0, 0]
    assert small == pytest.approx(1e-6 * (1 + 0.5005**2 + 0.2005**2) ** -1.5, rel=1e-6)


@pytest.mark.parametrize("kind", ["A", "B"])
def test_coarse_texels_hold_the_average_over_their_solid_angle(kind):
    d, g = beam(0.5, kind), grid(4, 6)
    coarse = light_texture(d, g)
    fine = grid(4 * 128, 6 * 128)
    weight = solid_angles(fine)
    flux = (d.intensity(centres(fine)) * weight).reshape(4, 128, 6, 128).sum((1, 3))
    np.testing.assert_allclose(coarse, flux / solid_angles(g), rtol=2e-3)  # two samples a step resolve its kinks to that
    assert (samples_of(d, g)[0] >= 16).all()  # some 7 deg of 0.5


@pytest.mark.parametrize("shape", [(3, 5), (10, 20), (33, 64), (80, 160)])
def test_flux_is_kept(shape):
    """All of the light lies within the texture; it is the integral of the table, at any resolution."""
    h, v = np.arange(-15, 15.1, 0.5), np.arange(-8, 8.1, 0.5)
    d = Distribution("A", v, h, 1e4 * (np.cos(np.deg2rad(6 * h))[:, None] * np.cos(np.deg2rad(11.25 * v))).clip(0))
    g = grid(*shape)
    assert (light_texture(d, g) * solid_angles(g)).sum() == pytest.approx(d.luminous_flux, rel=2e-3)


def test_a_hard_edge_is_sampled_densely():
    """Light that stops at once in the middle of a texel, at the end of a table or at a step of next to nothing."""
    v = np.array([-30.0, 30])
    ends = Distribution("A", v, np.array([-5.0, 5]), np.ones((2, 2)))
    steps = Distribution("A", v, np.array([-30.0, -5 - 1e-7, -5, 5, 5 + 1e-7, 30]), np.array([0, 0, 1, 1, 0, 0])[:, None] * np.ones(2))
    g = grid(6, 40, 7, 5)  # texels of 0.35 deg, which interpolation alone would take whole
    inside = solid_angles(TexelGrid.from_degrees(1, 1, 5, -5, -5, 5)).sum()
    for d in (ends, steps):
        assert (light_texture(d, g) * solid_angles(g)).sum() == pytest.approx(inside, rel=0.35 / 16 / 10 * 2)  # half a sample a side


def test_the_error_counts_where_the_source_shines_and_light_that_is_cut_off():
    d = Distribution("A", np.array([-5.0, 5]), np.array([-10.0, 10]), np.full((2, 2), 8.0))
    assert rmse(d, grid(20, 40), light_texture(d, grid(20, 40))) < 8 * 0.3  # blurred edges
    half = TexelGrid.from_degrees(40, 40, 0, -10, -5, 5)
    assert rmse(d, half, light_texture(d, half)) == pytest.approx(8 * math.sqrt(0.5), rel=0.01)


def test_type_c_turns_with_its_aim():
    """A street lamp that throws to its C0 side: to the right when it is the beam, and below the horizon as it hangs."""
    d = Distribution("C", np.array([0.0, 20, 90]), np.array([0.0, 90, 180]), np.array([[1.0, 100, 0], [1, 10, 0], [1, 1, 0]]))
    texture = light_texture(d, grid(21, 41, 30, 30))
    row, col = np.unravel_index(texture.argmax(), texture.shape)
    assert row == 10 and col > 25
    hung = light_texture(d, TexelGrid.from_degrees(20, 41, 60, -60, -75, 75), "nadir")
    assert hung[:10].max() == 0 and hung[10:].max() > 0


@pytest.mark.parametrize("kind", ["A", "B"])
def test_the_error_falls_to_zero_with_resolution(kind):
    """A bilinear table on other lines than the texels': kinks give an error of order h on a share h of the area, order 1.5 in all."""
    d = beam(2.0, kind)
    errors = [rmse(d, g, light_texture(d, g)) / d.candela.max() for g in (grid(n, 2 * n, 41, 21) for n in (32, 64, 128, 256, 512))]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.3).all() and orders[1:].mean() == pytest.approx(1.5, abs=0.2)
    assert errors[-1] < 2e-4
