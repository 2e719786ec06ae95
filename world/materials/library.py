"""Named materials, textures of albedo and material, random asphalt and spots on it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor
from torch.nn.functional import pad

from luxloop.world.caches import keeping
from luxloop.world.materials.brdf import LAMBERTIAN, Material
from luxloop.world.params import Degrees, Metres, Params, PositiveShare, Seed, Share

MaterialName = Literal[
    "matt",
    "asphalt",
    "wet_asphalt",
    "lane_paint",
    "retroreflective_sign",
    "reflective_band",
    "skin",
    "hair",
    "cloth",
    "fur",
    "leaves",
    "bark",
    "rubber",
    "car_paint",
    "glass",
    "metal",
    "headlamp",
    "tail_lamp",
]

# A film of water of refractive index 1.33 throws back 1 - (1 - 0.066) / 1.33^2 of the diffuse light below it.
WET = Material(interface=1.0, f0=0.02, roughness=0.12, trapped=0.47)
MATERIALS: dict[MaterialName, Material] = {
    "matt": LAMBERTIAN,
    "asphalt": Material(interface=1.0, f0=0.04, roughness=0.6),
    "wet_asphalt": WET,
    # R_L 204 mcd/(m^2 lx) in the geometry of EN 1436 with an albedo of 0.6
    "lane_paint": Material(retro=0.004, retro_width_deg=3.0),
    # R_A 72, 65 and 5 cd/(lx m^2) at 0.2, 0.33 and 2 deg, as sheets of class RA1 of EN 12899-1 have at least 70, 50 and 5
    "retroreflective_sign": Material(retro=0.105, retro_width_deg=1.2),
    # R_A 331 cd/(lx m^2) at 0.2 deg, as bands of EN ISO 20471 have at least 330
    "reflective_band": Material(retro=0.48, retro_width_deg=1.2),
    **{name: LAMBERTIAN for name in ("skin", "hair", "cloth", "fur", "leaves", "bark", "rubber")},
    "car_paint": Material(interface=1.0, f0=0.04, roughness=0.1),
    "glass": Material(interface=1.0, f0=0.08, roughness=0.03),
    "metal": Material(interface=1.0, f0=0.5, roughness=0.35),
    "headlamp": Material(luminance_cd_m2=3e4),
    "tail_lamp": Material(luminance_cd_m2=600.0),
}


@dataclass(frozen=True, eq=False)
class Texture:
    """Albedo and material over a body's x and y, repeated endlessly.

    albedo: `[n_x, n_y]` float32; texel (i, j) has its centre at `origin_m + ((i, j) + 1/2) * texel_m`.
    materials: those of the surface, and their names. material: `[n_x, n_y]` uint8, which of them a texel is made of; None: of the first.
    shifts: `[n]` float64, whole texels by which the repetitions along x, counted from the origin modulo n, are shifted along y; None: none.
    """

    albedo: Tensor
    texel_m: float
    origin_m: tuple[float, float] = (0.0, 0.0)
    materials: tuple[Material, ...] = (LAMBERTIAN,)
    material: Tensor | None = None
    names: tuple[MaterialName, ...] = ("matt",)
    shifts: Tensor | None = None

    def at(self, x: Tensor, y: Tensor) -> Tensor:
        """Albedo, bilinear, float32 in the shape of x and y (m, body frame)."""
        n_x, n_y = self.albedo.shape
        i, j = (x - self.origin_m[0]) / self.texel_m - 0.5, (y - self.origin_m[1]) / self.texel_m - 0.5
        i0, j0 = i.floor(), j.floor()
        fi, fj = (i - i0).float(), (j - j0).float()
        if self.shifts is not None:
            tile = (i0 / n_x).floor().remainder(len(self.shifts)).int()
            j0 = j0 + self.shifts.to(j0).index_select(0, tile.flatten()).view_as(j0)
        # One index in 32 bits and a remainder in floating point take a fifth of the time of two indices in 64.
        i0, j0 = i0.remainder(n_x).int() * n_y, j0.remainder(n_y).int()
        i1, j1 = torch.where(i0 == (n_x - 1) * n_y, 0, i0 + n_y), torch.where(j0 == n_y - 1, 0, j0 + 1)
        a, b, c, d = (self.albedo.flatten().index_select(0, (i + j).flatten()).view_as(fi) for i in (i0, i1) for j in (j0, j1))
        return torch.lerp(torch.lerp(a, b, fj), torch.lerp(c, d, fj), fi)

    def material_at(self, x: Tensor, y: Tensor) -> Tensor:
        """Index of the material at x and y (m, body frame), int64 in their shape."""
        if self.material is None:
            return torch.zeros_like(x, dtype=torch.int64)
        n_x, n_y = self.material.shape
        i, j = ((at - start) / self.texel_m for at, start in zip((x, y), self.origin_m, strict=True))
        return self.material[i.floor().long() % n_x, j.floor().long() % n_y].long()


TILES = 64  # of 36 m, after which their shifts repeat


class RoadSurfaceParams(Params):
    """Asphalt: grain, mottling, repair patches and lane markings."""

    albedo: PositiveShare = Field(0.2, description="mean albedo of the dry asphalt without markings")
    grain: float = Field(0.12, ge=0, le=0.5, description="standard deviation of the asphalt's albedo, relative to its mean; 0: uniform")
    patches: int = Field(3, ge=0, le=50, description="repair patches per 36 m of road")
    markings: bool = Field(False, description="paint a solid line on the right of the lane and a broken line on its left")
    beads: bool = Field(False, description="glass beads make the markings retroreflective")
    wet: Share = Field(0.0, description="share of the road under a film of water: darker, glossy, beads without effect")
    lane_width_m: float = Field(3.5, gt=1, le=10, description="distance between the two lines; the lane's centre is y = 0")
    seed: Seed = Field(0, description="seed of grain and patches")

    @property
    def ground(self) -> Material:
        """Material of the asphalt."""
        return replace(WET, interface=self.wet) if self.wet else LAMBERTIAN

    @property
    def seen_albedo(self) -> float:
        """Mean albedo of the asphalt in its current state, wet or dry, without markings."""
        return float(self.ground.darken(torch.tensor(self.albedo, dtype=torch.float64)))

    def texture(self, long: bool = False) -> Texture:
        """A tile of 36 x 18 m, or 36 x 54 m with markings, 2 cm a texel, centred on y = 0, whose opposite edges match.

        long: for a drive. Repetitions of a tile without markings are then shifted to the side at random, except the first.
        """
        texel_m, n_x, n_y = 0.02, 1800, 900
        rng = np.random.default_rng(self.seed)
        relative = 1.0 + self.grain * _grain(rng, n_x, n_y) * (self.grain > 0)
        for _ in range(self.patches if self.grain > 0 else 0):
            i, j = int(rng.integers(n_x)), int(rng.integers(n_y))
            length, width = (int(n) for n in rng.integers((40, 25), (250, 100)))
            rows, columns = np.ix_(np.arange(i, i + length) % n_x, np.arange(j, j + width) % n_y)
            relative[rows, columns] = 1.0 + rng.uniform(-0.3, -0.1) + 0.6 * (relative[rows, columns] - 1.0)
        relative = relative.clip(0.3, None)
        albedo = (self.albedo * relative / relative.mean()).clip(0, 1)
        painted = np.zeros_like(albedo, bool)
        if self.markings:
            albedo = np.tile(albedo, (1, 3))  # wider than the scene, so that the lines are there once
            n_y *= 3
            x = (np.arange(n_x) + 0.5) * texel_m
            y = (np.arange(n_y) + 0.5 - n_y / 2) * texel_m
            solid = np.abs(y + self.lane_width_m / 2) < 0.06
            broken = (np.abs(y - self.lane_width_m / 2) < 0.06)[None] & ((x % 9) < 3)[:, None]
            painted = solid[None] | broken
            albedo = np.where(painted, (0.6 + albedo - self.albedo).clip(0, 1), albedo)
        seen = self.ground.darken(torch.from_numpy(albedo.astype(np.float32)))
        origin_m = (0.0, -n_y * texel_m / 2)
        if not self.markings:
            shifts = torch.from_numpy(np.r_[0, rng.integers(n_y, size=TILES - 1)].astype(float)) if long else None
            return Texture(seen, texel_m, origin_m, (self.ground,), names=(self.ground_name,), shifts=shifts)
        of_texel = torch.from_numpy(painted.astype(np.uint8))
        return Texture(seen, texel_m, origin_m, (self.ground, self._paint), of_texel, (self.ground_name, "lane_paint"))

    @property
    def ground_name(self) -> MaterialName:
        return "wet_asphalt" if self.wet else "asphalt"

    @property
    def _paint(self) -> Material:
        """Material of the lane markings."""
        if not self.beads:
            return self.ground
        paint = MATERIALS["lane_paint"]
        return replace(self.ground, retro=paint.retro * (1 - self.wet), retro_width_deg=paint.retro_width_deg)


def _grain(rng: np.random.Generator, n_x: int, n_y: int) -> np.ndarray:
    """Periodic noise of mean 0 and variance 1: grain of single stones and mottling up to a metre."""
    frequency = np.hypot(np.fft.fftfreq(n_x)[:, None], np.fft.rfftfreq(n_y)[None])
    # an amplitude of f^-0.6 looks like asphalt, f^0 like television, f^-1 like clouds; 0.02 cycles a texel are one in a metre
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((n_x, n_y))) * np.maximum(frequency, 0.02) ** -0.6, (n_x, n_y))
    noise -= noise.mean()
    return noise / noise.std()


SPARE_M = 0.01  # margin around a spot for float32 rounding some hundred metres ahead
TOGETHER = 64  # neighbouring points


class SpotParams(Params):
    """A region of the road with a different albedo or material; where spots overlap, the last one is on top."""

    shape: Literal["ellipse", "rectangle"] = Field("ellipse", description="outline")
    x_m: Metres = Field(examples=[17.0], description="centre ahead in the world")
    y_m: Metres = Field(0.0, description="centre to the left")
    length_m: float = Field(1.0, gt=0, le=200, description="extent along x before rotation")
    width_m: float = Field(1.0, gt=0, le=200, description="extent along y before rotation")
    yaw_deg: Degrees = Field(0.0, description="rotation to the left")
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
    """A road's texture, made on first use, with spots on it; the texture repeats, the spots do not. long: as of `surface.texture`."""

    surface: RoadSurfaceParams
    spots: tuple[SpotParams, ...]
    long: bool = False

    @cached_property
    def _around(self) -> Texture:
        return self.surface.texture(self.long)

    @cached_property
    def _dry(self) -> Texture:
        return self.surface.model_copy(update={"wet": 0.0}).texture(self.long) if self.surface.wet else self._around

    @cached_property
    def materials(self) -> tuple[Material, ...]:
        """Those of the road, then one a spot."""
        return (*self._around.materials, *map(self._material, self.spots))

    @property
    def names(self) -> tuple[MaterialName, ...]:
        """Names of the materials; a spot without one has that of its surroundings."""
        return (*self._around.names, *(spot.material or self.surface.ground_name for spot in self.spots))

    def at(self, x: Tensor, y: Tensor) -> Tensor:
        """Albedo, float32 in the shape of x and y (m, body frame)."""
        shape, x, y = x.shape, x.flatten(), y.flatten()
        albedo = self._around.at(x, y)
        for spot, there in zip(self.spots, self._covers(x, y), strict=True):
            dry = self._dry.at(x[there], y[there]) * spot.albedo_factor
            albedo[there] = self._material(spot).darken(dry.clamp(max=1))
        return albedo.view(shape)

    def material_at(self, x: Tensor, y: Tensor) -> Tensor:
        """Index of the material at x and y (m, body frame), int64 in their shape."""
        shape, x, y = x.shape, x.flatten(), y.flatten()
        number = self._around.material_at(x, y)
        for k, (spot, there) in enumerate(zip(self.spots, self._covers(x, y), strict=True), len(self._around.materials)):
            if spot.material is not None:
                number[there] = k
        return number.view(shape)

    @cached_property
    def _covers(self) -> Callable[[Tensor, Tensor], tuple[Tensor, ...]]:
        return keeping(1, self._covered_of) if self.spots else lambda x, y: ()  # for albedo and material of the same points

    def _covered_of(self, x: Tensor, y: Tensor) -> tuple[Tensor, ...]:
        """Indices of the points (x, y) `[N]` on each spot."""
        x, y = (pad(each, (0, -len(each) % TOGETHER), value=torch.inf).view(-1, TOGETHER) for each in (x, y))
        place, least, most = torch.arange(x.numel()).view_as(x), x.amin(1), x.amax(1)

        def on(spot: SpotParams) -> Tensor:
            reach_m = math.hypot(spot.length_m, spot.width_m) / 2 + SPARE_M
            near = torch.nonzero((least <= spot.x_m + reach_m) & (most >= spot.x_m - reach_m))[:, 0]
            return place[near][spot.covers(x[near], y[near])]

        return tuple(map(on, self.spots))

    def _material(self, spot: SpotParams) -> Material:
        return MATERIALS[spot.material] if spot.material else self.surface.ground
