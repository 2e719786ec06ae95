"""The light texture's conventions and the idealised lamp."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from luxloop.world.lamps.presets import idealised


def tan(degrees: float) -> float:
    return math.tan(math.radians(degrees))


def test_overlap_is_minimal():
    thesis_lamp = idealised()
    entries_per_texel = thesis_lamp.matrix.values.shape[0] / thesis_lamp.matrix.n_rows
    # Two of four texels along a pixel lie on its flanks; only the border of the lamp has fewer.
    assert entries_per_texel == pytest.approx(1.5, rel=0.002)
    assert thesis_lamp.matrix.values.min() > 0


def test_pixels_are_row_major_from_the_top_left():
    lamp = idealised(3, 4)
    light = lamp.light_texture(torch.eye(12))
    y, z = lamp.tangents(torch.float32, torch.device("cpu"))
    total = light.sum((-2, -1))
    pixel_y, pixel_z = (light.sum(-2) @ y) / total, (light.sum(-1) @ z) / total
    pitch_y, pitch_z = (lamp.left - lamp.right) / 4, (lamp.top - lamp.bottom) / 3
    for j in range(12):
        row, col = divmod(j, 4)
        # Pixels at the lamp's border lose their outer flank: less than a twentieth of the pitch.
        assert pixel_y[j].item() == pytest.approx(lamp.left - (col + 0.5) * pitch_y, abs=0.05 * pitch_y)
        assert pixel_z[j].item() == pytest.approx(lamp.top - (row + 0.5) * pitch_z, abs=0.05 * pitch_z)


def test_texel_centres_lie_half_a_texel_inside(device):
    lamp = idealised(2, 3, texels_per_pixel=(2, 1), half_width_deg=15, top_deg=1.5, bottom_deg=-3.5)
    y, z = lamp.tangents(torch.float64, device)
    expected_y = [tan(15) + (c + 0.5) / 3 * (tan(-15) - tan(15)) for c in range(3)]
    expected_z = [tan(1.5) + (r + 0.5) / 4 * (tan(-3.5) - tan(1.5)) for r in range(4)]
    np.testing.assert_allclose(y.cpu(), expected_y, atol=1e-15)
    np.testing.assert_allclose(z.cpu(), expected_z, atol=1e-15)
    row, col = lamp.texel_of(y[[1]], z[[3]])
    assert (row.item(), col.item()) == (pytest.approx(3.5), pytest.approx(1.5))


def test_mirroring_twice_gives_the_module_back_and_once_swaps_left_and_right():
    lamp = replace(idealised(3, 5, texels_per_pixel=(2, 3)), left=tan(12), chroma=None)
    lamp = replace(lamp, chroma=torch.rand(3, len(lamp.matrix.values)))
    mirrored = lamp.mirror()
    assert (mirrored.left, mirrored.right) == (-lamp.right, -lamp.left)
    u = torch.rand(3, 5)
    assert_equal = partial(torch.testing.assert_close, rtol=1e-6, atol=1e-2)
    assert_equal(mirrored.light_texture(u.flip(1).reshape(-1)), lamp.light_texture(u.reshape(-1)).flip(1))
    assert_equal(mirrored.colour_texture(u.flip(1).reshape(-1)), lamp.colour_texture(u.reshape(-1)).flip(2))
    twice = mirrored.mirror()
    assert twice.matrix.values.equal(lamp.matrix.values) and twice.matrix.indices.equal(lamp.matrix.indices)


def test_intensity_meets_texel_centres_and_is_dark_outside_and_behind():
    lamp = idealised(4, 6, texels_per_pixel=(2, 2))
    texture = lamp.light_texture(torch.rand(lamp.n_pixels)).double()
    y, z = lamp.tangents(torch.float64, texture.device)
    directions = torch.stack([torch.ones(lamp.rows, lamp.cols).double(), y.expand(lamp.rows, -1), z[:, None].expand(-1, lamp.cols)])
    found = lamp.intensity(texture, 3 * directions.flatten(1)).view(texture.shape)
    torch.testing.assert_close(found, texture, rtol=1e-9, atol=1e-6)
    outside = torch.tensor([[1.0, 1.0, -1.0], [1.1 * lamp.left, 0.0, 0.0], [0.0, 1.1 * lamp.top, 0.0]]).double()
    assert lamp.intensity(texture, outside).tolist() == [0, 0, 0]


@pytest.mark.parametrize(("row", "col"), [(0, 0), (3, 6), (2, 4)])
def test_a_pixel_lights_the_rows_and_columns_that_are_said(row, col):
    lamp = idealised(4, 7, texels_per_pixel=(4, 2), intensity_cd=1e4)
    u = torch.zeros(4, 7)
    u[row, col] = 1
    light = lamp.light_texture(u.flatten())
    rows, cols = lamp.rows_of(slice(7 * row + col, 7 * row + col + 1)), lamp.cols_of(slice(col, col + 1))
    found = [torch.nonzero(light.any(axis))[:, 0].tolist() for axis in (1, 0)]
    assert [list(range(rows.start, rows.stop)), list(range(cols.start, cols.stop))] == found
    assert torch.equal(lamp.light_rows(u.flatten(), rows), light[rows])
