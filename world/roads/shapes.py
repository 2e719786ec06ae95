"""Roads for scenarios, as heights over the plane z = 0 that the vehicle stands on (see `Road`): parametric, random, user-defined."""

from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Annotated, Literal, Self, cast

import numpy as np
import scipy  # loads its parts on first use
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.params import Length, Metres, Params, Seed
from luxloop.world.plugin import KnownOrOwn
from luxloop.world.roads.base import Floats, MeshGrid, Road, RoadModel, ahead, smoothstep, together
from luxloop.world.roads.scan import OpenCrgRoad

REFERENCE_FREQUENCY = 0.1  # n0, cycles/m
GEOMETRIC_MEAN_M3 = {"A": 16e-6, "B": 64e-6, "C": 256e-6, "D": 1024e-6, "E": 4096e-6}  # Gd(n0)
BAND = (0.011, 2.83)  # cycles/m, where the standard states limits
# Waves go on beyond the band: a section near the cut would miss those that cross it at an angle (12 % of the density at 2.83).
_CUT = 6.0
_SPLIT = 0.5
_SAMPLES = 1024
_COS, _SIN = np.cos(0.5), np.sin(0.5)


def roughness(roughness_class: str, seed: int, x: ArrayLike, y: ArrayLike) -> Floats:
    """Height in m of a random surface whose every straight section has the density of its class.

    Long waves come from a tile of 256 m, short ones from a tile of 32 m, both repeated, but at an angle at which no wheel track repeats.
    """
    along, across = together(x, y)
    coordinates = np.stack([(_COS * along - _SIN * across).ravel(), (_SIN * along + _COS * across).ravel()])
    unit = np.zeros(along.size)
    for coefficients, spacing in _tiles(seed):
        unit += scipy.ndimage.map_coordinates(coefficients, coordinates / spacing, order=3, mode="grid-wrap", prefilter=False)
    return np.sqrt(GEOMETRIC_MEAN_M3[roughness_class] * REFERENCE_FREQUENCY**2) * unit.reshape(along.shape)


@lru_cache(maxsize=4)
def _tiles(seed: int) -> tuple[tuple[Floats, float], ...]:
    generator = np.random.default_rng(seed)
    return tuple((_tile(generator, spacing, band), spacing) for spacing, band in ((1 / 4, (BAND[0], _SPLIT)), (1 / 32, (_SPLIT, _CUT))))


def _tile(generator: np.random.Generator, spacing: float, band: tuple[float, float]) -> Floats:
    """Cubic spline coefficients `[n, n]` of white noise filtered so that sections have Gd(n) = n^-2 in the band."""
    k = np.hypot(np.fft.fftfreq(_SAMPLES, spacing)[:, None], np.fft.rfftfreq(_SAMPLES, spacing))
    inside = (k >= band[0]) & (k < band[1])
    # A two-dimensional density k^-3 / 4 integrates across a section to n^-2 / 2, two-sided; white noise has spacing^2.
    gain = np.where(inside, 0.5 / spacing * np.where(inside, k, 1.0) ** -1.5, 0.0)
    white = generator.standard_normal((_SAMPLES, _SAMPLES))
    surface = np.fft.irfft2(np.fft.rfft2(white) * gain, s=white.shape)
    return np.asarray(scipy.ndimage.spline_filter(surface, order=3, mode="grid-wrap"), np.float64)


