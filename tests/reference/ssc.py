"""SuperSampling Control ray by ray and pixel by pixel in float64, as T 7.3 and 7.4 write it; it shares no code with what it checks."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import QUANTITIES, Primitives
from luxloop.world.headlight import Headlight

Array = NDArray[np.float64]
Place = tuple[int, int]


@dataclass(frozen=True)
class Ray:
    """What one ray asks for; a ray without a hit has neither setpoint nor quantity, and weight 1."""

    hit: bool = False
    value: float = 0.0
    weight: float = 1.0
    quantity: str = ""


@dataclass(frozen=True)
class Asked:
    """What hits are asked (T 7.5.1). lights: name, grid, all pixels on `[rows, cols]` cd and `T_world_headlight` of each; own: whose rays
    they are. street_lamps: position and cd. blocked: whether something lies between a point and a target.
    """

    lights: list[tuple[str, Headlight, Array, Array]]
    own: int
    street_lamps: list[tuple[Array, float]]
    blocked: Callable[[Array, Array], bool]


def symbol_value(symbol: Array, u: float, v: float, nearest: bool = False) -> float:
    """Value of an image whose texel (r, c) has its centre at u = (c + 1/2) / w, v = (r + 1/2) / h, clamped at the border; bilinear."""
    h, w = symbol.shape
    if nearest:
        return float(symbol[min(int(v * h), h - 1), min(int(u * w), w - 1)])
    r, c = min(max(v * h - 0.5, 0.0), h - 1.0), min(max(u * w - 0.5, 0.0), w - 1.0)
    r0, c0 = math.floor(r), math.floor(c)
    r1, c1 = min(r0 + 1, h - 1), min(c0 + 1, w - 1)
    upper = symbol[r0, c0] * (c0 + 1 - c) + symbol[r0, c1] * (c - c0)
    lower = symbol[r1, c0] * (c0 + 1 - c) + symbol[r1, c1] * (c - c0)
    return float(upper * (r0 + 1 - r) + lower * (r - r0))


def seen_at(point: Array, eye: Array, origin: Array, d1: Array, d2: Array) -> tuple[float, float] | None:
    """Where the line of sight from an eye to a point passes a rectangle before it, u and v in 0..1; None where it does not (T 7.2.2)."""
    along, u, v = np.linalg.solve(np.column_stack([point - eye, -d1, -d2]), origin - eye)
    return (float(u), float(v)) if along > 0 and 0 <= u <= 1 and 0 <= v <= 1 else None


def ray_through(headlight: Headlight, row: float, col: float) -> Array:
    """Direction [1, y, z] of continuous texture coordinates, texel centres at integers."""
    y = headlight.left + (col + 0.5) / headlight.cols * (headlight.right - headlight.left)
    z = headlight.top + (row + 0.5) / headlight.rows * (headlight.bottom - headlight.top)
    return np.array([1.0, y, z])


def trace(primitives: Primitives, headlight: Headlight, T_world_headlight: Array, asked: Asked | None = None) -> list[Ray]:
    """The setpoint of the ray through every texel's centre, row by row, for a single scene (T eq. 7.2.1 and 7.3.3)."""
    texels = [(row, col) for row in range(headlight.rows) for col in range(headlight.cols)]
    return [_cast(primitives, headlight, T_world_headlight, row, col, asked) for row, col in texels]


