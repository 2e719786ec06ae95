"""Parametric roads for scenarios, as heights over the plane z = 0 that the vehicle stands on (see `Road`)."""

from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, Tag, field_validator, model_validator

from luxloop.world.params import Metres, Params
from luxloop.world.plugin import OWN, known_or_own
from luxloop.world.roads.base import Floats, MeshGrid, Road, RoadModel, ahead, smoothstep
from luxloop.world.roads.iso8608 import roughness
from luxloop.world.roads.own import OwnRoad
from luxloop.world.roads.scan import OpenCrgRoad

__all__ = [
    "Bumps",
    "Curb",
    "Flat",
    "Grade",
    "Iso8608",
    "MeshGrid",
    "Mixed",
    "OpenCrgRoad",
    "OwnRoad",
    "Pothole",
    "Profile",
    "Road",
    "RoadParams",
    "SpeedBump",
    "Step",
]

RoughnessClass = Literal["A", "B", "C", "D", "E"]


def _plane(x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    along, across = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    return along, across


class Flat(RoadModel):
    """The assumed road itself: z = 0."""

    kind: Literal["flat"] = "flat"

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        return np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))

    def grid(self) -> MeshGrid:
        return MeshGrid(spacing_m=(0.5, 0.5))  # a plane needs no more


class Grade(RoadModel):
    """A change of grade and crossfall ahead; a constant slope under the vehicle would not be visible from it."""

    kind: Literal["grade"] = "grade"
    grade_percent: float = Field(default=1.5, ge=-20.0, le=20.0, description="grade ahead of start_x_m, uphill positive")
    crossfall_percent: float = Field(
        default=2.0, ge=-10.0, le=10.0, description="crossfall about the vehicle's centre line, rising to the left"
    )
    start_x_m: float = Field(default=13.0, ge=-10_000, le=10_000, description="start of the vertical curve to the grade")
    curve_m: float = Field(default=4.0, gt=0.0, le=10_000, description="length of that vertical curve")

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        x, y = _plane(x, y)
        rise = _rise(x - self.start_x_m, self.curve_m)
        return self.grade_percent / 100 * rise + self.crossfall_percent / 100 * y * ahead(x)


def _rise(beyond: Floats, curve_m: float) -> Floats:
    """Height of a road so far beyond the beginning of a parabolic vertical curve from level to a grade of 1."""
    beyond = np.maximum(beyond, 0.0)
    curved = np.minimum(beyond, curve_m)
    return curved**2 / (2 * curve_m) + (beyond - curved)


class GradeParams(Params):
    """A grade of a profile."""

    x_m: float = Field(ge=0.0, le=100_000, examples=[20.0], description="start of the vertical curve to this grade")
    percent: float = Field(ge=-20.0, le=20.0, examples=[5.0], description="grade beyond the curve, uphill positive")
    curve_m: float = Field(default=40.0, gt=0.0, le=10_000, description="length of the parabolic vertical curve")


class Profile(RoadModel):
    """A road with hills: grades joined by vertical curves, level up to the first; roughness from 6 m ahead on."""

    kind: Literal["profile"] = "profile"
    grades: tuple[GradeParams, ...] = Field(
        min_length=1, examples=[[{"x_m": 20.0, "percent": 5.0}]], description="grades in ascending x_m; their curves must not overlap"
    )
    roughness_class: RoughnessClass | None = Field(default=None, description="ISO 8608 class of added roughness; left out: none")
    seed: int = Field(default=1, ge=0, lt=2**63, description="seed of the roughness")

    @model_validator(mode="after")
    def _one_after_the_other(self) -> Self:
        for before, after in pairwise(self.grades):
            if after.x_m < before.x_m + before.curve_m:
                raise ValueError(f"grades: the curve at {after.x_m:g} m begins before that at {before.x_m:g} m ends; give a greater x_m")
        return self

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        x, y = _plane(x, y)
        found = np.zeros_like(x) if self.roughness_class is None else ahead(x) * roughness(self.roughness_class, self.seed, x, y)
        percent = 0.0
        for each in self.grades:
            found = found + (each.percent - percent) / 100 * _rise(x - each.x_m, each.curve_m)
            percent = each.percent
        return found


