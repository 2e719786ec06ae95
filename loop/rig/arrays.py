"""Types of a rig's arrays."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
Image = NDArray[Any]  # [height, width], or [height, width, 3] (blue, green, red)
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
Data = bytes | Image  # a picture as a camera sends it, encoded or raw
Grids = Sequence[tuple[int, int]]  # rows and columns of the modules' pixels


def pixels_in(grids: Grids) -> int:
    """Number of the pixels of all modules."""
    return sum(rows * columns for rows, columns in grids)


def grids_of(modules: Sequence[Any]) -> Grids:
    """Rows and columns of the pixels of each module."""
    return tuple((each.headlight.pixel_rows, each.headlight.pixel_cols) for each in modules)