def _cast(primitives: Primitives, headlight: Headlight, T_world_headlight: Array, row: int, col: int, asked: Asked | None) -> Ray:
    R, position = T_world_headlight[:3, :3], T_world_headlight[:3, 3]
    ray = R @ ray_through(headlight, row, col)
    ray /= np.linalg.norm(ray)
    best: tuple[tuple[float, ...], Ray] | None = None
    for p in range(len(primitives)):
        origin, d1, d2, normal = (np.asarray(getattr(primitives, name)[p], dtype=float) for name in ("origin", "d1", "d2", "normal"))
        weight, value = float(primitives.weight[p]), float(primitives.value[p])
        quantity = QUANTITIES[int(primitives.quantity[p])]
        if value == 0 and math.isinf(weight):
            length = _masked_at(origin - position, d1, d2, normal, headlight, R, row, col)
            if length is None:
                continue
        else:
            cosine = normal @ -ray
            if cosine <= 0:
                continue
            length, u, v = np.linalg.solve(np.column_stack([ray, -d1, -d2]), origin - position)
            if length <= 0 or not (0 <= u <= 1 and 0 <= v <= 1):
                continue
            symbol = np.asarray(primitives.symbols[int(primitives.symbol_of[p])], dtype=float)
            point, at = position + length * ray, (float(u), float(v))
            if (eye := _eye(primitives, p)) is not None:
                at = seen_at(point, *eye)
            if symbol.ndim == 3:
                symbol, opacity = symbol
                if at is not None and symbol_value(opacity, *at, bool(primitives.nearest[p])) < 0.5:
                    continue
            value *= 0.0 if at is None else symbol_value(symbol, *at, bool(primitives.nearest[p]))
            if quantity == "E_v":
                value *= length**2 / cosine
            if asked is not None:
                value = _answered(asked, value, point, primitives, p)
        forced, priority = bool(primitives.forced[p]), int(primitives.priority[p])
        rank = (forced, priority if forced else 0, -length, priority, p)
        if best is None or _beats(rank, best[0]):
            best = rank, Ray(True, value, weight, quantity)
    return Ray() if best is None else best[1]


def _eye(primitives: Primitives, p: int) -> list[Array] | None:
    """Eye and flying symbol of a primitive's observer."""
    who = primitives.observer
    if who is None or not who.active[p]:
        return None
    return [np.asarray(each[p], dtype=float) for each in (who.eye, who.origin, who.d1, who.d2)]


def _answered(asked: Asked, value: float, point: Array, primitives: Primitives, p: int) -> float:
    """A setpoint without the street lamps' part, shared by what the lights can give at the point, off where its observer sees it not."""
    if QUANTITIES[int(primitives.quantity[p])] in ("I_v", "E_v"):
        normal, own_name = np.asarray(primitives.normal[p], dtype=float), asked.lights[asked.own][0]
        street = sum(
            cd * max(normal @ (lamp - point), 0.0) / np.linalg.norm(lamp - point) ** 3
            for lamp, cd in asked.street_lamps
            if not asked.blocked(point, lamp)
        )
        away = asked.lights[asked.own][3][:3, 3] - point
        cosine = normal @ away / np.linalg.norm(away)
        if cosine > 0:
            value = max(value - street * (away @ away) / cosine, 0.0)
        names = primitives.modules[p]
        given = {
            name: _possible(point, grid, full, T) * (not asked.blocked(point, T[:3, 3]))
            for name, grid, full, T in asked.lights
            if name == own_name or (primitives.shared[p] and (not names or set(names) & {name, *name.split()}))
        }
        value *= given[own_name] / sum(given.values()) if given[own_name] else 0.0
    eye = _eye(primitives, p)
    return 0.0 if eye is not None and asked.blocked(point, eye[0]) else value


def _possible(point: Array, grid: Headlight, full: Array, T_world_headlight: Array) -> float:
    """Illuminance that a light can give, in lx, zero beyond its texture."""
    x, y, z = T_world_headlight[:3, :3].T @ (point - T_world_headlight[:3, 3])
    if x <= 0:
        return 0.0
    u, v = (grid.left - y / x) / (grid.left - grid.right), (grid.top - z / x) / (grid.top - grid.bottom)
    return symbol_value(full, u, v) / (x * x + y * y + z * z) if 0 <= u <= 1 and 0 <= v <= 1 else 0.0


