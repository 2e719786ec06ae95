"""Filters are those of SciPy, to the last bit."""

import math

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, lfilter_zi, lfiltic

from world.scene.filters import discrete, filtered


@pytest.mark.parametrize("rate_hz, damping, dt", [(1.3, 0.3, 0.002), (1.7, 0.25, 0.005), (0.8, 1.4, 0.01), (12.0, 0.7, 0.0125)])
@pytest.mark.parametrize("damped", [True, False])
def test_filters_are_those_of_scipy(rate_hz: float, damping: float, dt: float, damped: bool) -> None:
    omega = 2 * math.pi * rate_hz
    numerator, denominator = (2 * damping * omega * damped, omega**2), (2 * damping * omega, omega**2)
    theirs = cont2discrete((numerator if damped else numerator[1:], (1.0, *denominator)), dt, method="foh")
    b, a = discrete(numerator, denominator, dt)
    assert np.array_equal(b, np.ravel(theirs[0])) and np.array_equal(a, theirs[1])
    values = np.random.default_rng(3).standard_normal(2000)
    settled = lfilter(b, a, values, zi=lfilter_zi(b, a) * values[0])[0]
    assert np.array_equal(filtered(b, a, values), settled)
    known = settled[500:502]
    going_on = lfilter(b, a, values[502:], zi=lfiltic(b, a, known[::-1], values[501:499:-1]))[0]
    assert np.array_equal(filtered(b, a, values[500:], known), np.concatenate([known, going_on]))
