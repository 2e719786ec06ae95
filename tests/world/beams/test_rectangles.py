"""Rectangles that controllers are judged by."""

import pytest
import torch

from luxloop.world.errors import LuxloopError
from luxloop.world.lamps.patterns import QUICK, RECTANGLES, Rectangle
from luxloop.world.texels import TexelGrid

GRID = TexelGrid.from_degrees(100, 400, 20, -20, -5, 5)


def test_there_are_1215_and_45_of_them() -> None:
    assert len(set(RECTANGLES)) == 9 * 5 * 3 * 3 * 3 == 1215
    assert len(set(QUICK)) == 45
    assert set(QUICK) <= set(RECTANGLES)


def test_texture() -> None:
    texture = Rectangle(5, -1, 6, 2).texture(GRID, 7.0)
    assert texture.unique().tolist() == [0.0, 7.0]
    row, col = GRID.texel_of(*(torch.tensor([value]).deg2rad().tan() for value in (5.0, -1.0)))
    assert texture[int(row), int(col)] == 7.0
    solid_angle = 6 * 2 / (40 * 10) * GRID.n_texels
    assert (texture > 0).sum().item() == pytest.approx(solid_angle, rel=0.08)  # whole texels, 60 x 20, of a plane


def test_turning() -> None:
    upright, lying = (Rectangle(0, 0, 1, 3, turn).texture(GRID) for turn in (0, 90))
    assert (lying > 0).any(0).sum() > 2.5 * (upright > 0).any(0).sum()
    h, v = torch.tensor([1.0, -1.0]), torch.tensor([0.55, 0.55])
    left_up, right_up = (Rectangle(0, 0, 3, 0.4, 30).distance(h, v) <= 0).tolist()
    assert left_up and not right_up  # left is positive, so counter-clockwise lifts the left side


def test_rectangles_beside_the_texture_are_refused() -> None:
    with pytest.raises(LuxloopError, match="no texel"):
        Rectangle(40, 0, 1, 1).texture(GRID)
