"""Frames against scipy's rotations, and the signs that people rely on."""

import math

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from luxloop.world.frames import inverse, pose, rotation, transform

angle = st.floats(-math.pi, math.pi)
metre = st.floats(-1000, 1000)


@settings(deadline=None)
@given(angle, angle, angle)
def test_rotation_is_yaw_after_pitch_after_roll(roll: float, pitch: float, yaw: float) -> None:
    R = rotation(*torch.tensor([roll, pitch, yaw], dtype=torch.float64))
    np.testing.assert_allclose(R, Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), atol=1e-14)


def test_signs_of_iso_8855(device: torch.device) -> None:
    forward, left = torch.eye(3, device=device)[:2]
    small, zero = torch.tensor(0.1, device=device), torch.tensor(0.0, device=device)
    assert (rotation(zero, small, zero) @ forward)[2] < 0, "positive pitch lowers the nose"
    assert (rotation(small, zero, zero) @ left)[2] > 0, "positive roll lowers the right side"
    assert (rotation(zero, zero, small) @ forward)[1] > 0, "positive yaw turns to the left"


@settings(deadline=None)
@given(st.tuples(metre, metre, metre), st.tuples(angle, angle, angle))
def test_inverse_undoes_a_pose(position: tuple[float, float, float], angles: tuple[float, float, float]) -> None:
    T = pose(torch.tensor(position, dtype=torch.float64), rotation(*torch.tensor(angles, dtype=torch.float64)))
    torch.testing.assert_close(inverse(T) @ T, torch.eye(4, dtype=torch.float64), rtol=0, atol=1e-12)
    points = torch.tensor([[1.0, -2.0], [3.0, 0.5], [0.0, 7.0]], dtype=torch.float64)
    # Kilometres in float64 leave 1e-13 m; a decade for the two products.
    torch.testing.assert_close(transform(inverse(T), transform(T, points)), points, rtol=0, atol=1e-11)
