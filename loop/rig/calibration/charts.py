"""Smooth maps between two planes as Chebyshev polynomials, and positions of lamp pixels in the camera by local regression."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.polynomial import chebyshev
from scipy.ndimage import uniform_filter

from luxloop.loop.rig.calibration.bench import Array
from luxloop.loop.rig.calibration.codes import Decoded

DEGREE: Final = 7  # of the polynomials in either direction: a lens of 15 % distortion leaves 0.001 px
FITTED: Final = 20_000  # points at most that a map is fitted to
WINDOW: Final = 5  # pixels of the lamp, over which a place is a linear function of lamp coordinates
FEWEST: Final = 12  # camera pixels in it
STRAYS: Final = 5.0  # standard deviations, beyond which a point is left out of a fit


@dataclass(frozen=True, eq=False)
class Chart:
    """A smooth map from points `[n]`, `[n]` to points `[n]`, `[n]`. low, high: `[2]`, corners of where it was fitted. coefficients:
    `[2, k]`.
    """

    low: Array
    high: Array
    degree: tuple[int, int]
    coefficients: Array

    @classmethod
    def fitted(cls, a: tuple[Array, Array], b: tuple[Array, Array]) -> Self:
        """The least-squares map from points a to points b, without outliers."""
        low, high = (np.array([each.min() for each in a]), np.array([each.max() for each in a]))
        thin = max(1, len(a[0]) // FITTED)
        most = int(np.sqrt(len(a[0]) / thin / 4))  # four points a coefficient at least
        degree = tuple(max(1, min(DEGREE, most, len(np.unique(np.round(each[::thin], 6))) - 1)) for each in a)
        blank = cls(low, high, (degree[0], degree[1]), np.zeros((2, (degree[0] + 1) * (degree[1] + 1))))
        design, values = blank._terms(a[0][::thin], a[1][::thin]), np.stack([each[::thin] for each in b], 1)
        keep = np.ones(len(design), bool)
        for _ in range(3):
            solved = np.linalg.lstsq(design[keep], values[keep], rcond=None)[0]
            off = np.hypot(*(design @ solved - values).T)
            keep = off <= max(STRAYS * 1.48 * float(np.median(off)), 1e-9)
        return cls(low, high, blank.degree, solved.T)

    def _terms(self, x: Array, y: Array) -> Array:
        unit = [2 * (each - low) / max(high - low, 1e-12) - 1 for each, low, high in zip((x, y), self.low, self.high, strict=True)]
        return chebyshev.chebvander2d(unit[0], unit[1], self.degree)

    def __call__(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Points of any shape."""
        mapped = self._terms(x.ravel(), y.ravel()) @ self.coefficients.T
        return mapped[:, 0].reshape(x.shape), mapped[:, 1].reshape(x.shape)

    def jacobian(self, x: Array, y: Array, step: float = 0.05) -> Array:
        """Derivatives `[2, 2, ...]` of the map's result (first index) by its argument, by finite differences of this step."""
        along = [np.stack(self(x + dx, y + dy)) - np.stack(self(x - dx, y - dy)) for dx, dy in ((step, 0.0), (0.0, step))]
        return np.stack(along, 1) / (2 * step)


@dataclass(frozen=True, eq=False)
class Places:
    """Centres of the light of each pixel of a module in the camera's picture.

    u, v: `[rows, cols]` px, NaN where it was not found. chart: from lamp coordinates (row, column) to the camera's (u, v). lamp_of: the
    other way round.
    """

    u: Array
    v: Array
    chart: Chart
    lamp_of: Chart


def places(decoded: Decoded, rows: int, cols: int) -> Places:
    """Centres of all pixels of a module, by inverting the readings of camera pixels with a linear regression around each lamp pixel."""
    v, u = (each[decoded.valid] + 0.5 for each in np.indices(decoded.valid.shape, dtype=float))
    r, c = decoded.row[decoded.valid], decoded.col[decoded.valid]
    cell = r.astype(int).clip(0, rows - 1) * cols + c.astype(int).clip(0, cols - 1)
    centre = np.array([(rows / 2), (cols / 2)])
    terms = np.stack([np.ones_like(r), r - centre[0], c - centre[1]])

    def window(values: Array) -> Array:
        total = np.bincount(cell, values, rows * cols).reshape(rows, cols)
        return uniform_filter(total, WINDOW, mode="constant") * WINDOW**2

    normal = np.stack([window(a * b) for a in terms for b in terms], -1).reshape(rows, cols, 3, 3)
    right = np.stack([window(a * b) for a in terms for b in (u, v)], -1).reshape(rows, cols, 3, 2)
    enough = (normal[..., 0, 0] >= FEWEST) & (np.linalg.cond(normal) < 1e12)
    solved = np.linalg.solve(np.where(enough[..., None, None], normal, np.eye(3)), right)
    rr, cc = np.meshgrid(np.arange(rows) + 0.5 - centre[0], np.arange(cols) + 0.5 - centre[1], indexing="ij")
    at = (np.stack([np.ones_like(rr), rr, cc], -1)[..., None] * solved).sum(-2)
    at[~enough] = np.nan
    lamp = tuple(each[enough] for each in (rr + centre[0], cc + centre[1]))
    camera = at[enough, 0], at[enough, 1]
    return Places(at[..., 0], at[..., 1], Chart.fitted((lamp[0], lamp[1]), camera), Chart.fitted(camera, (lamp[0], lamp[1])))
