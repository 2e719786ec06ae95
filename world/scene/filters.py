"""Filters of second order, the same numbers as of `scipy.signal`, whose import alone takes a second."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def discrete(numerator: tuple[float, float], denominator: tuple[float, float], dt: float) -> tuple[Floats, Floats]:
    """Coefficients b and a, `[3]` each, of a system of which the input changes linearly from value to value, dt in s apart.

    The system is `(n_0 s + n_1) / (s^2 + d_0 s + d_1)`. As `scipy.signal.cont2discrete` with the method foh.
    """
    from scipy.linalg import expm

    C = np.array([numerator])
    step = np.zeros((4, 4))  # of the state, the input and its slope
    step[:2, :3] = np.array([[-denominator[0], -denominator[1], 1.0], [1.0, 0.0, 0.0]]) * dt
    step[2, 3] = 1.0
    whole = expm(step)
    A, now, slope = whole[:2, :2], whole[:2, 2:3], whole[:2, 3:]
    B, D = now - slope + A @ slope, C @ slope
    a: Floats = np.asarray(np.poly(A), np.float64)
    return np.asarray(np.poly(A - B @ C) + (D[0] - 1) * a, np.float64), a


def filtered(b: Floats, a: Floats, values: Floats, known: Floats | None = None) -> Floats:
    """Values `[N]` through a filter, from equilibrium at the first, or going on after two known results `[2]` for the first two."""
    if known is None:
        companion = np.array([[-a[1], -a[2]], [1.0, 0.0]])
        z_0, z_1 = (np.linalg.solve(np.eye(2) - companion.T, b[1:] - a[1:] * b[0]) * values[0]).tolist()
        return _run(b, a, values, z_0, z_1)
    last, before = values[1::-1], known[::-1]
    z_0, z_1 = ((b[m + 1 :] * last[: 2 - m]).sum() - (a[m + 1 :] * before[: 2 - m]).sum() for m in range(2))
    return np.concatenate([known, _run(b, a, values[2:], float(z_0), float(z_1))])


def _run(b: Floats, a: Floats, values: Floats, z_0: float, z_1: float) -> Floats:
    """Transposed direct form II from a state."""
    (b_0, b_1, b_2), (_, a_1, a_2), results = b.tolist(), a.tolist(), []
    for x in values.tolist():
        y = z_0 + b_0 * x
        z_0, z_1 = z_1 + x * b_1 - y * a_1, x * b_2 - y * a_2
        results.append(y)
    return np.array(results, np.float64)
