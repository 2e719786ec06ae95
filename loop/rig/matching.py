"""Assignment of frames to light, by the time from sending the light to the frame's arrival, or by a mark in the frame.

The mark identifies one of four exposures: two bits of a Gray code, each a cell beside its complement. The light may change during the first
picture that shows its mark, so the second one is used. A doubtful frame is not assigned.
"""

import math
import statistics
from collections import deque
from collections.abc import Sequence
from typing import Literal

import numpy as np

from luxloop.loop.rig.arrays import Array, Grids, Image, pixels_in
from luxloop.loop.rig.light import Picture
from luxloop.loop.rig.params import LimitParams, MarkParams, TimingParams
from luxloop.world.errors import LuxloopError

FrameContent = Literal["old", "mixed", "clear"]
GAPS = 61  # intervals between pictures whose median is the camera's period
FEWEST = 8  # intervals for a first period
KEPT = 0.9  # decay of the lateness per picture, since a lost picture looks like lateness that nothing catches up
CATCHING_UP = 0.5  # share of the period; at shorter intervals pictures come from a queue, and lateness does not decay
IN_TIME = 0.5  # share of jitter_s by which punctual pictures may be late


def shows(lag_s: float, timing: TimingParams, late_s: float = 0.0) -> FrameContent:
    """Content of a free-running camera's frame that arrives `lag_s` after the current light was sent.

    A frame whose exposure begins together with the light arrives `latency_s` after the light was sent, at most `jitter_s` later, or
    `late_s` later by the camera's own rhythm. This rhythm is that of punctual pictures, which may themselves be late by a share of the
    jitter. A frame that arrives later than all of these is clear: it shows the new light alone. A frame that arrives `rolling_s` before
    `latency_s` shows the old light alone. Frames between these times may be mixed.
    """
    if lag_s > timing.latency_s + max(timing.jitter_s, late_s + IN_TIME * timing.jitter_s):
        return "clear"
    return "old" if lag_s <= timing.latency_s - timing.rolling_s else "mixed"


def needed_s(lateness_s: Array, predicted_s: Array) -> float:
    """Least `jitter_s` with which `shows` calls none of the given mixed pictures clear.

    lateness_s: `[n]`, arrival later than `latency_s`. predicted_s: `[n]`, lateness by `Regularity`.
    """
    return float(np.minimum(lateness_s, (lateness_s - predicted_s) / IN_TIME).max(initial=0.0))


class Regularity:
    """Lateness of a free-running camera's pictures against its period, counted from punctual ones."""

    def __init__(self) -> None:
        self._gaps, self._late_s = deque[float](maxlen=GAPS), 0.0
        self._last_s: float | None = None

    def late(self, arrived_s: float) -> float:
        """Lateness in s of the next picture, infinite until the period is known.

        If pictures queue behind one that is stuck, all of these are late.
        """
        if self._last_s is not None:
            gap_s = arrived_s - self._last_s
            self._gaps.append(gap_s)
            period_s = statistics.median(self._gaps)
            kept = KEPT if gap_s > CATCHING_UP * period_s else 1.0
            self._late_s = max(kept * self._late_s + gap_s - period_s, 0.0)
        self._last_s = arrived_s
        if len(self._gaps) < FEWEST:
            self._late_s = 0.0
            return math.inf
        return self._late_s


CODES = 4
INNER = 0.25  # share of a cell's width and height left out at each border
AROUND = 0.5  # reach of the mark's light beyond its border, as a share of its width and height


def draw_mark(pictures: Sequence[Picture], mark: MarkParams, number: int) -> tuple[Picture, ...]:
    """Pictures of utilisations with the mark of an exposure. number: of the exposure."""
    picture, width = pictures[mark.module].copy(), mark.columns // 4
    cells = np.repeat(np.array(mark_cells(number), np.float32), width)
    picture[mark.row : mark.row + mark.rows, mark.column : mark.column + 4 * width] = cells
    return (*pictures[: mark.module], picture, *pictures[mark.module + 1 :])


def mark_cells(number: int) -> tuple[bool, bool, bool, bool]:
    """Lit cells from the left. From one exposure to the next, exactly one pair of cells changes."""
    gray = (number % CODES) ^ (number % CODES >> 1)
    high, low = bool(gray & 2), bool(gray & 1)
    return high, not high, low, not low


def limits_beside_mark(limits: LimitParams, mark: MarkParams, grids: Grids) -> LimitParams:
    """Limits of the light outside the mark, half of whose cells are always lit.

    grids: rows and columns of the modules' pixels. Raises LuxloopError if the mark does not fit its module, or needs all the power.
    """
    if mark.module >= len(grids):
        raise LuxloopError(f"mark.module: there is no module {mark.module}; the scenario has {len(grids)}, numbered from 0")
    rows, columns = grids[mark.module]
    if mark.row + mark.rows > rows or mark.column + mark.columns > columns:
        raise LuxloopError(f"mark: lies beyond the {rows} x {columns} pixels of module {mark.module}; move it, or make it smaller")
    if mark.columns < 4:
        raise LuxloopError("mark.columns: four cells need four columns at least")
    share = 2 * (mark.columns // 4) * mark.rows / pixels_in(grids)
    if share >= limits.share:
        raise LuxloopError(f"mark: takes {share:.1%} of the lamp's power, where limits allow {limits.share:.1%}; make it smaller")
    return limits.model_copy(update={"power": limits.share - share, "power_w": None})


def read_mark(image: Image, mark: MarkParams) -> int | None:
    """Number modulo 4 of the exposure by the mark in an image `[height, width]`; None if the contrast is too low."""
    a, b = np.reshape([_level(image, mark, cell) for cell in range(4)], (2, 2)).T
    if not (np.abs(a - b) >= mark.contrast * (a + b)).all() or (a == b).any():
        return None
    return next(number for number in range(CODES) if mark_cells(number)[::2] == tuple(a > b))


def mark_surroundings(mark: MarkParams) -> tuple[slice, slice]:
    """Rows and columns of the image that a mark's light may reach."""
    sides = (mark.v_px, mark.height_px), (mark.u_px, mark.width_px)
    rows, columns = (slice(max(int(at - AROUND * n), 0), int(at + (1 + AROUND) * n) + 1) for at, n in sides)
    return rows, columns


def _level(image: Image, mark: MarkParams, cell: int) -> float:
    width = mark.width_px / 4
    u, v = mark.u_px + cell * width, mark.v_px
    left, right = math.floor(u + INNER * width), math.ceil(u + (1 - INNER) * width)
    top, bottom = math.floor(v + INNER * mark.height_px), math.ceil(v + (1 - INNER) * mark.height_px)
    part = image[top:bottom, left:right]
    return float(part.mean()) if part.size else 0.0
