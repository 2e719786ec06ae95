"""How well the joint optimisation of all pixels can draw rectangles with a lamp: the figure that two presets are calibrated by (T 8.4).

`python benchmarks/calibration.py hd84` draws a part of the 1,215 rectangles and prints the mean error; `--every 1` draws them all.
"""

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from world.headlight import Headlight
from world.presets import lamp

SETPOINT_CD = 10_000.0
PUBLISHED = {"hd84": 0.81, "ssl-hd-lores": 0.19}  # mean error, T 8.4
REACH_DEG = {"hd84": 6.0, "ssl-hd-lores": 0.7}  # pixels further than this from a rectangle stay dark


@dataclass(frozen=True)
class Rectangle:
    """A rectangle in deg about (h, v), left and up positive, turned counter-clockwise as seen from the lamp."""

    h: float
    v: float
    width: float
    height: float
    turn: float

    def distance(self, h: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far points lie outside of it, as the larger of the distances along its sides; negative inside."""
        angle = np.radians(self.turn)
        x, y = h - self.h, v - self.v
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        return np.maximum(np.abs(along) - self.width / 2, np.abs(across) - self.height / 2)


# The thesis gives the ranges of width, height and horizontal position; vertical positions and turns are our choice, within the field.
RECTANGLES = [
    Rectangle(*values)
    for values in itertools.product(np.linspace(-10, 10, 9), np.linspace(-2, 2, 5), (1.5, 3.75, 6.0), (1.0, 2.0, 3.0), (0.0, 15.0, 30.0))
]


def least_error(light: Headlight, rectangle: Rectangle, reach_deg: float, gap: float = 0.005, most: int = 20_000) -> tuple[float, float]:
    """The least mean absolute error (T 8.3) of a rectangle, and how much lower it might be.

    min |A u - s|_1 over 0 <= u <= 1 by primal-dual steps, with step widths from the sums of rows and columns; the dual value proves it.
    """
    matrix = light.matrix.to_scipy().astype(np.float64) / SETPOINT_CD
    y = light.left + (np.arange(light.cols) + 0.5) / light.cols * (light.right - light.left)
    z = light.top + (np.arange(light.rows) + 0.5) / light.rows * (light.bottom - light.top)
    v, h = (axis.ravel() for axis in np.meshgrid(np.degrees(np.arctan(z)), np.degrees(np.arctan(y)), indexing="ij"))
    distance = rectangle.distance(h, v)
    A = _near(matrix, distance <= reach_deg)
    texels = np.diff(A.indptr) > 0
    inside = distance <= 0
    A, s = A[texels | inside], inside[texels | inside].astype(np.float64)
    At = A.T.tocsr()
    down, up = (1 / np.maximum(np.asarray(m.sum(axis=1)).ravel(), 1e-12) for m in (At, A))
    u, dual = np.zeros(A.shape[1]), np.zeros(A.shape[0])
    best, bound = s.sum(), 0.0  # all pixels off
    for step in range(1, most + 1):
        before = u
        u = np.clip(u - down * (At @ dual), 0, 1)
        dual = np.clip(dual + up * (A @ (2 * u - before) - s), -1, 1)
        if step % 100 == 0:
            best = min(best, np.abs(A @ u - s).sum())
            bound = max(bound, -s @ dual + np.minimum(At @ dual, 0).sum())
            if best - bound <= gap * best:
                break
    return best / s.sum(), (best - bound) / s.sum()


def _near(matrix: sp.csr_matrix, texels: NDArray[np.bool_]) -> sp.csr_matrix:
    """The columns of pixels whose brightest texel is among the given ones."""
    columns = matrix.tocsc()
    brightest = np.asarray(columns.argmax(axis=0)).ravel()
    return columns[:, texels[brightest]].tocsr()


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("lamp", choices=sorted(PUBLISHED))
    parser.add_argument("--every", type=int, default=29, help="take every n-th rectangle (default 29)")
    chosen = parser.parse_args(arguments)
    light = lamp(chosen.lamp).modules[0].headlight
    errors = []
    for rectangle in RECTANGLES[chosen.every // 2 :: chosen.every]:
        error, gap = least_error(light, rectangle, REACH_DEG[chosen.lamp])
        errors.append(error)
        print(f"{rectangle}: {error:.3f} (-{gap:.3f})")
    print(f"{chosen.lamp}: mean {np.mean(errors):.3f}, median {np.median(errors):.3f}; thesis {PUBLISHED[chosen.lamp]}")


if __name__ == "__main__":
    main()
