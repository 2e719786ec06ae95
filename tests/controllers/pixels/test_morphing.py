"""Beams that move as if the lamp had turned."""

import math

import pytest
import torch
from torch.testing import assert_close

from luxloop.controllers.pixels.morphing import Morph, Morphing, bend, level, roll
from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import rectangle
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.world.frames import pose_from_degrees
from luxloop.world.lamps.presets import idealised

LAMP = idealised(20, 40)
PLAIN = MrpcParams()


def spot(rows: slice, cols: slice) -> torch.Tensor:
    u = torch.zeros(LAMP.pixel_rows, LAMP.pixel_cols)
    u[rows, cols] = 0.8
    return u.flatten()


BEAM = spot(slice(6, 14), slice(14, 26))


def centre(u: torch.Tensor) -> tuple[float, float]:
    """Angles in rad of the middle of a utilisation's light, left and up positive."""
    light = LAMP.light_texture(u).double()
    y, z = LAMP.tangents()
    return math.atan((light.sum(0) @ y / light.sum()).item()), math.atan((light.sum(1) @ z / light.sum()).item())


def test_an_unmoved_beam_is_the_beam():
    same = Morphing(LAMP, BEAM, PLAIN).utilisation(bend(0.0))
    assert (same[BEAM == 0.8] - 0.8).abs().max() < 0.07  # pixels overlap by a fifth, which mapping and reduction blur at edges
    assert same.sum().item() == pytest.approx(BEAM.sum().item(), rel=1e-3)  # a_r = 1 conserves light


@pytest.mark.parametrize("yaw_deg", [-3.0, 1.0, 4.0])
def test_bend_moves_the_beam_by_its_angle(yaw_deg):
    before, after = centre(BEAM), centre(Morphing(LAMP, BEAM, PLAIN).utilisation(bend(math.radians(yaw_deg))))
    assert math.degrees(after[0] - before[0]) == pytest.approx(yaw_deg, abs=0.03)  # a texel is 0.25 deg wide
    assert math.degrees(after[1] - before[1]) == pytest.approx(0, abs=0.02)


def test_level_lowers_and_roll_turns_right_side_down():
    morphing = Morphing(LAMP, BEAM, PLAIN)
    assert math.degrees(centre(BEAM)[1] - centre(morphing.utilisation(level(math.radians(1.0))))[1]) == pytest.approx(1.0, abs=0.03)
    bar = Morphing(LAMP, spot(slice(8, 10), slice(0, 40)), PLAIN)
    rolled = bar.utilisation(roll(math.radians(5.0))).view(20, 40)
    left, right = (rolled[:, part].sum(1) @ torch.arange(20.0) / rolled[:, part].sum() for part in (slice(2, 12), slice(28, 38)))
    assert right > left + 1, "rows count downwards"


def test_size_stretches_about_the_middle():
    T = torch.eye(4, dtype=torch.float64)
    wide = Morphing(LAMP, BEAM, PLAIN).utilisation(Morph(T, width=1.5))
    assert wide.sum().item() == pytest.approx(1.5 * BEAM.sum().item(), rel=0.02)  # the same intensity over more of the field
    assert centre(wide)[0] == pytest.approx(centre(BEAM)[0], abs=math.radians(0.02))


def test_morphs_add_up_and_batch():
    morphing = Morphing(LAMP, BEAM, PLAIN)
    both = morphing.utilisation(bend(0.02).then(level(0.01)))
    stacked = Morph(torch.stack([bend(0.02).then(level(0.01)).T_headlight_screen, bend(0.0).T_headlight_screen]))
    batch = morphing.utilisation(stacked)
    assert_close(batch[0], both, rtol=0, atol=1e-5)
    assert_close(batch[1], morphing.utilisation(bend(0.0)), rtol=0, atol=1e-5)


def test_edge_darkening_spares_the_border_of_a_vignetted_field():
    """A moved hot spot asks the weak border for more than it has: full pixels there make a bright band (T fig. 7.18)."""
    vignette = torch.exp(-(torch.linspace(-2, 2, LAMP.pixel_cols) ** 2)).repeat(LAMP.pixel_rows)
    weak = LAMP.matrix.with_values(LAMP.matrix.values * vignette[LAMP.matrix.indices.long()])
    lamp = type(LAMP)(**{**vars(LAMP), "matrix": weak})
    beam, moved = torch.ones(lamp.n_pixels), bend(math.radians(2.5))
    plain = Morphing(lamp, beam, PLAIN).utilisation(moved).view(20, 40)
    dimmed = Morphing(lamp, beam, MrpcParams(a_d=1.0)).utilisation(moved).view(20, 40)
    assert plain[10, 1].item() == pytest.approx(1.0)
    assert dimmed[10, 1] < 0.5
    assert_close(dimmed[10, 16:24], plain[10, 16:24], rtol=0, atol=1e-6)


def test_primitives_lie_over_the_morphed_beam():
    moved = Morphing(LAMP, BEAM).utilisation(bend(math.radians(2.0)))
    wall = [torch.tensor(v) for v in ((10.0, 0.5, 0.3), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0))]
    half = rectangle(*wall[:3], 0.5, "u_rel", normal=wall[3])
    u = Ssc.prepare(LAMP).over(moved).utilisation(half, pose_from_degrees((0.0, 0.0, 0.0))).u
    inside = (slice(9, 12), slice(18, 22))
    assert_close(u.view(20, 40)[inside], moved.view(20, 40)[inside] / 2, rtol=1e-4, atol=1e-5)
    assert torch.equal(u.view(20, 40)[:, :10], moved.view(20, 40)[:, :10])