def _beats(new: tuple[float, ...], old: tuple[float, ...]) -> bool:
    """Forced, then priority among forced, then the nearer; in one plane priority, then the later."""
    if new[:2] != old[:2]:
        return new[:2] > old[:2]
    if abs(new[2] - old[2]) <= 1e-9 * min(-new[2], -old[2]):
        return new[3:] > old[3:]
    return new[2] > old[2]


def _masked_at(origin: Array, d1: Array, d2: Array, normal: Array, headlight: Headlight, R: Array, row: int, col: int) -> float | None:
    """Distance at which a mask before the lamp takes a ray: its outline meets the square of two texels around the ray; else None.

    The square is tested as the implementation defines it: against each edge moved outwards until it passes the square's corners, and
    against the outline's bounding rectangle. Beyond the outline the plane goes on, but no nearer or farther than the corners.
    """
    corners = np.array([origin, origin + d1, origin + d1 + d2, origin + d2]) @ R
    assert (corners[:, 0] > 0).all(), "the reference masks only what lies before the lamp"
    if normal @ -(origin + d1 / 2 + d2 / 2) <= 0:
        return None
    at_row = (headlight.top - corners[:, 2] / corners[:, 0]) / (headlight.top - headlight.bottom) * headlight.rows - 0.5
    at_col = (headlight.left - corners[:, 1] / corners[:, 0]) / (headlight.left - headlight.right) * headlight.cols - 0.5
    if not (at_row.min() - 1.01 <= row <= at_row.max() + 1.01 and at_col.min() - 1.01 <= col <= at_col.max() + 1.01):
        return None
    middle = corners.mean(0)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        inward = np.cross(a, b)
        inward = inward if inward @ middle > 0 else -inward
        if max(inward @ ray_through(headlight, row + r, col + c) for r in (-1, 1) for c in (-1, 1)) < 0:
            return None
    plane = np.cross(d1 @ R, d2 @ R)
    ray = ray_through(headlight, row, col)
    closeness = (plane @ ray) / (plane @ middle)
    return float(np.linalg.norm(ray) / min(max(closeness, 1 / corners[:, 0].max()), 1 / corners[:, 0].min()))


def map_reduce(I_m: Array, rays: list[Ray], params: MrpcParams, u_def: Array, cols: int) -> tuple[Array, NDArray[np.bool_]]:
    """Utilisation `[n_p]` from a dense headlight matrix `[n_t, n_p]` and the rays of its texels, T eq. 7.4.1 to 7.4.5.

    Also which pixels have an entry so near to the threshold a_x that a rounding may decide. cols: the texture's columns.
    """
    n_t, n_p = I_m.shape
    u, close = u_def.copy(), np.zeros(n_p, dtype=bool)
    size = [I_m[:, j].sum() / I_m[:, j].max() if I_m[:, j].any() else 1.0 for j in range(n_p)]
    total = I_m.sum(1)
    mean = total[total > 0].mean()
    for j in range(n_p):
        texels = [i for i in range(n_t) if I_m[i, j] > 0]
        if not texels:
            continue
        peak = max(I_m[i, j] for i in texels)
        sampled = sample_weights(texels, I_m[:, j], params.sampling, cols)
        finite, infinite, lit = [], [], 0
        for i in texels:
            I_s = _mapped(I_m, i, j, rays[i], params, u_def, size, total[i] / mean)
            lit += I_s > 0
            term = (I_m[i, j] ** params.a_r, I_s / I_m[i, j])
            if math.isinf(rays[i].weight):
                infinite.append(term)
                continue
            weight = min(rays[i].weight, 1e12) * sampled[i]
            tested = I_m[i, j] if params.exclusion == "capability" else I_s
            limit = params.a_x * peak
            if params.a_x:
                close[j] |= bool(abs(tested - limit) <= 1e-5 * limit)
                if tested < limit or (params.exclusion == "printed" and tested == limit):
                    weight = 0.0
            finite.append((weight * term[0], term[1]))
        if infinite:
            u[j] = sum(c * each for c, each in infinite) / sum(c for c, _ in infinite)
        elif sum(c for c, _ in finite) > 0:
            u[j] = sum(c * each for c, each in finite) / sum(c for c, _ in finite)
            if Fraction(lit, len(texels)) < Fraction(str(params.a_ac)):
                u[j] = 0.0
        u[j] = min(max(u[j], 0.0), 1.0)
    return u, close


