"""From distributions of single pixels to a headlight matrix: exact in angles, true to the source, light neither lost nor made."""

import math
import re
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from luxloop.world import files
from luxloop.world.headlight import pixels
from luxloop.world.headlight.pixels import Pixel, PixelArray, _window, assemble, border_share, default_grid
from luxloop.world.headlight.sources import FileSource
from luxloop.world.photometry import lm63
from luxloop.world.photometry.distribution import Aim, Distribution, angles_of, directions_of
from luxloop.world.photometry.texture import light_texture, solid_angles
from luxloop.world.texels import TexelGrid
from tests.refusal import refusal

ANGLES = np.linspace(-3, 3, 25)
GRID = TexelGrid.from_degrees(60, 80, 4, -4, -3, 3)


def gaussian(
    h_deg: float = 0.0, v_deg: float = 0.0, sigma_deg: float = 0.7, angles: np.ndarray = ANGLES, cd: float = 1000.0
) -> Distribution:
    """A type A pixel, zero at the border of its table."""
    h, v = np.meshgrid(angles - h_deg, angles - v_deg, indexing="ij")
    light = np.exp(-(h**2 + v**2) / 2 / sigma_deg**2)
    light[[0, -1]] = 0
    light[:, [0, -1]] = 0
    return Distribution("A", angles, angles, cd * light)


def rays(grid: TexelGrid) -> np.ndarray:
    """Unit vectors `[3, rows, cols]` through the centres of texels."""
    y, z = (each.numpy() for each in grid.tangents())
    ray = np.stack(np.broadcast_arrays(1.0, y, z[:, None]))
    return ray / np.linalg.norm(ray, axis=0)


def alone(distribution: Distribution, aim: Aim = "beam") -> PixelArray:
    return PixelArray([Pixel(distribution)], 1, 1, aim)


def test_faint_light_is_dropped_and_told():
    all_of_it, cut = (assemble(alone(gaussian()), GRID, cutoff) for cutoff in (0, 0.1))
    assert all_of_it.dropped == 0
    assert cut.matrix.data.min() > 0.1 * cut.matrix.data.max()
    assert cut.dropped == pytest.approx(1 - cut.matrix.sum() / all_of_it.matrix.sum(), rel=1e-9)
    # A Gaussian holds as much of its light below a share of its peak as that share.
    assert cut.dropped == pytest.approx(0.1, abs=0.02)


def test_a_grid_of_turned_pixels_is_exact_in_angles(tmp_path):
    lm63.write(tmp_path / "pixel.ies", gaussian())
    array = FileSource(path=tmp_path / "pixel.ies", rows=3, columns=5, pitch_deg=8, aspect=2).pixels()
    grid = TexelGrid.from_degrees(180, 420, 21, -21, -9, 9)
    matrix = assemble(array, grid, cutoff=0).matrix.toarray().reshape(grid.rows, grid.cols, 15)
    solid = solid_angles(grid)
    for row in range(3):
        for column in range(5):
            light = matrix[:, :, 5 * row + column] * solid
            # Type A angles of a turn by yaw and pitch: h is the yaw, v the pitch.
            h, v = 8 * (column - 2), 4 * (1 - row)
            v_at, h_at = angles_of("A", (rays(grid) * light).sum((1, 2)))
            assert (h_at, v_at) == pytest.approx((h, v), abs=0.005)  # texels are 0.1 deg
            # Each place keeps the pixel's flux, as a shift in tangents would not: 10 % more at 16 deg.
            assert light.sum() == pytest.approx(gaussian().luminous_flux, rel=5e-3)


def test_default_texture_holds_all_light_and_is_finer_than_the_data():
    array = PixelArray([Pixel(gaussian(h, angles=np.linspace(-6, 6, 121))) for h in (-2.0, 3.0)], 1, 2)
    grid = default_grid(array)
    made = assemble(array, grid)
    texel_deg = math.degrees((grid.left - grid.right) / grid.cols), math.degrees((grid.top - grid.bottom) / grid.rows)
    assert max(texel_deg) <= 0.051  # twice as fine as 0.1 deg
    assert made.rmse < 0.01
    assert made.matrix.toarray().reshape(grid.rows, grid.cols, 2)[:, [0, -1]].max() < 0.01 * 1000