class OwnRoad(plugin.OwnPart, RoadModel):
    """`Name(**options)` of a user's module makes the road, a `Road`."""

    @cached_property
    def road(self) -> Road:
        """The road itself. Raises LuxloopError if it does not exist, refuses its options or lacks a method."""
        return cast(Road, plugin.make(self.kind, "road.kind", {}, self.options, ("z", "grid")))

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Heights in m. Raises LuxloopError unless they are finite numbers, one for each place."""
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
        """Its mesh grid. Raises LuxloopError if it has none."""
        grid = self.road.grid()
        if not isinstance(grid, MeshGrid):
            raise LuxloopError(f"road.kind: {self.kind}: grid gives {type(grid).__name__}; give a world.roads.base.MeshGrid")
        return grid


RoughnessClass = Literal["A", "B", "C", "D", "E"]


class Shape(RoadModel):
    """Base of the roads of this file; subclasses compute heights in m for x and y of one shape."""

    def heights(self, x: Floats, y: Floats) -> Floats:
        raise NotImplementedError

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        return self.heights(*together(x, y))


class Flat(Shape):
    """The assumed road itself: z = 0."""

    kind: Literal["flat"] = "flat"

    def heights(self, x: Floats, y: Floats) -> Floats:
        return np.zeros_like(x)

    def grid(self) -> MeshGrid:
        return MeshGrid(spacing_m=(0.5, 0.5))  # a plane needs no more


class Grade(Shape):
    """A change of grade and crossfall ahead; a constant slope under the vehicle would not be visible from it."""

    kind: Literal["grade"] = "grade"
    grade_percent: float = Field(1.5, ge=-20.0, le=20.0, description="grade ahead of start_x_m, uphill positive")
    crossfall_percent: float = Field(2.0, ge=-10.0, le=10.0, description="crossfall about the vehicle's centre line, rising to the left")
    start_x_m: Metres = Field(13.0, description="start of the vertical curve to the grade")
    curve_m: Length = Field(4.0, description="length of that vertical curve")

    def heights(self, x: Floats, y: Floats) -> Floats:
        rise = _rise(x - self.start_x_m, self.curve_m)
        return self.grade_percent / 100 * rise + self.crossfall_percent / 100 * y * ahead(x)


def _rise(beyond: Floats, curve_m: float) -> Floats:
    """Height at a distance beyond the start of a parabolic vertical curve from level to a grade of 1."""
    beyond = np.maximum(beyond, 0.0)
    curved = np.minimum(beyond, curve_m)
    return curved**2 / (2 * curve_m) + (beyond - curved)


class GradeParams(Params):
    """A grade of a profile."""

    x_m: float = Field(ge=0.0, le=100_000, examples=[20.0], description="start of the vertical curve to this grade")
    percent: float = Field(ge=-20.0, le=20.0, examples=[5.0], description="grade beyond the curve, uphill positive")
    curve_m: Length = Field(40.0, description="length of the parabolic vertical curve")


class Profile(Shape):
    """A road with hills: grades joined by vertical curves, level up to the first; roughness from 6 m ahead on."""

    kind: Literal["profile"] = "profile"
    grades: tuple[GradeParams, ...] = Field(
        min_length=1, examples=[[{"x_m": 20.0, "percent": 5.0}]], description="grades in ascending x_m; their curves must not overlap"
    )
    roughness_class: RoughnessClass | None = Field(None, description="ISO 8608 class of added roughness; left out: none")
    seed: Seed = Field(1, description="seed of the roughness")

    @model_validator(mode="after")
    def _one_after_the_other(self) -> Self:
        for before, after in pairwise(self.grades):
            if after.x_m < before.x_m + before.curve_m:
                raise ValueError(f"grades: the curve at {after.x_m:g} m begins before that at {before.x_m:g} m ends; give a greater x_m")
        return self

    def heights(self, x: Floats, y: Floats) -> Floats:
        found = np.zeros_like(x) if self.roughness_class is None else ahead(x) * roughness(self.roughness_class, self.seed, x, y)
        percent = 0.0
        for each in self.grades:
            found = found + (each.percent - percent) / 100 * _rise(x - each.x_m, each.curve_m)
            percent = each.percent
        return found


class Bumps(Shape):
    """Smooth random bumps and hollows, some metres long."""

    kind: Literal["bumps"] = "bumps"
    lowest_m: float = Field(-0.02, ge=-0.5, le=0.0, description="lowest height in the symbol's area (x 12 to 22 m, y -2 to 2 m)")
    highest_m: float = Field(0.05, ge=0.0, le=0.5, description="highest height in that area")
    seed: Seed = Field(1, description="seed of the bumps")

    def heights(self, x: Floats, y: Floats) -> Floats:
        waves, low, high = _bumps(self.seed)
        share = (_sum_of_waves(waves, x, y) - low) / (high - low)
        # Beyond the symbol the sum may leave its range: it saturates smoothly within a quarter of the range.
        share = 0.5 + 0.75 * np.tanh(np.arctanh(2 / 3) * (2 * share - 1))
        return ahead(x) * (self.lowest_m + (self.highest_m - self.lowest_m) * share)


@lru_cache(maxsize=8)
def _bumps(seed: int) -> tuple[Floats, float, float]:
    """Plane waves `[16, 3]` (k_x, k_y in rad/m, phase) and the least and greatest of their sum around the symbol."""
    generator = np.random.default_rng(seed)
    length, heading, phase = generator.uniform([[4.0], [0.0], [0.0]], [[9.0], [2 * np.pi], [2 * np.pi]], (3, 16))
    k = 2 * np.pi / length
    waves = np.stack([k * np.cos(heading), k * np.sin(heading), phase], axis=1)
    heights = _sum_of_waves(waves, *np.meshgrid(np.linspace(12.0, 22.0, 101), np.linspace(-2.0, 2.0, 41)))
    return waves, float(heights.min()), float(heights.max())


def _sum_of_waves(waves: Floats, x: Floats, y: Floats) -> Floats:
    return np.sum([np.cos(k_x * x + k_y * y + phase) for k_x, k_y, phase in waves], axis=0, dtype=np.float64)


class SpeedBump(Shape):
    """A bump across the whole road, cosine-shaped along it."""

    kind: Literal["speed_bump"] = "speed_bump"
    x_m: float = Field(17.0, ge=3.0, le=10_000, description="distance of its centre")
    height_m: float = Field(0.08, gt=0.0, le=0.5, description="height at its centre")
    length_m: float = Field(1.0, gt=0.1, le=10.0, description="length along the road")

    def heights(self, x: Floats, y: Floats) -> Floats:
        along = np.clip((x - self.x_m) / self.length_m, -0.5, 0.5)
        return self.height_m * 0.5 * (1 + np.cos(2 * np.pi * along))


class Curb(Shape):
    """A kerb along the left of the road, from 6 m ahead on."""

    kind: Literal["curb"] = "curb"
    y_m: Metres = Field(0.5, description="lateral position of the step, left positive; at 0.5 m a symbol 2 m wide straddles it")
    height_m: float = Field(0.10, ge=-0.5, le=0.5, description="height of the kerb; negative: a road edge that drops")
    ramp_m: float = Field(0.03, gt=0.0, le=1.0, description="width of the step's face, since a height field has no vertical faces")

    def heights(self, x: Floats, y: Floats) -> Floats:
        return self.height_m * ahead(x) * np.clip((y - self.y_m) / self.ramp_m + 0.5, 0.0, 1.0)

    def grid(self) -> MeshGrid:
        return MeshGrid(y_lines_m=(self.y_m - self.ramp_m / 2, self.y_m + self.ramp_m / 2))


class Step(Shape):
    """A step across the whole road, level beyond: a raised or a lowered area."""

    kind: Literal["step"] = "step"
    x_m: float = Field(12.0, ge=3.0, le=10_000, description="distance of the centre of its face")
    height_m: float = Field(0.2, ge=-0.5, le=0.5, description="height of the road beyond the step; negative: it drops")
    ramp_m: float = Field(0.5, gt=0.0, le=5.0, description="length of the step's face along the road")

    def heights(self, x: Floats, y: Floats) -> Floats:
        return self.height_m * np.clip((x - self.x_m) / self.ramp_m + 0.5, 0.0, 1.0)

    def grid(self) -> MeshGrid:
        return MeshGrid(x_lines_m=(self.x_m - self.ramp_m / 2, self.x_m + self.ramp_m / 2))


class Pothole(Shape):
    """A round hole with a flat bottom and soft edges."""

    kind: Literal["pothole"] = "pothole"
    x_m: float = Field(17.0, ge=3.0, le=10_000, description="distance of its centre")
    y_m: Metres = Field(0.3, description="lateral position of its centre, left positive")
    diameter_m: float = Field(0.9, gt=0.1, le=3.0, description="diameter at the road surface")
    depth_m: float = Field(0.06, gt=0.0, le=0.5, description="depth")
    edge_m: Length = Field(0.15, description="width of the edge")

    def heights(self, x: Floats, y: Floats) -> Floats:
        inside = self.diameter_m / 2 - np.hypot(x - self.x_m, y - self.y_m)
        return -self.depth_m * smoothstep(inside, 0.0, self.edge_m)


class Iso8608(Shape):
    """Random roughness of an ISO 8608 class, from 6 m ahead on."""

    kind: Literal["iso8608"] = "iso8608"
    roughness_class: RoughnessClass = Field("B", description="A (very good) to E (very poor)")
    seed: Seed = Field(1, description="seed of the surface")

    def heights(self, x: Floats, y: Floats) -> Floats:
        return ahead(x) * roughness(self.roughness_class, self.seed, x, y)


_TABLE_M, _TABLE_RAMP_M = 6.0, 1.0  # length of a speed table with, and of one of, its ramps


class Mixed(Shape):
    """A residential road: slight grade and crossfall, bumps, roughness, kerbs on both sides and a speed table ahead."""

    kind: Literal["mixed"] = "mixed"
    grade_percent: float = Field(1.2, ge=-5.0, le=5.0, description="grade from 13 m on, uphill positive")
    crossfall_percent: float = Field(2.5, ge=-5.0, le=5.0, description="crossfall, rising to the left")
    bumps_m: tuple[Annotated[float, Field(ge=-0.5, le=0)], Annotated[float, Field(ge=0, le=0.5)]] = Field(
        (-0.015, 0.025), description="lowest and highest height of the smooth bumps around the symbol"
    )
    roughness_class: RoughnessClass = Field("B", description="ISO 8608 class of added roughness")
    curb_y_m: float = Field(4.0, gt=1.5, le=10_000, description="distance of the kerbs on both sides")
    curb_height_m: float = Field(0.10, ge=0.0, le=0.3, description="height of the kerbs")
    table_x_m: float = Field(45.0, ge=25.0, le=10_000, description="start of the speed table")
    table_height_m: float = Field(0.08, ge=0.0, le=0.3, description="height of the speed table")
    seed: Seed = Field(12, description="seed of bumps and roughness; the default keeps the symbol within the lamp's field")

    def _curb(self) -> Curb:
        return Curb(y_m=self.curb_y_m, height_m=self.curb_height_m)

    def heights(self, x: Floats, y: Floats) -> Floats:
        start, end = self.table_x_m, self.table_x_m + _TABLE_M
        table = smoothstep(x, start, start + _TABLE_RAMP_M) - smoothstep(x, end - _TABLE_RAMP_M, end)
        return (
            Grade(grade_percent=self.grade_percent, crossfall_percent=self.crossfall_percent).z(x, y)
            + Bumps(lowest_m=self.bumps_m[0], highest_m=self.bumps_m[1], seed=self.seed).z(x, y)
            + Iso8608(roughness_class=self.roughness_class, seed=self.seed).z(x, y)
            + self.table_height_m * table
            + self._curb().z(x, np.abs(y))
        )

    def grid(self) -> MeshGrid:
        lines, start = self._curb().grid().y_lines_m, self.table_x_m
        ramps = np.linspace(start, start + _TABLE_RAMP_M, 9), np.linspace(start + _TABLE_M - _TABLE_RAMP_M, start + _TABLE_M, 9)
        return MeshGrid(x_lines_m=tuple(np.concatenate(ramps).tolist()), y_lines_m=(*lines, *(-y for y in lines)))


RoadParams = Annotated[
    Flat | Grade | Bumps | SpeedBump | Curb | Step | Pothole | Iso8608 | Mixed | Profile | OpenCrgRoad | OwnRoad,
    KnownOrOwn("kind"),
]