class Bumps(RoadModel):
    """Smooth random bumps and hollows, some metres long."""

    kind: Literal["bumps"] = "bumps"
    lowest_m: float = Field(default=-0.02, ge=-0.5, le=0.0, description="lowest height in the symbol's area (x 12 to 22 m, y -2 to 2 m)")
    highest_m: float = Field(default=0.05, ge=0.0, le=0.5, description="highest height in that area")
    seed: int = Field(default=1, ge=0, lt=2**63, description="seed of the bumps")

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        x, y = _plane(x, y)
        waves, low, high = _bumps(self.seed)
        share = (_sum_of_waves(waves, x, y) - low) / (high - low)
        # Beyond the symbol the sum may leave its range there: it then saturates smoothly, a quarter of it further out.
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


class SpeedBump(RoadModel):
    """A bump across the whole road, cosine-shaped along it."""

    kind: Literal["speed_bump"] = "speed_bump"
    x_m: float = Field(default=17.0, ge=3.0, le=10_000, description="distance of its centre")
    height_m: float = Field(default=0.08, gt=0.0, le=0.5, description="height at its centre")
    length_m: float = Field(default=1.0, gt=0.1, le=10.0, description="length along the road")

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        x, _ = _plane(x, y)
        along = np.clip((x - self.x_m) / self.length_m, -0.5, 0.5)
        return self.height_m * 0.5 * (1 + np.cos(2 * np.pi * along))


class Curb(RoadModel):
    """A kerb along the left of the road, from 6 m ahead on."""

    kind: Literal["curb"] = "curb"
    y_m: float = Field(
        default=0.5,
        ge=-10_000,
        le=10_000,
        description="lateral position of the step, left positive; at 0.5 m a symbol 2 m wide straddles it",
    )
    height_m: float = Field(default=0.10, ge=-0.5, le=0.5, description="height of the kerb; negative: a road edge that drops")
    ramp_m: float = Field(default=0.03, gt=0.0, le=1.0, description="width of the step's face, since a height field has no vertical faces")

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        x, y = _plane(x, y)
        return self.height_m * ahead(x) * np.clip((y - self.y_m) / self.ramp_m + 0.5, 0.0, 1.0)

    def grid(self) -> MeshGrid:
        return MeshGrid(y_lines_m=(self.y_m - self.ramp_m / 2, self.y_m + self.ramp_m / 2))


class Step(RoadModel):
    """A step across the whole road, level beyond: a raised or a lowered area."""

    kind: Literal["step"] = "step"
    x_m: float = Field(default=12.0, ge=3.0, le=10_000, description="distance of the centre of its face")
    height_m: float = Field(default=0.2, ge=-0.5, le=0.5, description="height of the road beyond the step; negative: it drops")
    ramp_m: float = Field(default=0.5, gt=0.0, le=5.0, description="length of the step's face along the road")

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        x, _ = _plane(x, y)
        return self.height_m * np.clip((x - self.x_m) / self.ramp_m + 0.5, 0.0, 1.0)

    def grid(self) -> MeshGrid:
        return MeshGrid(x_lines_m=(self.x_m - self.ramp_m / 2, self.x_m + self.ramp_m / 2))


class Pothole(RoadModel):
    """A round hole with a flat bottom and soft edges."""

    kind: Literal["pothole"] = "pothole"
    x_m: float = Field(default=17.0, ge=3.0, le=10_000, description="distance of its centre")
    y_m: float = Field(default=0.3, ge=-10_000, le=10_000, description="lateral position of its centre, left positive")
    diameter_m: float = Field(default=0.9, gt=0.1, le=3.0, description="diameter at the road surface")
    depth_m: float = Field(default=0.06, gt=0.0, le=0.5, description="depth")
    edge_m: float = Field(default=0.15, gt=0.0, le=10_000, description="width of the edge")

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        x, y = _plane(x, y)
        inside = self.diameter_m / 2 - np.hypot(x - self.x_m, y - self.y_m)
        return -self.depth_m * smoothstep(inside, 0.0, self.edge_m)


