"""The pinhole: rays and projection are each other's inverse, pixel centres lie at integer + 0.5."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from luxloop.world.frames import R_ISO_OPENCV, View, pose, pose_from_degrees

T_ISO_VIEW = pose(torch.zeros(3, dtype=torch.float64), R_ISO_OPENCV)


def view(T_world_mount: torch.Tensor | None = None) -> View:
    T = pose_from_degrees((0.0, 0.0, 0.0)) if T_world_mount is None else T_world_mount
    return View(8, 6, fx=10.0, fy=12.0, cx=4.0, cy=2.5, T_world_view=T @ T_ISO_VIEW)


@settings(deadline=None)
@given(st.tuples(*[st.floats(-100, 100)] * 3), st.tuples(*[st.floats(-180, 180)] * 3), st.floats(0.1, 1000))
def test_rays_project_onto_their_pixel_centres(position: tuple, angles: tuple, depth_m: float) -> None:
    v = view(pose_from_degrees(position, *angles))
    uv, depth = v.project(v.origin[:, None] + depth_m * v.rays().flatten(1))
    # 100 m of offset at 0.1 m of depth cost three digits of float64.
    assert depth.numpy() == pytest.approx(depth_m, rel=1e-9)
    rows, cols = np.mgrid[:6, :8]
    np.testing.assert_allclose(uv.reshape(2, 6, 8), [cols + 0.5, rows + 0.5], atol=1e-9)