def _mapped(I_m: Array, i: int, j: int, ray: Ray, params: MrpcParams, u_def: Array, size: list[float], bright: float) -> float:
    """I_s,ij within its bounds."""
    if not ray.hit:
        return float(I_m[i, j] * u_def[j])
    if ray.quantity == "u_abs":
        I_s = I_m[i, j] * ray.value
    elif ray.quantity == "u_rel":
        I_s = I_m[i, j] * ray.value * u_def[j]
    elif params.mapping == "direct":
        I_s = ray.value
    elif params.mapping == "maximal":
        I_s = I_m[i, j] / I_m[i].max() * ray.value
    else:
        potential = {k: I_m[i, k] ** params.a_m / size[k] ** params.granularity for k in range(len(u_def)) if I_m[i, k] > 0}
        I_s = potential[j] / sum(potential.values()) * ray.value
    if params.a_d is not None:
        I_s *= min(bright / params.a_d, 1.0)
    if not (ray.value == 0 and math.isinf(ray.weight)):
        I_s = max(I_s, params.lower_cd)
    if params.upper_cd is not None:
        I_s = min(I_s, params.upper_cd)
    return float(min(max(I_s, 0.0), I_m[i, j]))


def sample_weights(texels: list[int], light: Array, sampling: str, cols: int) -> dict[int, float]:
    """How often each of a pixel's texels is sampled (T 3.2); light: `[n_t]`, the pixel's."""
    weights = dict.fromkeys(texels, 0.0)
    place = {i: (i // cols, i % cols) for i in texels}

    def nearest(row: float, col: float, among: list[int]) -> int:
        return min(among, key=lambda i: (place[i][0] - row) ** 2 + (place[i][1] - col) ** 2)

    peak = max(light[i] for i in texels)
    if sampling == "all":
        return dict.fromkeys(texels, 1.0)
    if sampling == "brightest":
        among = [i for i in texels if light[i] == peak]
        weights[nearest(*(sum(place[i][axis] for i in among) / len(among) for axis in (0, 1)), among)] = 1.0
        return weights
    if sampling == "centroid":
        sums = (sum(place[i][axis] * light[i] for i in texels) / sum(light[i] for i in texels) for axis in (0, 1))
        weights[nearest(*sums, texels)] = 1.0
        return weights
    extent = [place[i] for i in texels if light[i] >= peak / 2]
    low, high = ([end(p[axis] for p in extent) + shift for axis in (0, 1)] for end, shift in ((min, -0.5), (max, 0.5)))
    tilt = [math.atan(0.5) + k * math.pi / 2 for k in range(4)]
    pattern = {
        "uniform": [(r, c, 1.0) for r in (0.25, 0.75) for c in (0.25, 0.75)],
        "rotated": [(0.5 + 0.395 * math.sin(t), 0.5 + 0.395 * math.cos(t), 1.0) for t in tilt],
        "n_rooks": [(0.625, 0.125, 1.0), (0.125, 0.375, 1.0), (0.875, 0.625, 1.0), (0.375, 0.875, 1.0)],
        "quincunx": [(0.5, 0.5, 0.5)] + [(r, c, 0.125) for r in (0, 1) for c in (0, 1)],
    }[sampling]
    for r, c, weight in pattern:
        weights[nearest(low[0] + r * (high[0] - low[0]), low[1] + c * (high[1] - low[1]), texels)] += weight
    return weights
