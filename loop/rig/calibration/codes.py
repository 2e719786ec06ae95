"""Structured light: Gray codes and phase steps along the rows and columns of a lamp's pixels, read at each camera pixel.

A cosine with a period of `PERIOD` pixels is shifted in `STEPS` steps; its phase is the position within a period. Gray codes of half a
period number the periods. Both are compared with the mean of the phase steps at the same camera pixel.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import maximum_filter

from luxloop.loop.rig.calibration.bench import Array

PERIOD: Final = 16  # pixels
STEPS: Final = 8
CELL: Final = PERIOD // 2  # pixels of one Gray code
LEAST_CONTRAST: Final = 0.1  # amplitude of the cosine over its mean
AROUND: Final = 7  # camera pixels, over which the brightest is looked for
LEAST_LIGHT: Final = 0.5  # share of that: the edge of the outermost pixels lies where their light has fallen to a half
NOISES: Final = 6.0  # amplitude of the cosine over its noise: a wrong period is then as rare as five standard deviations


@dataclass(frozen=True)
class Pattern:
    """Name and utilisation `[n_p]` of one light of a module."""

    name: str
    u: Array


@dataclass(frozen=True, eq=False)
class Decoded:
    """Lamp coordinates read at each camera pixel; lamp pixel (r, c) has its centre at (r + 0.5, c + 0.5).

    row, col: `[height, width]`. valid: `[height, width]` bool, where they could be read.
    """

    row: Array
    col: Array
    valid: np.ndarray


def patterns(rows: int, cols: int) -> list[Pattern]:
    """All patterns to locate the pixels of a module of rows x cols pixels, the first one dark."""
    found = [Pattern("dark", np.zeros(rows * cols))]
    for axis, n in (("row", rows), ("column", cols)):
        for name, line in _lines(n):
            along = np.repeat(line, cols) if axis == "row" else np.tile(line, rows)
            found.append(Pattern(f"{axis}_{name}", along))
    return found


def _lines(n: int) -> Iterator[tuple[str, Array]]:
    """Utilisations `[n]` along one axis: the phase steps, then the bits of the Gray code, the highest first."""
    place = np.arange(n) + 0.5
    for k in range(STEPS):
        yield f"phase_{k}", 0.5 + 0.5 * np.cos(2 * np.pi * (place / PERIOD - k / STEPS))
    code = np.arange(n) // CELL
    code = code ^ code >> 1
    for bit in reversed(range(bits(n))):
        yield f"gray_{bit}", (code >> bit & 1).astype(float)


def bits(n: int) -> int:
    """Bits of the Gray code of n pixels."""
    return max(int(np.ceil(np.log2(-(-n // CELL)))), 0)


def decode(light: Sequence[Array], rows: int, cols: int, noise: Array) -> Decoded:
    """Read the frames of `patterns`, `[height, width]` each in a linear unit. noise: `[height, width]`, standard deviation of one.

    Where the light of several pixels overlaps, the position is their weighted mean. Nothing is read beyond the outer edges of the field,
    where only the outermost pixels' light arrives.
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
    return Decoded(places[0], places[1], valid)


def _place(phases: Array, gray: Sequence[Array], noise: Array) -> tuple[Array, np.ndarray]:
    """Place `[height, width]` along one axis in pixels, and where it is sound."""
    turn = np.exp(2j * np.pi * np.arange(STEPS) / STEPS)
    sine = 2 / STEPS * np.tensordot(turn, phases, 1)  # its angle is the phase [height, width]
    mean = phases.mean(0)
    amplitude = np.abs(sine)
    sound = (amplitude > LEAST_CONTRAST * mean) & (amplitude > NOISES * noise)
    code = np.zeros(mean.shape, int)
    before = np.zeros(mean.shape, int)
    for each in gray:
        before = before ^ (each > mean)  # from Gray code to binary, bit by bit
        code = code << 1 | before
    within = np.angle(sine) / (2 * np.pi) * PERIOD
    middle = CELL * (code + 0.5)
    place = within + PERIOD * np.round((middle - within) / PERIOD)
    return place, sound & (np.abs(place - middle) < 0.75 * PERIOD / 2)
