"""The content of an OpenCRG file as a value."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from luxloop.world.errors import LuxloopError

KINDS = {"LRFI": None, "LDFI": None, "KRBI": np.dtype(">f4"), "KDBI": np.dtype(">f8")}
FINEST_M = 1e-5  # least spacing of grid points; no road is measured as finely
TEXT_WIDTH = {"LRFI": 10, "LDFI": 20}


@dataclass(frozen=True)
class Crg:
    """A curved regular grid as stored: no modifier applied, NaN where nothing was measured.

    `road`, `options` and `modifiers` hold the header's numbers under their lower-case keys (`reference_line_start_x`).
    """

    z: NDArray[np.float64]  # [n_u, n_v] m above the reference line
    v: NDArray[np.float64]  # [n_v] m to the left of the reference line, ascending
    road: Mapping[str, float]
    phi: NDArray[np.float64] | None = None  # [n_u] rad, heading of the segment that ends at row i; row 0 means nothing
    slope: NDArray[np.float64] | None = None  # [n_u] m/m, of the segment that ends at row i; row 0 means nothing
    banking: NDArray[np.float64] | None = None  # [n_u] m/m, of row i
    options: Mapping[str, float] = field(default_factory=dict)
    modifiers: Mapping[str, float] = field(default_factory=dict)
    source: str = "OpenCRG data"  # the file that it came from, for messages

    def line(self, key: str, default: float = 0.0) -> float:
        """The header's `REFERENCE_LINE_<KEY>`."""
        return self.road.get(f"reference_line_{key}", default)

    @property
    def u_start(self) -> float:
        return self.line("start_u")

    @property
    def u_step(self) -> float:
        return self.road["reference_line_increment"]

    @property
    def u_end(self) -> float:
        return self.u_start + self.u_step * (len(self.z) - 1)


def fill_gaps(crg: Crg, offset_m: float = 0.0) -> Crg:
    """Replace every NaN by the nearest valid elevation of its cross-section plus `offset_m`; an empty one takes its neighbour's."""
    valid = np.isfinite(crg.z)
    rows = np.flatnonzero(valid.any(axis=1))
    if not len(rows):
        raise LuxloopError(f"{crg.source}: has no valid elevation at all: fetch the file again")
    index = np.arange(crg.z.shape[1])
    last = np.maximum.accumulate(np.where(valid, index, -1), axis=1)
    following = np.minimum.accumulate(np.where(valid, index, 2 * len(index))[:, ::-1], axis=1)[:, ::-1]
    nearest = np.where(index - np.where(last < 0, -len(index), last) <= following - index, last, following)
    z = np.take_along_axis(crg.z, np.clip(nearest, 0, len(index) - 1), axis=1) + np.where(valid, 0.0, offset_m)
    following_row = rows[np.clip(np.searchsorted(rows, np.arange(len(z))), 0, len(rows) - 1)]
    return replace(crg, z=z[following_row])
