"""SuperSampling Control ray by ray and pixel by pixel in float64, as T 7.3 and 7.4 write it; it shares no code with what it checks."""

import math

import numpy as np
from numpy.typing import NDArray

from controllers.primitives import QUANTITIES, Primitives
from world.headlight import Headlight

Array = NDArray[np.float64]


def symbol_value(symbol: Array, u: float, v: float) -> float:
    """Bilinear value of an image whose texel (r, c) has its centre at u = (c + 1/2) / w, v = (r + 1/2) / h, clamped at the border."""
    h, w = symbol.shape
    r, c = min(max(v * h - 0.5, 0.0), h - 1.0), min(max(u * w - 0.5, 0.0), w - 1.0)
    r0, c0 = math.floor(r), math.floor(c)
    r1, c1 = min(r0 + 1, h - 1), min(c0 + 1, w - 1)
    upper = symbol[r0, c0] * (c0 + 1 - c) + symbol[r0, c1] * (c - c0)
    lower = symbol[r1, c0] * (c0 + 1 - c) + symbol[r1, c1] * (c - c0)
    return float(upper * (r0 + 1 - r) + lower * (r - r0))


def trace(primitives: Primitives, headlight: Headlight, T_world_headlight: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Setpoint and hit of the ray through every texel's centre, `[rows, cols]`, for a single scene (7.3.3)."""
    setpoint = np.zeros((headlight.rows, headlight.cols))
    hit = np.zeros((headlight.rows, headlight.cols), dtype=bool)
    R, position = T_world_headlight[:3, :3], T_world_headlight[:3, 3]
    origins, d1s, d2s, normals = (
        np.asarray(value, dtype=float) for value in (primitives.origin, primitives.d1, primitives.d2, primitives.normal)
    )
    for row in range(headlight.rows):
        for col in range(headlight.cols):
            y = headlight.left + (col + 0.5) / headlight.cols * (headlight.right - headlight.left)
            z = headlight.top + (row + 0.5) / headlight.rows * (headlight.bottom - headlight.top)
            ray = R @ np.array([1.0, y, z]) / math.sqrt(1 + y * y + z * z)
            nearest = math.inf
            for p in range(len(origins)):
                cosine = normals[p] @ -ray
                if cosine <= 0:
                    continue
                length, u, v = np.linalg.solve(np.column_stack([ray, -d1s[p], -d2s[p]]), origins[p] - position)
                if length <= 0 or not (0 <= u <= 1 and 0 <= v <= 1) or length > nearest:
                    continue
                value = symbol_value(np.asarray(primitives.symbols[primitives.symbol_of[p]], dtype=float), u, v) * float(
                    primitives.value[p]
                )
                if QUANTITIES[primitives.quantity[p]] == "E_v":
                    value *= length**2 / cosine
                nearest, setpoint[row, col], hit[row, col] = length, value, True
    return setpoint, hit


def map_reduce(I_m: Array, setpoint: Array, hit: NDArray[np.bool_], quantity: str, a_m: float, a_r: float, u_def: Array) -> Array:
    """Utilisation `[n_p]` from a dense headlight matrix `[n_t, n_p]` and the setpoints and hits `[n_t]` of its texels (7.4.1), (7.4.5)."""
    n_t, n_p = I_m.shape
    u = u_def.copy()
    for j in range(n_p):
        texels = [i for i in range(n_t) if I_m[i, j] > 0]
        numerator = denominator = 0.0
        for i in texels:
            if not hit[i]:
                I_s = I_m[i, j] * u_def[j]
            elif quantity == "u_abs":
                I_s = I_m[i, j] * setpoint[i]
            elif quantity == "u_rel":
                I_s = I_m[i, j] * setpoint[i] * u_def[j]
            else:
                total = sum(I_m[i, k] ** a_m for k in range(n_p) if I_m[i, k] > 0)
                I_s = I_m[i, j] ** a_m / total * setpoint[i]
            I_s = min(max(I_s, 0.0), I_m[i, j])
            numerator += I_m[i, j] ** a_r * I_s / I_m[i, j]
            denominator += I_m[i, j] ** a_r
        if texels:
            u[j] = numerator / denominator
    return u
