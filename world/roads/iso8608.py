"""Random road roughness after ISO 8608, as an isotropic surface."""

from functools import lru_cache

import numpy as np
import scipy  # whose parts are loaded when they are first named
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

REFERENCE_FREQUENCY = 0.1  # n0, cycles/m
GEOMETRIC_MEAN_M3 = {"A": 16e-6, "B": 64e-6, "C": 256e-6, "D": 1024e-6, "E": 4096e-6}  # Gd(n0)
BAND = (0.011, 2.83)  # cycles/m, where the standard states limits
# Waves go on beyond the band: a section near the cut would miss those that cross it at an angle (12 % of the density at 2.83).
_CUT = 6.0
_SPLIT = 0.5
_SAMPLES = 1024
_COS, _SIN = np.cos(0.5), np.sin(0.5)


def roughness(roughness_class: str, seed: int, x: ArrayLike, y: ArrayLike) -> Floats:
    """Height in m of a random surface whose every straight section has the density of its class.

    Long waves come from a tile of 256 m, short ones from a tile of 32 m, both repeated, but at an angle at which no wheel track repeats.
    """
    along, across = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    coordinates = np.stack([(_COS * along - _SIN * across).ravel(), (_SIN * along + _COS * across).ravel()])
    unit = np.zeros(along.size)
    for coefficients, spacing in _tiles(seed):
        unit += scipy.ndimage.map_coordinates(coefficients, coordinates / spacing, order=3, mode="grid-wrap", prefilter=False)
    return np.sqrt(GEOMETRIC_MEAN_M3[roughness_class] * REFERENCE_FREQUENCY**2) * unit.reshape(along.shape)


@lru_cache(maxsize=4)
def _tiles(seed: int) -> tuple[tuple[Floats, float], ...]:
    generator = np.random.default_rng(seed)
    return tuple((_tile(generator, spacing, band), spacing) for spacing, band in ((1 / 4, (BAND[0], _SPLIT)), (1 / 32, (_SPLIT, _CUT))))


def _tile(generator: np.random.Generator, spacing: float, band: tuple[float, float]) -> Floats:
    """Cubic spline coefficients `[n, n]` of white noise filtered so that sections have Gd(n) = n^-2 in the band."""
    k = np.hypot(np.fft.fftfreq(_SAMPLES, spacing)[:, None], np.fft.rfftfreq(_SAMPLES, spacing))
    inside = (k >= band[0]) & (k < band[1])
    # A two-dimensional density k^-3 / 4 integrates across a section to n^-2 / 2, two-sided; white noise has spacing^2.
    gain = np.where(inside, 0.5 / spacing * np.where(inside, k, 1.0) ** -1.5, 0.0)
    white = generator.standard_normal((_SAMPLES, _SAMPLES))
    surface = np.fft.irfft2(np.fft.rfft2(white) * gain, s=white.shape)
    return np.asarray(scipy.ndimage.spline_filter(surface, order=3, mode="grid-wrap"), np.float64)
