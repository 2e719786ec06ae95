"""A mark in the light that identifies one of four exposures: two bits of a Gray code, each a cell beside its complement.

The light may change during the first picture that shows its mark, so the second one is used.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from luxloop.loop.rig.light import Picture
from luxloop.loop.rig.params import LimitParams, MarkParams
from luxloop.world.errors import LuxloopError

CODES = 4
INNER = 0.25  # of a cell's width and height, left out at each border
AROUND = 0.5  # of the mark's width and height, by which its light may reach beyond it


def drawn(pictures: Sequence[Picture], mark: MarkParams, number: int) -> tuple[Picture, ...]:
    """Pictures of utilisations with the mark of an exposure drawn into them. number: of the exposure."""
    marked = list(pictures)
    picture = marked[mark.module].copy()
    width = mark.columns // 4
    for cell, lit in enumerate(cells(number)):
        first = mark.column + cell * width
        picture[mark.row : mark.row + mark.rows, first : first + width] = np.float32(lit)
    marked[mark.module] = picture
    return tuple(marked)


def cells(number: int) -> tuple[bool, bool, bool, bool]:
    """Which cells are lit, from the left. From one exposure to the next, exactly one pair of cells changes."""
    gray = (number % CODES) ^ (number % CODES >> 1)
    high, low = bool(gray & 2), bool(gray & 1)
    return high, not high, low, not low


def spared(limits: LimitParams, mark: MarkParams, grids: Sequence[tuple[int, int]]) -> LimitParams:
    """Limits of the light outside the mark, half of whose cells are always lit. grids: rows and columns of the modules' pixels.

    Raises LuxloopError if the mark alone needs all the power.
    """
    share = 2 * (mark.columns // 4) * mark.rows / sum(rows * columns for rows, columns in grids)
    if share >= limits.share:
        raise LuxloopError(f"mark: takes {share:.1%} of the lamp's power, where limits allow {limits.share:.1%}; make it smaller")
    return limits.model_copy(update={"power": limits.share - share, "power_w": None})


def shown(image: NDArray[np.float32], mark: MarkParams) -> int | None:
    """Number modulo 4 of the exposure that an image `[height, width]` shows; None if the contrast is too low."""
    levels = [_level(image, mark, cell) for cell in range(4)]
    bits = []
    for a, b in ((levels[0], levels[1]), (levels[2], levels[3])):
        if not abs(a - b) >= mark.contrast * (a + b) or a == b:
            return None
        bits.append(a > b)
    return next(number for number in range(CODES) if cells(number)[::2] == tuple(bits))


def surroundings(mark: MarkParams) -> tuple[slice, slice]:
    """Rows and columns of the image that a mark's light may reach."""
    sides = (mark.v_px, mark.height_px), (mark.u_px, mark.width_px)
    rows, columns = (slice(max(int(at - AROUND * n), 0), int(at + (1 + AROUND) * n) + 1) for at, n in sides)
    return rows, columns


def _level(image: NDArray[np.float32], mark: MarkParams, cell: int) -> float:
    width = mark.width_px / 4
    u, v = mark.u_px + cell * width, mark.v_px
    left, right = math.floor(u + INNER * width), math.ceil(u + (1 - INNER) * width)
    top, bottom = math.floor(v + INNER * mark.height_px), math.ceil(v + (1 - INNER) * mark.height_px)
    part = image[top:bottom, left:right]
    return float(part.mean()) if part.size else 0.0
