"""Pixel models: against integrals done numerically, light kept on any texture, and sentences for what does not fit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.integrate import quad
from scipy.stats import norm

from luxloop.world.headlight.parametric import BlurredRectangles, GaussianPixels
from luxloop.world.texels import TexelGrid

GRID = TexelGrid.from_degrees(60, 90, 12, -9, -5, 6)
RECTANGLES = {
    "rows": 4,
    "columns": 6,
    "left_deg": 7.0,
    "right_deg": -6.0,
    "bottom_deg": -2.0,
    "top_deg": 3.0,
    "blur_deg": 0.4,
    "peak_cd": 8000.0,
}
GAUSSIANS = {
    "columns": 5,
    "left_deg": 8.0,
    "right_deg": -6.0,
    "row_centres_deg": (2.5, 0.0, -2.0),
    "row_sigmas_deg": (0.9, 0.4, 0.7),
    "column_sigma": 0.5,
    "peak_cd": (9000.0, 20000.0, 7000.0),
}


def dense(model: BlurredRectangles | GaussianPixels, grid: TexelGrid = GRID) -> np.ndarray:
    """`[rows, cols, pixel rows, pixel columns]` in cd."""
    matrix, pixel_rows, pixel_cols = model.matrix(grid)
    return matrix.toarray().reshape(grid.rows, grid.cols, pixel_rows, pixel_cols)


def angle_borders(grid: TexelGrid) -> tuple[np.ndarray, np.ndarray]:
    rows, cols = np.linspace(grid.top, grid.bottom, grid.rows + 1), np.linspace(grid.left, grid.right, grid.cols + 1)
    return np.degrees(np.arctan(rows)), np.degrees(np.arctan(cols))


def test_a_texel_holds_the_mean_of_the_blurred_rectangle_over_its_width():
    light = dense(BlurredRectangles(**RECTANGLES, widening=0.5, overlap=0.3, cut=0.0))
    rows, cols = angle_borders(GRID)
    heights = np.linspace(3, -2, 5)
    s = np.linspace(-1, 1, 7)
    columns = 0.5 - 13 * (s + 0.5 * s**3 / 3) / (1 + 0.5 / 3) / 2  # pitch in proportion to 1 + 0.5 s^2

    def mean(borders: tuple[float, float], low: float, high: float) -> float:
        extra = 0.15 * (high - low)
        profile = lambda x: (norm.cdf((x - low + extra) / 0.4) - norm.cdf((x - high - extra) / 0.4)) / 1.3  # noqa: E731
        return quad(profile, borders[1], borders[0], epsabs=1e-12)[0] / (borders[0] - borders[1])

    for r, c, i, j in ((20, 30, 1, 2), (28, 45, 2, 3), (35, 20, 3, 1)):
        dimming = 1 / (1 + 0.5 * (0.5 * (s[j] + s[j + 1])) ** 2)
        vertical = mean((rows[r], rows[r + 1]), heights[i + 1], heights[i])
        horizontal = mean((cols[c], cols[c + 1]), columns[j + 1], columns[j])
        assert light[r, c, i, j] == pytest.approx(8000 * dimming * vertical * horizontal, rel=1e-9, abs=1e-9)


@settings(max_examples=25)
@given(
    blur=st.floats(0, 0.8),
    overlap=st.floats(0, 1),
    widening=st.floats(0, 1),
    spacing=st.sampled_from(["angle", "tangent"]),
    rows=st.integers(20, 90),
)
def test_light_is_kept_on_any_texture(blur, overlap, widening, spacing, rows):
    values = RECTANGLES | {"blur_deg": blur, "overlap": overlap, "widening": widening, "spacing": spacing, "cut": 0.0}
    model = BlurredRectangles(**values)

    def sums(grid: TexelGrid) -> np.ndarray:
        borders = angle_borders(grid)
        if spacing == "tangent":
            borders = tuple(np.degrees(np.tan(np.radians(axis))) for axis in borders)
        area = np.outer(*(-np.diff(axis) for axis in borders))
        return np.einsum("rc,rcij->ij", area, dense(model, grid))

    coarse, fine = sums(TexelGrid.from_degrees(rows, rows, 12, -11, -7, 8)), sums(TexelGrid.from_degrees(64, 96, 12, -11, -7, 8))
    np.testing.assert_allclose(coarse, fine, rtol=1e-9)


@pytest.mark.parametrize(
    ("model", "values", "said"),
    [
        (BlurredRectangles, {"left_deg": -7.0}, "left_deg: -7 is not above right_deg = -6"),
        (BlurredRectangles, {"top_deg": -3.0}, "top_deg: -3 is not above bottom_deg = -2"),
        (BlurredRectangles, {"row_heights": (1.0, 2.0)}, "row_heights has 2 values for 4 rows"),
        (GaussianPixels, {"peak_cd": (1.0,)}, "peak_cd has 1 values for the 3 rows"),
        (GaussianPixels, {"column_sigma": 1e300}, "column_sigma"),
        (GaussianPixels, {"peak_cd": (1.0, 1e308, 1.0)}, "peak_cd"),
        (GaussianPixels, {"row_centres_deg": (2.5, 0.0, -90.0)}, "row_centres_deg"),
        (GaussianPixels, {"columns": 10**10}, "columns"),
        (BlurredRectangles, {"rows": 10**10}, "rows"),
        (GaussianPixels, {"right_deg": 9.0}, "left_deg: 8 is not above right_deg = 9"),
    ],
)
def test_what_does_not_fit_is_said_in_a_sentence(model, values, said):
    base = RECTANGLES if model is BlurredRectangles else GAUSSIANS
    with pytest.raises(ValidationError, match=said):
        model(**base | values)


def test_a_texel_holds_the_mean_of_the_gaussian_over_its_width():
    light = dense(GaussianPixels(**GAUSSIANS, cut=0.0))
    rows, cols = angle_borders(GRID)
    pitch = 14 / 5

    def mean(high: float, low: float, centre: float, sigma: float) -> float:
        return quad(lambda x: np.exp(-0.5 * ((x - centre) / sigma) ** 2), low, high)[0] / (high - low)

    for r, c, i, j in ((20, 40, 0, 2), (32, 40, 1, 2), (40, 30, 2, 1)):
        expected = mean(rows[r], rows[r + 1], GAUSSIANS["row_centres_deg"][i], GAUSSIANS["row_sigmas_deg"][i])
        expected *= mean(cols[c], cols[c + 1], 8 - (j + 0.5) * pitch, 0.5 * pitch)
        assert light[r, c, i, j] == pytest.approx(GAUSSIANS["peak_cd"][i] * expected, rel=1e-9, abs=1e-9)
