"""Frames of reference, and pinhole views in them."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from luxloop.world.frames import T_ISO_OPENCV, View, inverse, pose, pose_from_degrees, rotation, transform

angle = st.floats(-math.pi, math.pi)
metre = st.floats(-1000, 1000)


@given(angle, angle, angle)
def test_rotation_is_yaw_after_pitch_after_roll(roll, pitch, yaw):
    R = rotation(*torch.tensor([roll, pitch, yaw], dtype=torch.float64))
    np.testing.assert_allclose(R, Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), atol=1e-14)


@given(st.tuples(metre, metre, metre), st.tuples(angle, angle, angle))
def test_inverse_undoes_a_pose(position, angles):
    T = pose(torch.tensor(position, dtype=torch.float64), rotation(*torch.tensor(angles, dtype=torch.float64)))
    torch.testing.assert_close(inverse(T) @ T, torch.eye(4, dtype=torch.float64), rtol=0, atol=1e-12)
    points = torch.tensor([[1.0, -2.0], [3.0, 0.5], [0.0, 7.0]], dtype=torch.float64)
    # Kilometres in float64 leave 1e-13 m; a decade for the two products.
    torch.testing.assert_close(transform(inverse(T), transform(T, points)), points, rtol=0, atol=1e-11)


def view(T_world_mount: torch.Tensor | None = None) -> View:
    T = pose_from_degrees((0.0, 0.0, 0.0)) if T_world_mount is None else T_world_mount
    return View(8, 6, fx=10.0, fy=12.0, cx=4.0, cy=2.5, T_world_view=T @ T_ISO_OPENCV)


@given(st.tuples(*[st.floats(-100, 100)] * 3), st.tuples(*[st.floats(-180, 180)] * 3), st.floats(0.1, 1000))
def test_rays_project_onto_their_pixel_centres(position, angles, depth_m):
    v = view(pose_from_degrees(position, *angles))
    uv, depth = v.project(v.origin[:, None] + depth_m * v.rays().flatten(1))
    # 100 m of offset at 0.1 m of depth cost three digits of float64.
    assert depth.numpy() == pytest.approx(depth_m, rel=1e-9)
    rows, cols = np.mgrid[:6, :8]
    np.testing.assert_allclose(uv.reshape(2, 6, 8), [cols + 0.5, rows + 0.5], atol=1e-9)