@given(st.floats(-100, 100), st.floats(-80, 80), st.floats(0, 60))
def test_no_ray_of_a_cone_is_missed(yaw_deg, pitch_deg, reach_deg):
    grid = TexelGrid.from_degrees(30, 40, 60, -70, -50, 45)
    axis = directions_of("A", pitch_deg, yaw_deg)
    inside = np.tensordot(axis, rays(grid), 1) >= math.cos(math.radians(reach_deg))
    rows, cols = _window(grid, axis, math.radians(reach_deg))
    assert set(np.flatnonzero(inside.any(1))) <= set(rows)
    assert set(np.flatnonzero(inside.any(0))) <= set(cols)


def test_colour_has_luminance_one_and_follows_the_channels():
    red, blue = gaussian(-0.2), gaussian(0.2)
    luminance = replace(red, candela=0.2126 * red.candela + 0.0722 * blue.candela)
    none = replace(red, candela=0 * red.candela)
    made = assemble(PixelArray([Pixel(luminance, rgb=(red, none, blue))], 1, 1), GRID)
    np.testing.assert_allclose(np.array([0.2126, 0.7152, 0.0722]) @ made.chroma, 1, rtol=1e-12)
    texels = made.matrix.toarray().ravel()
    lit = np.flatnonzero(texels)
    np.testing.assert_allclose(made.chroma[0] * texels[lit], light_texture(red, GRID).ravel()[lit], atol=0.1)  # as above


def test_memory_of_assembly_is_what_the_estimate_says():
    wide = gaussian(angles=np.linspace(-10, 10, 25), sigma_deg=20.0)  # lights all texels
    array = PixelArray([Pixel(wide, rgb=(wide, wide, wide))] * 25, 5, 5)
    assemble(array, replace(GRID, rows=10))  # what is made once does not count
    tracemalloc.start()
    made = assemble(array, GRID)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    share = peak / made.matrix.nnz / pixels._bytes_an_entry(array)
    assert 0.8 < share <= 1.0


def test_a_measurement_tells_what_it_cuts_off():
    h, v = np.meshgrid(ANGLES, ANGLES, indexing="ij")
    cone = np.clip(4 - np.hypot(h, v), 0, None)
    assert border_share(Distribution("A", ANGLES, ANGLES, cone)) == pytest.approx(0.25)
    assert border_share(gaussian()) == 0
    quadrant = ANGLES[ANGLES >= 0]  # a table that begins at zero is mirrored there, which is no border
    assert border_share(Distribution("A", quadrant, quadrant, cone[12:, 12:])) == pytest.approx(0.25)
    even = np.full((1, 2), 7.0)
    assert border_share(Distribution("C", np.array([0.0, 180.0]), np.array([0.0]), even)) == 0
    assert border_share(Distribution("C", np.array([0.0, 90.0]), np.array([0.0]), even)) == 1
    assert border_share(Distribution("A", ANGLES, ANGLES, 0 * cone)) == 0


def test_a_matrix_beyond_all_memory_is_refused_before_the_work_with_values_that_do(monkeypatch):
    monkeypatch.setattr(pixels, "BUDGET_BYTES", 64 * 175_000)
    monkeypatch.setattr(files, "BUDGET_BYTES", 64 * 175_000)
    array, seen = PixelArray([Pixel(gaussian())] * 100, 10, 10), []
    with refusal(r"its 100 pixels, .* of 60 x 80 texels by estimate, .*; set texture.rows") as refused:
        assemble(array, GRID, on_progress=lambda done, of: seen.append(done))
    assert seen == []
    found = re.search(r"rows = (\d+) and texture.columns = (\d+), or cutoff = ([\d.]+)$", str(refused.value))
    assert found is not None, refused.value
    coarser = replace(GRID, rows=int(found[1]), cols=int(found[2]))
    for few in (assemble(array, coarser), assemble(array, GRID, float(found[3]))):
        assert 100_000 < few.matrix.nnz <= 175_000
