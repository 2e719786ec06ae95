"""Bezier curves against SciPy's polynomials and quadrature, and the closest point against brute force."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import BPoly

from luxloop.controllers.functions.path import closest, derivative, length_at, point

T = torch.linspace(0, 1, 21, dtype=torch.float64)


def curve(degree: int, seed: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(size=(degree + 1, 2)) * 5)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 5, 8])
def test_points_and_derivatives_equal_scipy(degree):
    control = curve(degree, degree)
    oracle = BPoly(control.numpy()[:, None, :], [0, 1])
    np.testing.assert_allclose(point(control, T), oracle(T.numpy()), atol=1e-12)
    np.testing.assert_allclose(point(derivative(control), T), oracle.derivative()(T.numpy()), atol=1e-11)


@pytest.mark.parametrize("degree", [1, 2, 3, 6])
def test_arc_length_equals_quadrature(degree):
    control = curve(degree, degree + 10)
    slope = BPoly(control.numpy()[:, None, :], [0, 1]).derivative()
    expected = [quad(lambda t: np.linalg.norm(slope(t)), 0, t, limit=200)[0] for t in T.numpy()]
    np.testing.assert_allclose(length_at(control, T), expected, rtol=1e-6, atol=1e-6)  # adaptive quadrature's own 1e-8, near-cusps


@settings(max_examples=25)
@given(degree=st.integers(1, 6), seed=st.integers(0, 1000))
def test_no_point_of_the_curve_is_closer(degree, seed):
    control = curve(degree, seed)
    points = torch.from_numpy(np.random.default_rng(seed + 1).normal(size=(40, 2)) * 8)
    t, distance = closest(control, points)
    assert ((t >= 0) & (t <= 1)).all()
    torch.testing.assert_close((point(control, t) - points).norm(dim=-1), distance)
    dense = torch.cdist(points, point(control, torch.linspace(0, 1, 20_001, dtype=torch.float64))).amin(-1)
    # Two almost equal minima in one sampling interval may be taken for each other; brute force itself is coarse by 1e-3.
    assert (distance <= dense + 1e-3 + 1e-3 * dense).all()


def test_batches_and_devices(device):
    controls = torch.stack([curve(3, s) for s in range(4)]).float().to(device)
    points = torch.randn(4, 9, 2, device=device)
    t, distance = closest(controls, points)
    assert t.device.type == device.type and distance.dtype == torch.float32
    for i in range(4):
        torch.testing.assert_close(distance[i], closest(controls[i], points[i])[1])
    assert length_at(controls, t).shape == (4, 9)


def test_a_curve_that_is_a_point_has_no_length():
    control = torch.tensor([[1.0, 2.0]] * 4)
    t, distance = closest(control, torch.tensor([[4.0, 6.0]]))
    assert distance.item() == 5 and not length_at(control, t).any()


def test_the_ends_are_found_by_points_beyond_them():
    line = torch.tensor([[0.0, 0.0], [10.0, 0.0]])
    t, distance = closest(line, torch.tensor([[-3.0, 4.0], [13.0, -4.0], [5.0, 2.0]]))
    torch.testing.assert_close(t, torch.tensor([0.0, 1.0, 0.5]))
    torch.testing.assert_close(distance, torch.tensor([5.0, 5.0, 2.0]))
