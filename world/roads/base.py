"""Base of all roads: height over the plane that the vehicle stands on."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxloop.world.params import Params

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MeshGrid:
    """Where a road's mesh is fine, in m; beyond, its spacing grows to the edge of the scene. Lines are always in the grid."""

    x_m: tuple[float, float] = (9.0, 27.0)
    y_m: tuple[float, float] = (-4.0, 4.0)
    spacing_m: tuple[float, float] = (0.03, 0.04)
    x_lines_m: tuple[float, ...] = ()
    y_lines_m: tuple[float, ...] = ()


class Road(Protocol):
    """A road surface in the vehicle frame: origin on the plane z = 0 that the vehicle stands on, below the middle of its lamps."""

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Height in m at x (ahead) and y (left) in m; broadcasts, float64, finite everywhere."""
        ...

    def grid(self) -> MeshGrid:
        """How finely the road's mesh resolves it, and where."""
        ...


class RoadModel(Params):
    """Base of the roads that a scenario file may name."""

    def grid(self) -> MeshGrid:
        return MeshGrid()


def together(x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Both as float64 of their common shape."""
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    return x, y


def smoothstep(value: ArrayLike, start: float, end: float) -> Floats:
    """0 below start, 1 above end, with a continuous slope between."""
    t = np.clip((np.asarray(value, np.float64) - start) / (end - start), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def ahead(x: ArrayLike) -> Floats:
    """Weight of unevenness: 0 under the vehicle, which defines z = 0; 1 from 6 m ahead, nearer than the lamps light the road."""
    return smoothstep(x, 2.0, 6.0)
