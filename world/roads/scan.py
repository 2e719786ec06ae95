"""A road from an OpenCRG scan, laid under the symbol."""

import os
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from luxloop.world.errors import LuxloopError
from luxloop.world.opencrg import CrgSurface, fill_gaps, modify, read_crg
from luxloop.world.params import Length, Metres, Real
from luxloop.world.roads.base import Floats, MeshGrid, RoadModel, ahead, smoothstep, together

# Where the tyres touch: front axle 0.8 m behind the lamps, wheelbase 2.8 m, track 1.6 m.
WHEELS_M = np.array([[-0.8, 0.8], [-0.8, -0.8], [-3.6, 0.8], [-3.6, -0.8]])
_REACH_M = 10.0


class OpenCrgRoad(RoadModel):
    """A measured road. One point of the scan lies under the symbol, with the reference line ahead or at a heading.

    If the scan reaches under all four wheels, the plane z = 0 is that of the wheels, else the scan's mean plane. Where the scan ends, its
    border is continued and fades into the plane z = 0. NaN is filled outwards in each cross-section.
    """

    kind: Literal["opencrg"] = "opencrg"
    file: str = Field(
        examples=["road.crg"], description="OpenCRG file: a path, relative to the scenario file, or a name from `luxloop data list`"
    )
    u_m: Real | None = Field(None, description="place along the scan that lies at at_x_m, in the file's u; default: its middle")
    v_m: Metres = Field(0.0, description="place across the scan that lies at at_y_m, positive to the left of its reference line")
    at_x_m: Metres = Field(17.0, description="distance ahead of the lamps at which the place lies")
    at_y_m: Metres = Field(0.0, description="distance to the left of the vehicle's middle at which the place lies")
    heading_deg: float = Field(
        0.0, ge=-360.0, le=360.0, description="heading of the vehicle relative to the scan's direction at the place, left positive"
    )
    blend_m: Length = Field(3.0, description="length over which the scan's border blends into the plane z = 0")

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        """Height in m over the plane that the vehicle stands on. Raises LuxloopError where file or place do not fit."""
        return _scan(self).z(x, y)

    def grid(self) -> MeshGrid:
        scan = _scan(self)
        crg = scan.surface.crg
        default = MeshGrid()
        x_m, y_m = (_overlap(*limits) for limits in zip((default.x_m, default.y_m), scan.extent(), strict=True))
        fine_along, fine_across = crg.u_step <= 0.02, np.diff(crg.v).min() <= 0.02
        # A scan that is coarse across needs few columns, which leaves more for detail along the road.
        spacing = (0.02 if fine_along else 0.03, 0.02 if fine_across else 0.06 if fine_along else 0.04)
        return MeshGrid(x_m, y_m, spacing)


@dataclass(frozen=True)
class _Scan:
    road: OpenCrgRoad
    surface: CrgSurface
    u: float
    plane: Floats  # [3]: height of the vehicle's plane in the file is plane @ (1, x, y), x and y of the scene
    standing: bool  # the vehicle stands on the scan

    def z(self, x: ArrayLike, y: ArrayLike) -> Floats:
        x, y = together(x, y)
        residual, outside_m = self._residual(x, y)
        weight = 1.0 - smoothstep(outside_m, 0.0, self.road.blend_m)
        return residual * (weight if self.standing else weight * ahead(x))

    def extent(self) -> Floats:
        """Least and greatest x and y `[2, 2]` in m of the scan, as if it were straight."""
        v = self.surface.crg.v
        u, v = np.meshgrid([self.surface.u_start - self.u, self.surface.u_end - self.u], [v[0] - self.road.v_m, v[-1] - self.road.v_m])
        heading = np.deg2rad(self.road.heading_deg)
        x = self.road.at_x_m + np.cos(heading) * u + np.sin(heading) * v
        y = self.road.at_y_m - np.sin(heading) * u + np.cos(heading) * v
        return np.array([[x.min(), x.max()], [y.min(), y.max()]])

    def _residual(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Height over the plane at the nearest grid coordinate of the scan, and the distance to that."""
        u, v = self.surface.uv(*self._file_from_scene(x, y))
        inside_u = np.clip(u, self.surface.u_start, self.surface.u_end)
        inside_v = np.clip(v, self.surface.crg.v[0], self.surface.crg.v[-1])
        near_x, near_y = self._scene_from_file(*self.surface.xy(inside_u, inside_v))
        level = self.plane[0] + self.plane[1] * near_x + self.plane[2] * near_y
        return self.surface.z(inside_u, inside_v) - level, np.hypot(u - inside_u, v - inside_v)

    def _frame(self) -> tuple[float, float, float, float]:
        x, y = self.surface.xy(self.u, self.road.v_m)
        phi = float(self.surface.phi(self.u)) + np.deg2rad(self.road.heading_deg)
        return float(x), float(y), float(np.cos(phi)), float(np.sin(phi))

    def _file_from_scene(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        x_0, y_0, cos, sin = self._frame()
        dx, dy = x - self.road.at_x_m, y - self.road.at_y_m
        return x_0 + cos * dx - sin * dy, y_0 + sin * dx + cos * dy

    def _scene_from_file(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        x_0, y_0, cos, sin = self._frame()
        dx, dy = x - x_0, y - y_0
        return self.road.at_x_m + cos * dx + sin * dy, self.road.at_y_m - sin * dx + cos * dy

    def level(self) -> "_Scan":
        """The scan levelled to the plane of the wheels or its mean plane."""
        x, y = WHEELS_M.T
        height, outside_m = self._residual(x, y)
        standing = not outside_m.any()
        if not standing:
            low, high = max(self.surface.u_start, self.u - _REACH_M), min(self.surface.u_end, self.u + _REACH_M)
            u, v = np.meshgrid(np.linspace(low, high, 201), np.linspace(self.surface.crg.v[0], self.surface.crg.v[-1], 81))
            height = self.surface.z(u, v).ravel()
            x, y = (axis.ravel() for axis in self._scene_from_file(*self.surface.xy(u, v)))
        plane = np.linalg.lstsq(np.stack([np.ones_like(x), x, y], axis=1), height, rcond=None)[0]
        return replace(self, plane=cast(Floats, plane), standing=standing)


def _scan(road: OpenCrgRoad) -> _Scan:
    path = Path(road.file)
    return _read(road, path, path.stat().st_mtime_ns if os.path.isfile(path) else 0)


@lru_cache(maxsize=8)
def _read(road: OpenCrgRoad, path: Path, changed_ns: int) -> _Scan:
    crg = read_crg(path)
    surface = CrgSurface(fill_gaps(modify(crg)))
    u = (surface.u_start + surface.u_end) / 2 if road.u_m is None else road.u_m
    for key, value, low, high in (("u_m", u, surface.u_start, surface.u_end), ("v_m", road.v_m, surface.crg.v[0], surface.crg.v[-1])):
        if not low <= value <= high:
            raise LuxloopError(f"road.{key} = {value:g} is not on the scan {path}; give a value from {low:g} to {high:g}")
    return _Scan(road, surface, u, np.zeros(3), False).level()


def _overlap(default: tuple[float, float], extent: Floats) -> tuple[float, float]:
    low, high = max(default[0], float(extent[0])), min(default[1], float(extent[1]))
    return (low, high) if high - low > 1.0 else default
