"""Which texels a pixel samples, and the earlier ways of control that this gives (docs/ssc.md)."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import torch

from luxloop.controllers.pixels.pixel_major import MrpcParams, rectangular
from luxloop.controllers.pixels.primitives import rectangle
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.world.frames import pose_from_degrees
from luxloop.world.lamps.presets import idealised, lamp
from luxloop.world.spmv import Csr

LAMP = idealised(8, 20)
T = pose_from_degrees((0.0, 0.0, 0.0))


def test_a_rectangle_keeps_the_pixel_s_light_and_fills_its_box():
    A = np.zeros((1, 30))
    A[0, [7, 8, 13]] = [4.0, 2.0, 1.9]  # 5 x 6 texels: two in row 1, one in row 2, which is below half of the peak
    A[0, 14] = 2.5
    grid = idealised(1, 1)
    box = rectangular(Csr.from_scipy(sp.csr_array(A), torch.float64), replace(grid, rows=5, cols=6), 0.5)
    dense = box.to_scipy().toarray().reshape(5, 6)
    assert (dense > 0).sum() == 4
    assert (dense[1:3, 1:3] > 0).all()
    assert dense.sum() == pytest.approx(4 + 2 + 1.9 + 2.5)
    diagonal = Csr.from_scipy(sp.csr_array(np.eye(3).reshape(1, 9)), torch.float64)
    filled = rectangular(diagonal, replace(grid, rows=3, cols=3), 0.5).to_scipy().toarray()
    assert (filled > 0).all() and filled.sum() == pytest.approx(3) and filled[0, 1] < 2e-3


def test_simplified_pixels_draw_a_homogeneous_wall():
    light = lamp("hd84").modules[0].headlight
    wall = rectangle((10.0, 100.0, 100.0), (0.0, -200.0, 0.0), (0.0, 0.0, -200.0), 0.5, "u_abs", normal=(-1.0, 0.0, 0.0))
    u = Ssc.prepare(light, MrpcParams(shape="rectangle", mapping="direct", a_x=0.5)).utilisation(wall, T).u
    torch.testing.assert_close(u, torch.full_like(u, 0.5), rtol=0, atol=1e-5)


def test_rendering_is_free_of_anti_aliasing():
    """One ray a pixel: it is asked for what its middle hits, all or nothing."""
    edge = rectangle((10.0, 1.0, 1.0), (0.0, -2.0, 0.0), (0.0, 0.0, -2.0), 1.0, "u_abs", normal=(-1.0, 0.0, 0.0))
    hard, soft = (Ssc.prepare(LAMP, params).utilisation(edge, T).u for params in (MrpcParams(sampling="brightest"), None))
    assert set(hard.unique().tolist()) == {0.0, 1.0}
    assert len(soft.unique()) > 2
