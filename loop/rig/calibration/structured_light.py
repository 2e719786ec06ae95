"""Structured light: Gray codes and phase steps along rows and columns of a lamp's pixels, decoded at each camera pixel.

A cosine with a period of `PERIOD` pixels is shifted in `STEPS` steps; its phase is the position within a period. Gray codes of half a
period number the periods. Both are compared with the mean of the phase steps at the same camera pixel. Local regression gives the positions
of lamp pixels in the camera's picture, and Chebyshev polynomials a smooth map between both planes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.polynomial import chebyshev
from scipy.ndimage import maximum_filter, uniform_filter

from luxloop.loop.rig.arrays import Array, Mask

PERIOD = 16  # pixels
STEPS = 8
CELL = PERIOD // 2  # pixels per Gray code
LEAST_CONTRAST = 0.1  # amplitude of the cosine over its mean
AROUND = 7  # camera pixels along a side of the window of the local maximum
LEAST_LIGHT = 0.5  # share of the local maximum; light falls to half at the edge of the outermost pixels
NOISES = 6.0  # least amplitude of the cosine over its noise; wrong periods are then as rare as five standard deviations


def patterns(rows: int, cols: int) -> list[tuple[str, Array]]:
    """Names and utilisations `[n_p]` of the patterns for a module of rows x cols pixels; the first one is dark."""
    found = [("dark", np.zeros(rows * cols))]
    found += [(f"row_{name}", np.repeat(line, cols)) for name, line in _lines(rows)]
    return [*found, *((f"column_{name}", np.tile(line, rows)) for name, line in _lines(cols))]


def _lines(n: int) -> Iterator[tuple[str, Array]]:
    """Names and utilisations `[n]` of the patterns along one axis: phase steps, then bits of the Gray code, the highest first."""
    place = np.arange(n) + 0.5
    for k in range(STEPS):
        yield f"phase_{k}", 0.5 + 0.5 * np.cos(2 * np.pi * (place / PERIOD - k / STEPS))
    code = np.arange(n) // CELL
    code = code ^ code >> 1
    for bit in reversed(range(bits(n))):
        yield f"gray_{bit}", (code >> bit & 1).astype(float)


def bits(n: int) -> int:
    """Bits of the Gray code of n pixels."""
    return ((n - 1) // CELL).bit_length()


def decode(light: Sequence[Array], rows: int, cols: int, noise: float) -> tuple[Array, Array, Mask]:
    """Lamp coordinates (row, column) `[height, width]` at each camera pixel, and where they are valid.

    Lamp pixel (r, c) has its centre at (r + 0.5, c + 0.5). light: frames of `patterns`, `[height, width]` each in a linear unit. noise:
    standard deviation of a frame. Where the light of several pixels overlaps, the position is their weighted mean. Camera pixels beyond the
    outer edges of the field, lit by the outermost pixels alone, are invalid.
    """
    dark, coded = light[0], light[1:]
    valid = np.ones(dark.shape, bool)
    places = []
    for n in (rows, cols):
        phases, gray = coded[:STEPS], coded[STEPS : STEPS + bits(n)]
        coded = coded[STEPS + bits(n) :]
        mean = np.mean(phases, 0) - dark
        valid &= mean > LEAST_LIGHT * maximum_filter(mean, AROUND)
        place, good = _place(np.stack(phases) - dark, [each - dark for each in gray], noise)
        places.append(place)
        valid &= good & (place > 0) & (place < n)
    return places[0], places[1], valid


def _place(phases: Array, gray: Sequence[Array], noise: float) -> tuple[Array, Mask]:
    """Position `[height, width]` along one axis in pixels, and where it is valid."""
    turn = np.exp(2j * np.pi * np.arange(STEPS) / STEPS)
    sine = 2 / STEPS * np.tensordot(turn, phases, 1)  # its angle is the phase [height, width]
    mean = phases.mean(0)
    sound = np.abs(sine) > np.maximum(LEAST_CONTRAST * mean, NOISES * noise)
    code = before = np.zeros(mean.shape, int)
    for each in gray:
        before = before ^ (each > mean)  # from Gray code to binary, bit by bit
        code = code << 1 | before
    within = np.angle(sine) / (2 * np.pi) * PERIOD
    middle = CELL * (code + 0.5)
    place = within + PERIOD * np.round((middle - within) / PERIOD)
    return place, sound & (np.abs(place - middle) < 0.75 * PERIOD / 2)


DEGREE = 7  # of the polynomials; leaves 0.001 px of a lens with 15 % distortion
FITTED = 20_000  # most points of a fit
WINDOW = 5  # lamp pixels along a side of the window of a local linear regression
FEWEST_READINGS = 12  # camera pixels in a window
STEP = 0.05  # of finite differences, in the unit of a map's argument
STRAYS = 5.0  # standard deviations from which on a point is an outlier


@dataclass(frozen=True, eq=False)
class Chart:
    """A smooth map of the plane, as Chebyshev polynomials.

    low, high: `[2]`, corners of the fitted region. degree: in x and y. coefficients: `[2, k]`.
    """

    low: Array
    high: Array
    degree: Sequence[int]
    coefficients: Array

    @classmethod
    def fit(cls, a: tuple[Array, Array], b: tuple[Array, Array]) -> Self:
        """Least-squares map from points a to points b, `[n]`, `[n]` each, without outliers."""
        low, high = np.min(a, 1), np.max(a, 1)
        thin = max(1, len(a[0]) // FITTED)
        most = int(np.sqrt(len(a[0]) / thin / 4))  # four points a coefficient at least
        degree = [max(1, min(DEGREE, most, len(np.unique(np.round(each[::thin], 6))) - 1)) for each in a]
        blank = cls(low, high, degree, np.zeros(0))
        design, values = blank._terms(a[0][::thin], a[1][::thin]), np.stack([each[::thin] for each in b], 1)
        keep = np.ones(len(design), bool)
        for _ in range(3):
            solved = np.linalg.lstsq(design[keep], values[keep], rcond=None)[0]
            off = np.hypot(*(design @ solved - values).T)
            keep = off <= max(STRAYS * 1.48 * float(np.median(off)), 1e-9)
        return replace(blank, coefficients=solved.T)

    def _terms(self, x: Array, y: Array) -> Array:
        unit = [2 * (each - low) / max(high - low, 1e-12) - 1 for each, low, high in zip((x, y), self.low, self.high, strict=True)]
        return chebyshev.chebvander2d(unit[0], unit[1], self.degree)

    def __call__(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Map points of any shape."""
        u, v = (self._terms(x.ravel(), y.ravel()) @ self.coefficients.T).T
        return u.reshape(x.shape), v.reshape(x.shape)

    def jacobian(self, x: Array, y: Array) -> Array:
        """Jacobian `[2, 2, ...]` by finite differences: derivatives of the result (first index) by the argument."""
        along = [np.subtract(self(x + dx, y + dy), self(x - dx, y - dy)) for dx, dy in ((STEP, 0.0), (0.0, STEP))]
        return np.stack(along, 1) / (2 * STEP)