class Iso8608(RoadModel):
    """Random roughness of an ISO 8608 class, from 6 m ahead on."""

    kind: Literal["iso8608"] = "iso8608"
    roughness_class: RoughnessClass = Field(default="B", description="A (very good) to E (very poor)")
    seed: int = Field(default=1, ge=0, lt=2**63, description="seed of the surface")

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        return ahead(x) * roughness(self.roughness_class, self.seed, x, y)


_TABLE_M, _TABLE_RAMP_M = 6.0, 1.0  # length of a speed table with, and of one of, its ramps


class Mixed(RoadModel):
    """A residential road: slight grade and crossfall, bumps, roughness, kerbs on both sides and a speed table ahead."""

    kind: Literal["mixed"] = "mixed"
    grade_percent: float = Field(default=1.2, ge=-5.0, le=5.0, description="grade from 13 m on, uphill positive")
    crossfall_percent: float = Field(default=2.5, ge=-5.0, le=5.0, description="crossfall, rising to the left")
    bumps_m: tuple[Metres, Metres] = Field(
        default=(-0.015, 0.025), description="lowest and highest height of the smooth bumps around the symbol"
    )
    roughness_class: RoughnessClass = Field(default="B", description="ISO 8608 class of added roughness")
    curb_y_m: float = Field(default=4.0, gt=1.5, le=10_000, description="distance of the kerbs on both sides")
    curb_height_m: float = Field(default=0.10, ge=0.0, le=0.3, description="height of the kerbs")
    table_x_m: float = Field(default=45.0, ge=25.0, le=10_000, description="start of the speed table")
    table_height_m: float = Field(default=0.08, ge=0.0, le=0.3, description="height of the speed table")
    seed: int = Field(
        default=12, ge=0, lt=2**63, description="seed of bumps and roughness; the default keeps the symbol within the lamp's field"
    )

    @field_validator("bumps_m")
    @classmethod
    def _around_zero(cls, bumps_m: tuple[float, float]) -> tuple[float, float]:
        lowest, highest = bumps_m
        if not -0.5 <= lowest <= 0 <= highest <= 0.5:
            raise ValueError(
                f"[{lowest}, {highest}] is not a range of heights about zero; give [lowest, highest], as [-0.015, 0.025], at most 0.5"
            )
        return bumps_m

    def _curb(self) -> Curb:
        return Curb(y_m=self.curb_y_m, height_m=self.curb_height_m)

    def _table_lines(self) -> tuple[float, ...]:
        start, end = self.table_x_m, self.table_x_m + _TABLE_M
        return tuple(float(x) for edge in (start, end - _TABLE_RAMP_M) for x in np.linspace(edge, edge + _TABLE_RAMP_M, 9))

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        x, y = _plane(x, y)
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
        lines = self._curb().grid().y_lines_m
        return MeshGrid(x_lines_m=self._table_lines(), y_lines_m=(*lines, *(-y for y in lines)))


RoadParams = Annotated[
    Annotated[Flat, Tag("flat")]
    | Annotated[Grade, Tag("grade")]
    | Annotated[Bumps, Tag("bumps")]
    | Annotated[SpeedBump, Tag("speed_bump")]
    | Annotated[Curb, Tag("curb")]
    | Annotated[Step, Tag("step")]
    | Annotated[Pothole, Tag("pothole")]
    | Annotated[Iso8608, Tag("iso8608")]
    | Annotated[Mixed, Tag("mixed")]
    | Annotated[Profile, Tag("profile")]
    | Annotated[OpenCrgRoad, Tag("opencrg")]
    | Annotated[OwnRoad, Tag(OWN)],
    known_or_own("kind"),
]
