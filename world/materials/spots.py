"""Unexpected spots on the road: paint, patches, puddles."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor
from torch.nn.functional import pad

from luxloop.world.kept import keeping
from luxloop.world.materials.brdf import Material
from luxloop.world.materials.library import MATERIALS, MaterialName, RoadSurfaceParams, Texture
from luxloop.world.params import Params

SPARE_M = 0.01  # beyond a spot, for rounding in float32 some hundred metres ahead
TOGETHER = 64  # neighbouring points


class SpotParams(Params):
    """A region of the road with a different albedo or material; where spots overlap, the last one is on top."""

    shape: Literal["ellipse", "rectangle"] = Field("ellipse", description="outline")
    x_m: float = Field(ge=-10_000, le=10_000, examples=[17.0], description="centre ahead in the world")
    y_m: float = Field(0.0, ge=-10_000, le=10_000, description="centre to the left")
    length_m: float = Field(1.0, gt=0, le=200, description="extent along x before rotation")
    width_m: float = Field(1.0, gt=0, le=200, description="extent along y before rotation")
    yaw_deg: float = Field(0.0, ge=-180, le=180, description="rotation to the left")
    albedo_factor: float = Field(1.0, ge=0, le=10, description="dry albedo as a multiple of that of the dry road there")
    material: MaterialName | None = Field(None, description="material by name; left out: that of the road around it")

    def covers(self, x: Tensor, y: Tensor) -> Tensor:
        """Whether points (x, y), m in the world, lie on it; bool in their shape."""
        dx, dy, yaw = x - self.x_m, y - self.y_m, math.radians(self.yaw_deg)
        along = (math.cos(yaw) * dx + math.sin(yaw) * dy) / (self.length_m / 2)
        across = (math.cos(yaw) * dy - math.sin(yaw) * dx) / (self.width_m / 2)
        return (along.square() + across.square() if self.shape == "ellipse" else torch.maximum(along.abs(), across.abs())) <= 1


@dataclass(frozen=True, eq=False)
class SpottedTexture:
    """A road's texture, made when somebody looks at it, and spots on it: they are there once, where the texture around them repeats."""

    surface: RoadSurfaceParams
    spots: tuple[SpotParams, ...]

    @cached_property
    def _around(self) -> Texture:
        return self.surface.texture()

    @cached_property
    def _dry(self) -> Texture:
        return self.surface.model_copy(update={"wet": 0.0}).texture() if self.surface.wet else self._around

    @cached_property
    def materials(self) -> tuple[Material, ...]:
        """Those of the road, then one a spot."""
        return (*self._around.materials, *map(self._material, self.spots))

    @property
    def names(self) -> tuple[MaterialName, ...]:
        """Those of the materials; a spot of none is of what is around it."""
        return (*self._around.names, *(spot.material or self.surface.ground_name for spot in self.spots))

    def at(self, x: Tensor, y: Tensor) -> Tensor:
        """Albedo, float32 in the shape of x and y (m, body frame)."""
        shape, x, y = x.shape, x.flatten(), y.flatten()
        albedo = self._around.at(x, y)
        for spot, there in zip(self.spots, self._covered(x, y), strict=True):
            dry = self._dry.at(x[there], y[there]) * spot.albedo_factor
            albedo[there] = self._material(spot).darkened(dry.clamp(max=1))
        return albedo.view(shape)

    def material_at(self, x: Tensor, y: Tensor) -> Tensor:
        """Which of the materials is there, int64 in the shape of x and y (m, body frame)."""
        shape, x, y = x.shape, x.flatten(), y.flatten()
        number = self._around.material_at(x, y)
        for k, (spot, there) in enumerate(zip(self.spots, self._covered(x, y), strict=True), len(self._around.materials)):
            if spot.material is not None:
                number[there] = k
        return number.view(shape)

    @cached_property
    def _covered(self) -> Callable[[Tensor, Tensor], tuple[Tensor, ...]]:
        return keeping(1, self._covered_of)  # for albedo and material of the same points

    def _covered_of(self, x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        """Indices of the points (x, y) `[N]` that lie on each spot; first of neighbours together, most of which lie farther along x."""
        if not self.spots:
            return ()
        x, y = (pad(each, (0, -len(each) % TOGETHER), value=torch.inf).view(-1, TOGETHER) for each in (x, y))
        place, least, most = torch.arange(x.numel()).view_as(x), x.amin(1), x.amax(1)

        def on(spot: SpotParams) -> Tensor:
            reach_m = math.hypot(spot.length_m, spot.width_m) / 2 + SPARE_M
            near = torch.nonzero((least <= spot.x_m + reach_m) & (most >= spot.x_m - reach_m))[:, 0]
            return place[near][spot.covers(x[near], y[near])]

        return tuple(map(on, self.spots))

    def _material(self, spot: SpotParams) -> Material:
        return MATERIALS[spot.material] if spot.material else self.surface.ground
