"""Common parameters of objects: a name, a pose over time by keyframes or a path, and named parts of random objects."""

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
import torch
from pydantic import Field, model_validator

from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.frames import pose_from_degrees
from luxloop.world.materials.library import MaterialName
from luxloop.world.params import Degrees, Metres, Params, PlainName, Real, Seed, Share, Slope, ascending, in_order
from luxloop.world.scene.body import Body, Part, PoseTrack, Spotlight
from luxloop.world.traffic.shapes import Piece, join

PATH_STEP_M = 0.5  # between the poses along a curve

Category = Literal["car", "truck", "motorcycle", "cyclist", "pedestrian", "animal", "sign", "other"]
Reported = Annotated[Category | None, Field(description="class that trackers report to lighting functions; none: it is not reported")]
ROAD_USERS: frozenset[Category] = frozenset({"pedestrian", "cyclist", "motorcycle", "car", "truck"})  # who may be dazzled


class KeyframeParams(Params):
    """Pose of an object at one time."""

    time_s: Real = Field(0.0, description="time since the scenario's start")
    position_m: tuple[Metres, Metres, Metres] = Field(
        examples=[[20.0, 2.0, 0.0]], description="position of the object's origin in the world (x forward, y left, z up)"
    )
    roll_deg: Degrees = Field(0.0, description="rotation about the x axis, right side down positive")
    pitch_deg: Slope = Field(0.0, description="rotation about the y axis, nose down positive")
    yaw_deg: Degrees = Field(0.0, description="rotation about the z axis, to the left positive")


class WayParams(Params):
    """A path at constant speed; the object faces along it."""

    points_m: tuple[tuple[Metres, Metres, Metres], ...] = Field(
        min_length=2,
        examples=[[[60.0, 3.0, 0.0], [5.0, 3.0, 0.0]]],
        description="points of the path in the world, joined by a smooth curve",
    )
    speed_m_s: float = Field(gt=0, le=70, examples=[14.0], description="speed along the path")
    start_s: Real = Field(0.0, description="time at the first point; before it, and after the last point, the object stands still")

    @model_validator(mode="after")
    def _leads_on(self) -> Self:
        for k, (a, b) in enumerate(pairwise(self.points_m)):
            if math.hypot(b[0] - a[0], b[1] - a[1]) < 0.01:
                raise ValueError(f"points_m[{k + 1}] lies at points_m[{k}], seen from above; take one of the two out")
        return self

    def poses(self) -> tuple[tuple[float, ...], torch.Tensor]:
        """Times `K` in s and poses `[K, 4, 4]`, on a cubic Hermite curve with the slopes of central differences."""
        from scipy.interpolate import CubicHermiteSpline

        points = np.array(self.points_m)
        chord = np.cumsum([0.0, *np.linalg.norm(np.diff(points, axis=0), axis=1)])
        curve = CubicHermiteSpline(chord, points, np.gradient(points, chord, axis=0))
        at = np.linspace(0, chord[-1], 2 if len(points) == 2 else 1 + math.ceil(chord[-1] / PATH_STEP_M))
        way, ahead = curve(at), curve(at, 1)
        times = self.start_s + np.cumsum([0.0, *np.linalg.norm(np.diff(way, axis=0), axis=1)]) / self.speed_m_s
        yaw = np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0]))
        poses = [pose_from_degrees((x, y, z), yaw_deg=angle) for (x, y, z), angle in zip(way.tolist(), yaw.tolist(), strict=True)]
        return tuple(times.tolist()), torch.stack(poses)


class TrackedParams(Params):
    """Common parameters of objects: name, pose over time, times of appearing and vanishing."""

    wheels_m: ClassVar[tuple[float, float] | None] = None  # as those of `PoseTrack`

    name: PlainName = Field(examples=["walker"], description="name in recordings and reports")
    category: Reported = None
    track: Annotated[tuple[KeyframeParams, ...], ascending("time_s")] = Field(
        (), description="keyframes in ascending time; with one, the object stands still"
    )
    path: WayParams | None = Field(None, description="path at constant speed, instead of a track")
    on_road: bool = Field(False, description="measure heights from the road's surface under the object's origin instead of z = 0")
    appears_s: Real | None = Field(None, description="time at which it appears; left out: at the start")
    vanishes_s: Real | None = Field(None, description="time at which it vanishes; left out: never")

    _times_in_order = in_order("appears_s", "vanishes_s")

    @model_validator(mode="after")
    def _somewhere(self) -> Self:
        if bool(self.track) == (self.path is not None):
            raise ValueError(f"give either a track or a path, here {'are both' if self.track else 'is neither'}")
        return self

    def pose_track(self) -> PoseTrack:
        if self.path is None:
            times = tuple(k.time_s for k in self.track)
            poses = torch.stack([pose_from_degrees(k.position_m, k.roll_deg, k.pitch_deg, k.yaw_deg) for k in self.track])
        else:
            times, poses = self.path.poses()
        appears = -math.inf if self.appears_s is None else self.appears_s
        return PoseTrack(times, poses, appears, math.inf if self.vanishes_s is None else self.vanishes_s)


Looks = dict[str, tuple[MaterialName, float]]  # material and albedo of parts, by their names

# Parts through which road users see: light on them dazzles.
EYES = frozenset({"head", "hair", "helmet", "visor", "windscreen"})


class SurfaceParams(Params):
    """Albedo and material of a part; by default from the seed."""

    albedo: Share | None = Field(None, description="diffuse albedo")
    material: MaterialName | None = Field(None, description="material by name")


def check_parts(owner: str, given: Iterable[str], names: Sequence[str]) -> None:
    """Raises LuxloopError where an object names a part that it does not have."""
    for name in given:
        if name not in names:
            raise LuxloopError(f"object {owner!r}: parts: there is no part {name!r}; {did_you_mean(name, names)}")


class RandomParams(TrackedParams):
    """An object made from a seed."""

    seed: Seed = Field(0, description="seed of proportions, clothes and colours")
    parts: dict[str, SurfaceParams] = Field({}, description="albedo and material of parts by name, instead of those from the seed")

    def random(self) -> np.random.Generator:
        return np.random.default_rng(self.seed)

    def body(self, pieces: Sequence[Piece], looks: Looks, track: PoseTrack, spotlights: tuple[Spotlight, ...] = ()) -> Body:
        """The body of pieces. Raises LuxloopError where `parts` names an unknown part."""
        mesh, names, of_face = join(list(pieces))
        check_parts(self.name, self.parts, names)
        parts = tuple(self._part(name, *looks[name]) for name in names)
        return Body(self.name, mesh, smooth=True, track=track, parts=parts, part_of_face=torch.from_numpy(of_face), spotlights=spotlights)

    def _part(self, name: str, material: MaterialName, albedo: float) -> Part:
        given = self.parts.get(name, SurfaceParams())
        return Part(name, albedo if given.albedo is None else given.albedo, given.material or material)
