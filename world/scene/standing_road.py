"""The road around a vehicle that stands, meshed when somebody looks at it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor

from luxloop.world.kept import keeping
from luxloop.world.materials.library import Texture
from luxloop.world.materials.spots import SpottedTexture
from luxloop.world.roads.base import Road
from luxloop.world.roads.mesh import refuse_broken, road_mesh
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.scene.triangles import Placed


@dataclass(frozen=True, eq=False)
class StandingRoad:
    """A road meshed as a whole. albedo, texture: as those of a `Body`. Raises LuxloopError of a road that has no heights."""

    road: Road
    albedo: float
    texture: Texture | SpottedTexture | None
    name: str = "road"
    track: PoseTrack = field(default_factory=PoseTrack.static)

    def __post_init__(self) -> None:
        refuse_broken(self.road)

    @cached_property
    def _placed(self) -> Callable[[int], Placed]:
        """`_make`, memoised."""
        return keeping(1, self._make)

    def near(self, object_id: int, T_world_ground: Tensor) -> tuple[Placed, ...]:
        """All of it, wherever the vehicle is, as the body `object_id`."""
        return (self._placed(object_id),)

    def _make(self, object_id: int) -> Placed:
        body = Body(self.name, road_mesh(self.road), self.albedo, self.texture, smooth=True)
        return Placed(object_id, body, torch.eye(4, dtype=torch.float64))
