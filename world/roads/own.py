"""A user-defined road, named in the scenario by `package.module:Name`."""

from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.roads.base import Floats, MeshGrid, Road, RoadModel


class OwnRoad(RoadModel):
    """`Name(**options)` of a user's module makes the road, a `Road`."""

    kind: plugin.OwnName
    options: dict[str, Any] = Field({}, description="keyword arguments of Name")

    @cached_property
    def road(self) -> Road:
        """The road itself. Raises LuxloopError if it does not exist, refuses its options or lacks a method."""
        return cast(Road, plugin.make(self.kind, "road.kind", {}, self.options, ("z", "grid")))

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Its heights. Raises LuxloopError where these are not numbers, one a place, and finite."""
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        places = np.broadcast_shapes(x.shape, y.shape)
        heights = np.asarray(self.road.z(x, y))
        if heights.dtype.kind not in "fiu" or not np.isfinite(heights).all():
            raise LuxloopError(f"road.kind: {self.kind}: z gives values that are not finite; give a height in m everywhere")
        try:
            return np.array(np.broadcast_to(heights, places), np.float64)
        except ValueError as error:
            raise LuxloopError(f"road.kind: {self.kind}: z gives heights {heights.shape} for places {places}; give one a place") from error

    def grid(self) -> MeshGrid:
        """Its mesh. Raises LuxloopError where it gives none."""
        grid = self.road.grid()
        if not isinstance(grid, MeshGrid):
            raise LuxloopError(f"road.kind: {self.kind}: grid gives {type(grid).__name__}; give a world.roads.base.MeshGrid")
        return grid
