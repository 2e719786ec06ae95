"""Evaluate a curved regular grid: z(u, v), (u, v) -> (x, y) and back."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxloop.world.errors import LuxloopError
from luxloop.world.opencrg.crg import FINEST_M, Crg, fill_gaps

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
NO_VALUE, ZERO, KEEP, REPEAT, MIRROR = range(5)
FARTHEST_M, STEEPEST = 1e8, 100.0  # no place and no slope of a road is farther out or steeper
ROUNDING = 1e-9  # of a step, by which a point at an end may seem to lie beyond it


class CrgSurface:
    """The surface of a `Crg`, in the frame that it stores. All methods broadcast and return float64 arrays.

    u runs along the reference line and v to its left, in m; phi is a heading in rad. Border modes, offsets and smoothing
    come from the file's options. A track that closes on itself wraps in u.
    """

    def __init__(self, crg: Crg) -> None:
        """Raises LuxloopError where the grid is not that of a road."""
        self.crg = crg
        self.u_start, self.u_step, self.u_end = crg.u_start, crg.u_step, crg.u_end
        n = len(crg.z)
        heading = np.full(n, crg.line("start_phi")) if crg.phi is None else crg.phi
        self._phi_ends = (crg.line("start_phi"), crg.line("end_phi", float(heading[-1])))
        steps = self.u_step * np.stack([np.cos(heading[1:]), np.sin(heading[1:])], axis=1)
        start = np.array([crg.line("start_x"), crg.line("start_y")])
        ends = [crg.road.get(f"reference_line_end_{axis}") for axis in "xy"]
        mixing = np.arange(1, n) / (n - 1)
        end = np.array(ends) if crg.phi is not None and None not in ends else None
        self.points: Floats = _integrate(start, steps, end, mixing)  # [n, 2]
        self.heights = self._line_heights(mixing)  # [n]
        self.banking = np.full(n, crg.line("start_b")) if crg.banking is None else crg.banking
        self._check()
        # A track that closes keeps the gap between its end and its start as a straight piece.
        self._gap = self._closing_gap()

    def _check(self) -> None:
        """Raises LuxloopError where the numbers of a file, before or after its modifiers, do not describe a usable road."""
        across, along = np.diff(self.crg.v), np.diff(self.points, axis=0)
        sound = {
            "steps between points of the grid": FINEST_M <= self.u_step <= FARTHEST_M and across.min() >= FINEST_M,
            "places": (np.abs(self.points) <= FARTHEST_M).all() and np.abs(self.crg.v).max() <= FARTHEST_M,
            "heights": (np.abs(self.heights) <= FARTHEST_M).all() and not (np.abs(self.crg.z) > FARTHEST_M).any(),
            "bankings": (np.abs(self.banking) <= STEEPEST).all(),
            "turns of the reference line": (_dot(along[1:], along[:-1]) > 0).all(),
        }
        if wrong := [name for name, is_sound in sound.items() if not is_sound]:
            raise LuxloopError(f"{self.crg.source}: its {wrong[0]} are not those of a road; correct $ROAD_CRG and $ROAD_CRG_MODS")

    def _line_heights(self, mixing: Floats) -> Floats:
        crg, n = self.crg, len(self.crg.z)
        start, slope = crg.line("start_z"), crg.line("start_s")
        if crg.slope is None and slope == 0.0:
            return np.full(n, start)
        steps = self.u_step * (np.full(n, slope) if crg.slope is None else crg.slope)[1:, None]
        end = crg.road.get("reference_line_end_z")
        heights = _integrate(np.array([start]), steps, None if end is None else np.array([end]), mixing - 1 / (n - 1))[:, 0]
        if end is not None:
            heights[-1] = end
        return cast(Floats, heights)

    def _closing_gap(self) -> float | None:
        across = self.points[0] - self.points[-1]
        directions = [np.array([np.cos(phi), np.sin(phi)]) for phi in self._phi_ends]
        asked = self.crg.options.get("refline_continuation", 0.0) == 1.0
        closes = directions[0] @ directions[1] > 0.5 and all(across @ direction >= 0 for direction in directions)
        return float(across @ directions[1]) if asked and closes else None

    def _wrap(self, u: Floats) -> Floats:
        if self._gap is None:
            return u
        first = self.u_start - self._gap / 2
        return first + np.mod(u - first, self.u_end - self.u_start + self._gap)

    def z(self, u: ArrayLike, v: ArrayLike) -> Floats:
        """Elevation in m; NaN in a cell with a NaN corner, and beyond the border in border mode 0."""
        options = self.crg.options
        u, v = np.broadcast_arrays(self._wrap(np.asarray(u, np.float64)), np.asarray(v, np.float64))
        u, u_mode, u_out = _border(u, self.u_start, self.u_end, options.get("border_mode_u", KEEP))
        v, v_mode, v_out = _border(v, self.crg.v[0], self.crg.v[-1], options.get("border_mode_v", KEEP))
        i, a = self._cell(u)
        grid_v = self.crg.v
        j = np.clip(np.searchsorted(grid_v, v, side="right") - 1, 0, len(grid_v) - 2)
        b = np.clip((v - grid_v[j]) / (grid_v[j + 1] - grid_v[j]), 0.0, 1.0)
        grid = self.crg.z
        right = grid[i, j] + a * (grid[i + 1, j] - grid[i, j])
        left = grid[i, j + 1] + a * (grid[i + 1, j + 1] - grid[i, j + 1])
        z = right + b * (left - right) + _lerp(self.heights, i, a) + v * _lerp(self.banking, i, a)
        for out, mode, key in ((v_out, v_mode, "border_offset_v"), (u_out, u_mode, "border_offset_u")):
            if mode in (ZERO, NO_VALUE):
                z = np.where(out, 0.0 if mode == ZERO else np.nan, z)
            if mode in (ZERO, KEEP):
                z = np.where(out, z + options.get(key, 0.0), z)
        return self._smooth(u, z)

    def _smooth(self, u: Floats, z: Floats) -> Floats:
        ends = (("border_smooth_ubeg", u - self.u_start, self.heights[0]), ("border_smooth_uend", self.u_end - u, self.heights[-1]))
        for key, inside, height in ends:
            if self.crg.options.get(key, 0.0) > 0:
                z = height + np.clip(inside / self.crg.options[key], 0.0, 1.0) * (z - height)
        return z

    def _cell(self, u: Floats) -> tuple[NDArray[np.intp], Floats]:
        position = (u - self.u_start) / self.u_step
        i = np.clip(np.floor(position).astype(np.intp), 0, len(self.crg.z) - 2)
        return i, np.clip(position - i, 0.0, 1.0)

    def xy(self, u: ArrayLike, v: ArrayLike) -> tuple[Floats, Floats]:
        """Position of a grid coordinate in m; straight on beyond the ends."""
        u, v = np.broadcast_arrays(self._wrap(np.asarray(u, np.float64)), np.asarray(v, np.float64))
        i, a = self._cell(u)
        p0, p1, p2, p3 = self._neighbours(i)
        normal = _left(p2 - p1)
        n1, n2 = _left(p2 - p0), _left(p3 - p1)
        corner_1 = p1 + v[..., None] * n1 / _dot(n1, normal)[..., None]
        corner_2 = p2 + v[..., None] * n2 / _dot(n2, normal)[..., None]
        at = corner_1 + a[..., None] * (corner_2 - corner_1)
        for beyond, end, phi, u_at in (
            (u < self.u_start, self.points[0], self._phi_ends[0], self.u_start),
            (u > self.u_end, self.points[-1], self._phi_ends[1], self.u_end),
        ):
            along, left = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
            at = np.where(beyond[..., None], end + (u - u_at)[..., None] * along + v[..., None] * left, at)
        return at[..., 0], at[..., 1]

    def phi(self, u: ArrayLike) -> Floats:
        """Heading of the reference line at u in rad, `START_PHI` and `END_PHI` at its ends."""
        u = self._wrap(np.asarray(u, np.float64))
        i, _ = self._cell(u)
        direction = self.points[i + 1] - self.points[i]
        inside = np.where(u >= self.u_end, self._phi_ends[1], np.arctan2(direction[..., 1], direction[..., 0]))
        return np.where(u <= self.u_start, self._phi_ends[0], inside)

    @cached_property
    def _coarse(self) -> tuple[NDArray[np.intp], "cKDTree"]:
        rows = np.unique(np.append(np.arange(0, len(self.points), 10), len(self.points) - 1))
        from scipy.spatial import cKDTree

        return rows, cKDTree(self.points[rows])

    def uv(self, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
        """Grid coordinate of a position in m: exact inverse of `xy` where the grid does not fold."""
        p = np.stack(np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64)), axis=-1)
        rows, tree = self._coarse
        k = np.maximum(rows[tree.query(p)[1]], 1)
        k = self._walk(p, k, up=True)
        k = self._walk(p, k, up=False)
        p0, p1, p2, p3 = self._neighbours(k - 1)
        along = p2 - p1
        v = _cross(along, p - p1) / np.linalg.norm(along, axis=-1)
        ta = _dot(p2 - p0, p - p1) / _dot(p2 - p0, along)
        tb = _dot(p3 - p1, p2 - p) / _dot(p3 - p1, along)
        u = self.u_start + (k - 1 + ta / (ta + tb)) * self.u_step
        return self._beyond_ends(p, u, v)

    def _walk(self, p: Floats, k: NDArray[np.intp], up: bool) -> NDArray[np.intp]:
        points, last = self.points, len(self.points) - 1
        while True:
            if up:
                ahead = _dot(p - points[k], points[np.minimum(k + 1, last)] - points[k - 1]) > 0
                step = ahead & (k < last)
            else:
                behind = _dot(p - points[k - 1], points[k] - points[np.maximum(k - 2, 0)]) < 0
                step = behind & (k > 1)
            if not step.any():
                return k
            k = np.where(step, k + (1 if up else -1), k)

    def _beyond_ends(self, p: Floats, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        first, last = self.u_start, self.u_end
        inside = u.clip(first, last)
        u = np.where(np.abs(u - inside) < ROUNDING * self.u_step, inside, u)
        # On a closed track what lies past one end belongs to the other.
        ends = [(u < first, 0, first), (u > last, 1, last)]
        if self._gap is not None:
            half = self._gap / 2
            ends = [((u < first) & (u >= first - half), 0, first), (u < first - half, 1, last)]
            ends += [((u > last) & (u <= last + half), 1, last), (u > last + half, 0, first)]
        for beyond, end, u_at in ends:
            phi, offset = self._phi_ends[end], p - self.points[-end]
            u = np.where(beyond, u_at + offset[..., 0] * np.cos(phi) + offset[..., 1] * np.sin(phi), u)
            v = np.where(beyond, offset[..., 1] * np.cos(phi) - offset[..., 0] * np.sin(phi), v)
        return self._wrap(u), v

    def _neighbours(self, i: NDArray[np.intp]) -> tuple[Floats, Floats, Floats, Floats]:
        points, last = self.points, len(self.points) - 1
        return points[np.maximum(i - 1, 0)], points[i], points[i + 1], points[np.minimum(i + 2, last)]


def _integrate(start: Floats, steps: Floats, end: Floats | None, mixing: Floats) -> Floats:
    """Points from a start and steps `[n - 1, d]`. With an end, the line integrated backwards from it is mixed in with growing weight."""
    forward = np.concatenate([start[None], start + np.cumsum(steps, axis=0)])
    if end is None:
        return forward
    backward = end + (forward - forward[-1])
    # p[i + 1] = (1 - f) (p[i] + step) + f b[i + 1] and b[i + 1] = b[i] + step, so p - b shrinks by (1 - f) a row.
    shrink = np.concatenate([[1.0], np.cumprod(1 - mixing)])
    return cast(Floats, backward + shrink[:, None] * (start - backward[0]))


def _border(value: Floats, low: float, high: float, mode: float) -> tuple[Floats, int, NDArray[np.bool_]]:
    outside = (value < low) | (value > high)
    if mode == REPEAT:
        value = np.where(outside, low + np.mod(value - low, high - low), value)
    elif mode == MIRROR:
        value = np.where(outside, high - np.abs(np.mod(value - low, 2 * (high - low)) - (high - low)), value)
    return np.clip(value, low, high), int(mode), outside


def _lerp(values: Floats, i: NDArray[np.intp], a: Floats) -> Floats:
    return cast(Floats, values[i] + a * (values[i + 1] - values[i]))


def _left(vector: Floats) -> Floats:
    normal = np.stack([-vector[..., 1], vector[..., 0]], axis=-1)
    return cast(Floats, normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def _dot(a: Floats, b: Floats) -> Floats:
    return cast(Floats, (a * b).sum(axis=-1))


def _cross(a: Floats, b: Floats) -> Floats:
    return cast(Floats, a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


Point = tuple[float, float]
NAN_KEEP, NAN_ZERO, NAN_LAST = range(3)


def modify(crg: Crg) -> Crg:
    """The grid after its modifiers. Order: scale, NaN, position."""
    if not (mods := crg.modifiers):
        return crg
    crg = replace(_handle_nan(_scale_grid(crg, mods), mods), modifiers={})
    if any(key.startswith("refpoint_") for key in mods):
        return _move(crg, *_to_reference_point(crg, mods))
    if any(key.startswith("refline_offset_") for key in mods):
        return _move(
            crg,
            turn=mods.get("refline_offset_phi", 0.0),
            about=(mods.get("refline_rotcenter_x", crg.line("start_x")), mods.get("refline_rotcenter_y", crg.line("start_y"))),
            shift=(mods.get("refline_offset_x", 0.0), mods.get("refline_offset_y", 0.0), mods.get("refline_offset_z", 0.0)),
        )
    return crg


def _scale_grid(crg: Crg, mods: Mapping[str, float]) -> Crg:
    line = dict(crg.road)
    z = crg.z * mods.get("scale_z_grid", 1.0)
    slope_scale, banking_scale = mods.get("scale_slope", 1.0), mods.get("scale_banking", 1.0)
    _scale(line, slope_scale, "reference_line_start_s", "reference_line_end_s")
    _scale(line, banking_scale, "reference_line_start_b", "reference_line_end_b")
    if "reference_line_end_z" in line:
        start_z = crg.line("start_z")
        line["reference_line_end_z"] = start_z + slope_scale * (line["reference_line_end_z"] - start_z)
    length, width, curvature = (mods.get(f"scale_{name}", 1.0) for name in ("length", "width", "curvature"))
    if length <= 0 or width <= 0:
        raise LuxloopError(f"{crg.source}: SCALE_LENGTH = {length:g} and SCALE_WIDTH = {width:g} must be positive; correct $ROAD_CRG_MODS")
    if length != 1.0:
        line["reference_line_increment"] *= length
        if "reference_line_end_u" in line:
            line["reference_line_end_u"] = crg.u_start + length * (line["reference_line_end_u"] - crg.u_start)
        line.pop("reference_line_end_z", None)
    _scale(line, width, "long_section_v_right", "long_section_v_left", "long_section_v_increment")
    if length != 1.0 or curvature != 1.0:  # the stored end no longer lies on the line
        line.pop("reference_line_end_x", None)
        line.pop("reference_line_end_y", None)
    phi = crg.phi
    if phi is not None and curvature != 1.0:
        start = crg.line("start_phi")
        phi = start + curvature * (np.unwrap(np.concatenate([[start], phi[1:]])) - start)
        line["reference_line_end_phi"] = float(phi[-1])
    return replace(
        crg,
        z=z,
        v=crg.v * width,
        road=line,
        phi=phi,
        slope=None if crg.slope is None else crg.slope * slope_scale,
        banking=None if crg.banking is None else crg.banking * banking_scale,
    )


def _scale(line: dict[str, float], factor: float, *keys: str) -> None:
    for key in keys:
        if key in line:
            line[key] *= factor


def _handle_nan(crg: Crg, mods: Mapping[str, float]) -> Crg:
    if "grid_nan_mode" not in mods and "grid_nan_offset" not in mods:
        return crg
    mode, offset = mods.get("grid_nan_mode", NAN_LAST), mods.get("grid_nan_offset", 0.0)
    if mode not in (NAN_KEEP, NAN_ZERO, NAN_LAST):
        raise LuxloopError(f"{crg.source}: GRID_NAN_MODE = {mode:g} is unknown; use 0 (keep), 1 (zero) or 2 (last valid value)")
    if mode == NAN_ZERO:
        return replace(crg, z=np.where(np.isfinite(crg.z), crg.z, offset))
    return fill_gaps(crg, offset) if mode == NAN_LAST else crg


def _to_reference_point(crg: Crg, mods: Mapping[str, float]) -> tuple[float, Point, tuple[float, float, float]]:
    surface = CrgSurface(crg)

    def coordinate(axis: str, low: float, high: float, default: float) -> float:
        absolute, fraction = mods.get(f"refpoint_{axis}"), mods.get(f"refpoint_{axis}_fraction")
        if absolute is None:
            absolute = default if fraction is None else low + fraction * (high - low)
        return absolute + mods.get(f"refpoint_{axis}_offset", 0.0)

    u = coordinate("u", crg.u_start, crg.u_end, crg.u_start)
    v = coordinate("v", float(crg.v[0]), float(crg.v[-1]), 0.0)
    x, y = (float(value) for value in surface.xy(u, v))
    z = float(surface.z(u, v))
    if math.isnan(z):
        raise LuxloopError(
            f"{crg.source}: has no elevation at reference point u = {u:g}, v = {v:g}: add GRID_NAN_MODE = 2 to $ROAD_CRG_MODS"
        )
    target = [mods.get(f"refpoint_{name}", 0.0) for name in ("x", "y", "z", "phi")]
    return target[3] - float(surface.phi(u)), (x, y), (target[0] - x, target[1] - y, target[2] - z)


def _move(crg: Crg, turn: float, about: Point, shift: tuple[float, float, float]) -> Crg:
    """Turn by `turn` rad about a point, then shift by `[3]` m."""
    line = dict(crg.road)
    cos, sin = math.cos(turn), math.sin(turn)
    for end in ("start", "end"):
        keys = [f"reference_line_{end}_{axis}" for axis in "xy"]
        if end == "start" or all(key in line for key in keys):
            dx, dy = (line.get(key, 0.0) - centre for key, centre in zip(keys, about, strict=True))
            line[keys[0]] = about[0] + cos * dx - sin * dy + shift[0]
            line[keys[1]] = about[1] + sin * dx + cos * dy + shift[1]
        if end == "start" or f"reference_line_{end}_z" in line:
            line[f"reference_line_{end}_z"] = line.get(f"reference_line_{end}_z", 0.0) + shift[2]
        if end == "start" or f"reference_line_{end}_phi" in line:
            line[f"reference_line_{end}_phi"] = line.get(f"reference_line_{end}_phi", 0.0) + turn
    return replace(crg, road=line, phi=None if crg.phi is None else crg.phi + turn)
