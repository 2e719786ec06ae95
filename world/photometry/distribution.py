"""A luminous intensity distribution on the sphere, as photometric files store it (T 2.3; IES LM-63, CIE C-gamma)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from luxloop.world.errors import LuxloopError

Kind = Literal["A", "B", "C"]
Aim = Literal["beam", "nadir"]
Array = NDArray[np.float64]
# Valid ranges of vertical and horizontal angles in deg.
VERTICAL_RANGE = {"A": (-90.0, 90.0), "B": (-180.0, 180.0), "C": (0.0, 180.0)}
HORIZONTAL_RANGE = {"A": (-180.0, 180.0), "B": (-90.0, 90.0), "C": (-360.0, 720.0)}
BRIGHTEST_CD = 1e15  # no lamp comes near it, and sums and products of a few stay finite
EDGE_DEG = 1e-6  # width of an edge, where light stops at once
_BEYOND_DEG = 1e-9  # rounding of atan2 for a direction on the table's edge


@dataclass(frozen=True, eq=False)
class Distribution:
    """Luminous intensity over two angles, as stored; symmetry is unfolded where values are asked for.

    A: vertical polar axis, h to the right, v up. B: horizontal polar axis, v turns the plane about it (up), h runs in the plane, to the
    right. C: v from the downward axis, h about it, counterclockwise seen from above. Raises LuxloopError where angles do not ascend or
    exceed the type's range, and where intensities are negative, not finite or beyond BRIGHTEST_CD.
    """

    type: Kind
    vertical_deg: Array  # [V]
    horizontal_deg: Array  # [H]
    candela: Array  # [H, V] cd, all factors applied

    def __post_init__(self) -> None:
        for name, angles, (low, high), fewest in (
            ("vertical", self.vertical_deg, VERTICAL_RANGE[self.type], 2),
            ("horizontal", self.horizontal_deg, HORIZONTAL_RANGE[self.type], 1),
        ):
            if angles.ndim != 1 or len(angles) < fewest:
                raise LuxloopError(f"give at least {fewest} {name} angle{'s' * (fewest > 1)}")
            if not (np.diff(angles) > 0).all() or not (low <= angles[0] and angles[-1] <= high):
                raise LuxloopError(f"{name} angles of type {self.type} must ascend within {low:g} to {high:g} deg")
        if self.candela.shape != (len(self.horizontal_deg), len(self.vertical_deg)):
            raise LuxloopError(
                f"{len(self.horizontal_deg)} horizontal and {len(self.vertical_deg)} vertical angles need as many rows and "
                f"columns of candela, not {self.candela.shape}"
            )
        if not ((self.candela >= 0) & (self.candela <= BRIGHTEST_CD)).all():
            raise LuxloopError(f"luminous intensities must be finite and not negative, {BRIGHTEST_CD:g} cd at most")

    @cached_property
    def full_table(self) -> tuple[Array, Array, Array]:
        """Vertical `[V']` and horizontal angles `[H']` in deg, and candela `[H', V']`, of the whole table without symmetry."""
        v, h, candela = self.vertical_deg, self.horizontal_deg, self.candela
        if len(h) == 1:
            low, high = (0.0, 360.0) if self.type == "C" else HORIZONTAL_RANGE[self.type]
            h, candela = np.array([low, high]), np.repeat(candela, 2, axis=0)
        elif self.type == "C":
            h, candela = _around(h, candela)
        elif h[0] == 0:
            h, candela = np.concatenate([-h[:0:-1], h]), np.concatenate([candela[:0:-1], candela])
        if self.type != "C" and v[0] == 0:
            v, candela = np.concatenate([-v[:0:-1], v]), np.concatenate([candela[:, :0:-1], candela], axis=1)
        return v, h, candela

    @property
    def complete(self) -> bool:
        """Whether a type C distribution covers every azimuth; types A and B count as complete."""
        _, h, _ = self.full_table
        return self.type != "C" or h[-1] - h[0] >= 360 - _BEYOND_DEG

    def at(self, vertical_deg: ArrayLike, horizontal_deg: ArrayLike) -> Array:
        """Luminous intensity in cd at angles `[...]` in deg: bilinear in the table, symmetry unfolded, zero beyond it."""
        v, h, candela = self.full_table
        v_at, h_at = np.asarray(vertical_deg, np.float64), np.asarray(horizontal_deg, np.float64)
        if self.type == "C":
            h_at = h[0] + np.mod(h_at - h[0], 360.0)
        i, s, inside_h = _between(h, h_at)
        j, t, inside_v = _between(v, v_at)
        low = (1 - t) * candela[i, j] + t * candela[i, j + 1]  # linear over v at the horizontal angles h_i and h_i+1, [...]
        high = (1 - t) * candela[i + 1, j] + t * candela[i + 1, j + 1]
        return np.where(inside_h & inside_v, (1 - s) * low + s * high, 0.0)  # linear over h, zero beyond the table

    def intensity(self, directions: ArrayLike, aim: Aim = "beam") -> Array:
        """Luminous intensity `[...]` in cd into directions `[3, ...]` of the headlight frame (x forward, y left, z up; of any length).

        aim: "beam" turns the distribution's axis (v = h = 0 of A and B, nadir of C) into the beam axis, with C0 to the right and C90
        up; "nadir" leaves B and C as luminaires hang, their axis down, C0 to the right and C90 ahead.
        """
        return self.at(*angles_of(self.type, directions, aim))

    @cached_property
    def luminous_flux(self) -> float:
        """Flux in lm: the exact integral of what `at` returns over the sphere."""
        v, h, candela = (np.deg2rad(each) if each.ndim == 1 else each for each in self.full_table)
        if self.type == "B":
            return float(_cosine_weights(h) @ candela @ _trapezoid_weights(v))
        elevation = v - np.pi / 2 if self.type == "C" else v
        return float(_trapezoid_weights(h) @ candela @ _cosine_weights(elevation))


def angles_of(kind: Kind, directions: ArrayLike, aim: Aim = "beam") -> tuple[Array, Array]:
    """Vertical and horizontal angles `[...]` in deg of directions `[3, ...]` of the headlight frame (T eq. 2.3.5; see Distribution)."""
    x, y, z = np.asarray(directions, np.float64)
    if aim == "nadir" and kind != "A":
        x, z = -z, x
    if kind == "A":
        v, h = np.arctan2(z, np.hypot(x, y)), np.arctan2(-y, x)  # T eq. 2.3.5: elevation, and azimuth clockwise from above
    elif kind == "B":
        v, h = np.arctan2(z, x), np.arctan2(-y, np.hypot(x, z))
    else:
        v, h = np.arctan2(np.hypot(y, z), x), np.arctan2(z, -y)
    return np.rad2deg(v), np.rad2deg(h)


def directions_of(kind: Kind, vertical_deg: ArrayLike, horizontal_deg: ArrayLike, aim: Aim = "beam") -> Array:
    """Unit directions `[3, ...]` of the headlight frame for photometric angles: the inverse of `angles_of` (T eq. 2.3.4)."""
    v, h = np.radians(vertical_deg), np.radians(horizontal_deg)
    if kind == "A":
        return np.stack([np.cos(v) * np.cos(h), -np.cos(v) * np.sin(h), np.sin(v)])  # T eq. 2.3.4, [3, ...]
    if kind == "B":
        x, y, z = np.cos(h) * np.cos(v), -np.sin(h), np.cos(h) * np.sin(v)
    else:
        x, y, z = np.cos(v), -np.sin(v) * np.cos(h), np.sin(v) * np.sin(h)
    return np.stack([x, y, z] if aim == "beam" else [z, y, -x])


def sample(intensity: Callable[[Tensor], Tensor], horizontal_deg: ArrayLike, vertical_deg: ArrayLike, kind: Kind = "A") -> Distribution:
    """A distribution of any lamp, sampled at the nodes of a grid.

    intensity: cd `[N]` of directions `[3, N]` float64 of the lamp frame, as `Lamp.intensity` gives it for fixed utilisations.
    horizontal_deg `[H]` and vertical_deg `[V]`, ascending: of type A to the right and up; of type C about the beam axis and from it.
    """
    h, v = np.array(horizontal_deg, np.float64), np.array(vertical_deg, np.float64)
    h_at, v_at = (angles.ravel() for angles in np.meshgrid(h, v, indexing="ij"))
    candela = intensity(torch.from_numpy(directions_of(kind, v_at, h_at))).double().cpu().numpy().reshape(len(h), len(v))
    return Distribution(kind, v, h, candela)


def _around(h: Array, candela: Array) -> tuple[Array, Array]:
    """Unfold the planes of type C to 360 deg by their symmetry."""
    span = h[-1] - h[0]
    while span in (90.0, 180.0):
        h, candela = np.concatenate([h, 2 * h[-1] - h[-2::-1]]), np.concatenate([candela, candela[-2::-1]])
        span = h[-1] - h[0]
    closing = 360.0 - span
    if 0 < closing <= np.diff(h).max() * (1 + 1e-6):  # close the circle from the last plane to the first
        h, candela = np.append(h, h[0] + 360.0), np.concatenate([candela, candela[:1]])
    return h, candela


def _between(nodes: Array, x: Array) -> tuple[NDArray[np.intp], Array, NDArray[np.bool_]]:
    """Index of the node before x, the fraction of the step to the next, and whether x lies within the nodes."""
    inside = (x >= nodes[0] - _BEYOND_DEG) & (x <= nodes[-1] + _BEYOND_DEG)
    i = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    return i, np.clip((x - nodes[i]) / (nodes[i + 1] - nodes[i]), 0.0, 1.0), inside


def _trapezoid_weights(x: Array) -> Array:
    half = np.diff(x) / 2
    return np.append(half, 0.0) + np.append(0.0, half)


def _cosine_weights(x: Array) -> Array:
    """Integrals of cos x times the piecewise linear function that is 1 at one node and 0 at the others."""
    slope = -np.diff(np.cos(x)) / np.diff(x)
    return np.append(slope - np.sin(x[:-1]), 0.0) + np.append(0.0, np.sin(x[1:]) - slope)
