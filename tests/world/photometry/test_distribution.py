"""Angles of the three types, symmetries unfolded, and flux by integration."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from luxloop.world.photometry import Distribution
from luxloop.world.photometry.distribution import Kind, angles_of
from tests.refusal import refusal

HALF = math.sqrt(0.5)
AHEAD, RIGHT, UP, DOWN = (1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)
RIGHT_45, UP_45 = (HALF, -HALF, 0), (HALF, 0, HALF)


def uniform(kind: Kind, v: list[float], h: list[float]) -> Distribution:
    return Distribution(kind, np.array(v, float), np.array(h, float), np.ones((len(h), len(v))))


@pytest.mark.parametrize(
    ("kind", "aim", "direction", "v", "h"),
    [
        ("A", "beam", AHEAD, 0, 0),
        ("A", "beam", RIGHT, 0, 90),
        ("A", "beam", UP_45, 45, 0),
        ("A", "nadir", RIGHT_45, 0, 45),
        # Up by 45 deg and then right by 45: A turns about the vertical, B tilts the plane first.
        ("A", "beam", (0.5, -0.5, HALF), 45, 45),
        ("B", "beam", (0.5, -HALF, 0.5), 45, 45),
        ("B", "beam", AHEAD, 0, 0),
        ("B", "beam", RIGHT, 0, 90),
        ("B", "nadir", DOWN, 0, 0),
        ("B", "nadir", AHEAD, 90, 0),
        ("C", "beam", AHEAD, 0, None),
        ("C", "beam", RIGHT_45, 45, 0),
        ("C", "beam", UP_45, 45, 90),
        ("C", "nadir", DOWN, 0, None),
        ("C", "nadir", RIGHT, 90, 0),
        ("C", "nadir", AHEAD, 90, 90),
    ],
)
def test_angles_are_those_of_the_standard(kind, aim, direction, v, h):  # type: ignore[no-untyped-def]
    v_at, h_at = angles_of(kind, np.array(direction, float), aim)
    assert v_at == pytest.approx(v, abs=1e-12)
    assert h is None or h_at == pytest.approx(h, abs=1e-12)


def test_type_b_is_type_c_by_the_known_conversion():
    """tan B = cos C' tan gamma and sin beta = sin C' sin gamma, planes C' counted from the one in which B turns (up) to the right."""
    directions = np.random.default_rng(1).normal(size=(3, 50))
    directions[0] = abs(directions[0])
    v, h = np.deg2rad(angles_of("B", directions))
    gamma, c = np.deg2rad(angles_of("C", directions))
    assert_allclose(np.tan(v), np.cos(np.pi / 2 - c) * np.tan(gamma), rtol=1e-9)
    assert_allclose(np.sin(h), np.sin(np.pi / 2 - c) * np.sin(gamma), rtol=1e-9)


@pytest.mark.parametrize(
    ("stored", "queries", "expected"),
    [
        ([0], [0, 90, 200, 359], [1, 1, 1, 1]),
        ([0, 90], [45, 135, 225, 315, 90, 270, 180], [1.5, 1.5, 1.5, 1.5, 2, 2, 1]),
        ([0, 90, 180], [45, 135, 225, 315, 270, -90], [1.5, 2.5, 2.5, 1.5, 2, 2]),
        ([90, 180, 270], [135, 45, 0, 360, 315], [1.5, 1.5, 2, 2, 2.5]),
        ([-90, 0, 90], [0, 90, 180, 270, 135], [2, 3, 2, 1, 2.5]),
        ([0, 90, 180, 270, 360], [45, 315, 405], [1.5, 4.5, 1.5]),
        ([0, 90, 180, 270], [45, 315, 360], [1.5, 2.5, 1]),  # EULUMDAT's last plane is followed by its first
        ([0, 10, 20], [5, 20, 90, 350], [1.5, 3, 0, 0]),
    ],
)
def test_planes_of_type_c_are_unfolded(stored, queries, expected):
    candela = np.repeat(np.arange(1.0, len(stored) + 1)[:, None], 2, axis=1)
    distribution = Distribution("C", np.array([0.0, 180]), np.array(stored, float), candela)
    assert_allclose(distribution.at(60, np.array(queries, float)), expected, rtol=1e-12)


def test_types_a_and_b_are_mirrored_where_they_begin_at_zero_and_dark_beyond_their_ends():
    candela = np.array([[4.0, 2], [3, 1]])
    for kind in ("A", "B"):
        folded = Distribution(kind, np.array([0.0, 10]), np.array([0.0, 20]), candela)
        assert_allclose(folded.at([10, -10, 5, 11, 0], [20, -20, -10, 0, 21]), [1, 1, 2.5, 0, 0])
        sided = Distribution(kind, np.array([-1.0, 10]), np.array([1.0, 20]), candela)
        assert_allclose(sided.at([-1, 10, -5, 0], [1, 20, 10, -5]), [4, 1, 0, 0])


@pytest.mark.parametrize(
    ("distribution", "flux"),
    [
        (uniform("C", [0, 180], [0]), 4 * math.pi),
        (uniform("C", [0, 30, 90], [0, 45, 90]), 2 * math.pi),
        (uniform("C", [90, 180], [0, 180]), 2 * math.pi),
        (uniform("A", [-90, 90], [-90, 90]), 2 * math.pi),
        (uniform("A", [0, 90], [0, 90]), 2 * math.pi),
        (uniform("B", [-90, 0, 90], [0, 90]), 2 * math.pi),
        (uniform("A", [-90, 90], [0]), 4 * math.pi),
        (uniform("A", [-5, 5], [-10, 10]), 2 * math.sin(math.radians(5)) * math.radians(20)),
        (uniform("B", [-5, 5], [-10, 10]), 2 * math.sin(math.radians(10)) * math.radians(10)),
    ],
)
def test_uniform_light_has_the_flux_of_its_solid_angle(distribution, flux):
    assert distribution.luminous_flux == pytest.approx(flux, rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "v", "h", "candela", "word"),
    [
        ("A", [0.0], [0.0], [[1.0]], "at least 2 vertical"),
        ("A", [0.0, 0], [0.0], [[1.0, 1]], "ascend"),
        ("C", [-1.0, 0], [0.0], [[1.0, 1]], "0 to 180"),
        ("B", [0.0, 1], [0.0, 91], [[1.0, 1], [1, 1]], "-90 to 90"),
        ("A", [0.0, 1], [0.0], [[1.0], [1]], "rows"),
        ("A", [0.0, 1], [0.0], [[1.0, -1]], "not negative"),
        ("A", [0.0, 1], [0.0], [[1.0, math.nan]], "finite"),
    ],
)
def test_nonsense_is_refused(kind, v, h, candela, word):
    with refusal(word):
        Distribution(kind, np.array(v), np.array(h), np.array(candela))
