"""A step as a program gets it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class State:
    """A step of a run; what is not asked for, or not there in this step, is empty or None.

    head: what is plain, as docs/programs.md has it. metrics: the values of the recording, by column, NaN where there is none.
    light: `[rows, columns]` float32 cd, the texture of each module by its name. utilisations: `[rows, columns]` uint8 of its pixels, 255
    for full utilisation. arrays: all others, by name.
    """

    head: Mapping[str, Any]
    metrics: Mapping[str, float]
    light: Arrays
    utilisations: Arrays
    arrays: Arrays

    @property
    def step(self) -> int:
        """Its number, from 0."""
        return int(self.head["step"])

    @property
    def time_s(self) -> float:
        """When it begins."""
        return float(self.head["time_s"])

    @property
    def frames(self) -> tuple[np.ndarray, ...]:
        """Digital numbers `[height, width]` of the frames that came in it: with all light, and, where controllers hold symbols, without."""
        return tuple(self.arrays[name] for name in ("frames.on", "frames.off") if name in self.arrays)

    @property
    def depth(self) -> np.ndarray | None:
        """`[height, width]` float32 m along the camera's axis, 0 where there is nothing."""
        return self.arrays.get("depth")

    @property
    def instances(self) -> np.ndarray | None:
        """What each pixel sees, `[height, width]` uint16: an index in `instance_names`."""
        return self.arrays.get("instances")

    @property
    def instance_names(self) -> list[str]:
        """Names of what there is; the first, "", is nothing, the second the road."""
        return list(self.head.get("instances", ()))

    @property
    def materials(self) -> np.ndarray | None:
        """The material that each pixel sees, `[height, width]` uint8: an index in `material_names`."""
        return self.arrays.get("materials")

    @property
    def material_names(self) -> list[str]:
        """Names of materials; the first, "", is nothing."""
        return list(self.head.get("materials", ()))

    @property
    def objects(self) -> list[Mapping[str, Any]]:
        """The truth of all objects that are there: `name`, `category`, `instance` (its index in `instance_names`), `T_world_object`
        (16 numbers, row by row), `size_m`, `box` (left, top, right, bottom in px of its visible part, None where it is not seen) and
        `visible` (share that is not hidden).
        """
        return list(self.head.get("truth", ()))