@dataclass(frozen=True, eq=False)
class Places:
    """Centres of each pixel's light in the camera's picture.

    u, v: `[rows, cols]` px, NaN if not located. chart: from lamp coordinates (row, column) to image positions (u, v). lamp_of: its inverse.
    """

    u: Array
    v: Array
    chart: Chart
    lamp_of: Chart


def places(row: Array, col: Array, valid: Mask, rows: int, cols: int) -> Places:
    """Centres of all pixels of a module, by linear regression of decoded camera pixels around each lamp pixel.

    row, col, valid: from `decode`.
    """
    v, u = (each[valid] + 0.5 for each in np.indices(valid.shape, dtype=float))
    r, c = row[valid], col[valid]
    cell = r.astype(int).clip(0, rows - 1) * cols + c.astype(int).clip(0, cols - 1)
    terms = np.stack([np.ones_like(r), r - rows / 2, c - cols / 2])

    def window(values: Array) -> Array:
        total = np.bincount(cell, values, rows * cols).reshape(rows, cols)
        return uniform_filter(total, WINDOW, mode="constant") * WINDOW**2

    normal = np.stack([window(a * b) for a in terms for b in terms], -1).reshape(rows, cols, 3, 3)
    right = np.stack([window(a * b) for a in terms for b in (u, v)], -1).reshape(rows, cols, 3, 2)
    enough = (normal[..., 0, 0] >= FEWEST_READINGS) & (np.linalg.cond(normal) < 1e12)
    solved = np.linalg.solve(np.where(enough[..., None, None], normal, np.eye(3)), right)
    rr, cc = np.indices((rows, cols)) + 0.5
    at = (np.stack([np.ones_like(rr), rr - rows / 2, cc - cols / 2], -1)[..., None] * solved).sum(-2)
    at[~enough] = np.nan
    lamp, camera = (rr[enough], cc[enough]), (at[enough, 0], at[enough, 1])
    return Places(at[..., 0], at[..., 1], Chart.fit(lamp, camera), Chart.fit(camera, lamp))
