"""The scene: bodies that appear, move and vanish, and the light besides the headlights."""

import math
from dataclasses import dataclass, replace
from typing import Final

import torch
from pydantic import Field
from torch import Tensor

from luxloop.world.frames import transform
from luxloop.world.params import Degrees, Metres, Params
from luxloop.world.scene.air import AirParams, Medium
from luxloop.world.scene.body import Body, Figure, PoseTrack, Spotlight
from luxloop.world.scene.ground import Ground
from luxloop.world.scene.triangles import NOTHING, Group, Instance, Triangles

__all__ = ["Body", "Ground", "PoseTrack", "Scene", "StreetLamp"]

SUN_M: Final = 10_000.0  # from the eye, at which the sun is: shadows within 100 m are parallel to as much as it is wide
SUN_DEG: Final = 0.53

# (object id, the 16 numbers of T_world_body, a figure's phase) of every body that exists
Key = tuple[tuple[int, tuple[float, ...]], ...]


class StreetLamp(Params):
    """A point light with equal intensity in all directions, without shadows."""

    position_m: tuple[Metres, Metres, Metres] = Field(
        examples=[[20.0, 5.0, 6.0]], description="position in the world (x forward, y left, z up)"
    )
    intensity_cd: float = Field(gt=0, le=1e9, examples=[2000.0], description="luminous intensity in every direction")


class SunParams(Params):
    """A low sun: parallel light with shadows, and a veil in the camera."""

    azimuth_deg: Degrees = Field(0.0, description="direction in the world, to the left of x")
    elevation_deg: float = Field(10.0, ge=1, le=90, description="height over the horizon")
    illuminance_lx: float = Field(10_000.0, gt=0, le=150_000, description="illuminance of a surface that faces it, through the air")
    veil: float = Field(0.1, ge=0, le=10, description="stray light of the camera's lens, as that of an oncoming lamp")

    @property
    def direction(self) -> Tensor:
        """Unit vector `[3]` float64 towards it, in the world."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        ahead = math.cos(elevation)
        return torch.tensor([ahead * math.cos(azimuth), ahead * math.sin(azimuth), math.sin(elevation)], dtype=torch.float64)

    @property
    def intensity_cd(self) -> float:
        """Luminous intensity of a lamp at `SUN_M` that gives the illuminance of the sun."""
        return self.illuminance_lx * SUN_M**2

    @property
    def diameter_m(self) -> float:
        """Diameter of a lamp at `SUN_M` that has the angular diameter of the sun."""
        return 2 * SUN_M * math.tan(math.radians(SUN_DEG / 2))


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene. bodies: the road first; their order gives the object ids. ambient_lx: illuminance of a surface facing up by an overcast
    sky. air: fog, rain and snow over time, in ascending time; empty for clear air. interreflection: whether surfaces light each other.
    """

    bodies: tuple[Body | Ground | Figure, ...]
    ambient_lx: float = 0.0
    street_lamps: tuple[StreetLamp, ...] = ()
    air: tuple[AirParams, ...] = ()
    sun: SunParams | None = None
    interreflection: bool = False

    @property
    def objects(self) -> tuple[Body | Figure, ...]:
        """All but the road."""
        return tuple(body for body in self.bodies[1:] if not isinstance(body, Ground))

    @property
    def moves(self) -> bool:
        """Whether a body has more than one pose."""
        return any(len(body.track.times_s) > 1 for body in self.bodies)

    def air_at(self, t_s: float) -> Medium | None:
        """The air at a time, None if clear; before the first entry as of that entry."""
        entries = [*self.air[:1], *(each for each in self.air if each.time_s <= t_s)]
        return entries[-1].medium if entries else None

    def key_at(self, t_s: float) -> Key:
        """Key of the bodies that exist at a time and their poses: cheap, and equal as long as nothing moves."""
        return tuple(
            (i, (*body.track.pose_at(t_s).flatten().tolist(), body.phase_at(t_s) if isinstance(body, Figure) else 0.0))
            for i, body in enumerate(self.bodies)
            if body.track.visible_at(t_s)
        )

    def at(self, t_s: float, T_world_ground: Tensor | None = None, before: Triangles = NOTHING) -> Triangles:
        """The scene's triangles at a time.

        T_world_ground: `[4, 4]`, ground frame of the observing vehicle; default: the world's origin. before: triangles of another time,
        whose unmoved bodies are reused with their derived values.
        """
        here = torch.eye(4, dtype=torch.float64) if T_world_ground is None else T_world_ground
        placed_before = {placed.object_id: placed for placed in before.placed}
        road, standing, moving = list[Instance](), list[Instance](), list[Instance]()
        for i, body in enumerate(self.bodies):
            if not body.track.visible_at(t_s):
                continue
            if isinstance(body, Ground):
                road += body.near(i, here)
            else:
                (moving if len(body.track.times_s) > 1 else standing).append(self._place(i, body, t_s, placed_before.get(i)))
        groups_before = {group.placed: group for group in before.groups}
        return Triangles(tuple(groups_before.get(each) or Group(each) for each in map(tuple, (road, standing, moving)) if each))

    def _place(self, i: int, body: Body | Figure, t_s: float, before: Instance | None) -> Instance:
        T, shape = body.track.pose_at(t_s), body.at(t_s) if isinstance(body, Figure) else body
        rests = before is not None and before.body is shape and before.T_world_body.equal(T)
        return before if before is not None and rests else Instance(i, shape, T)

    def spotlights_at(self, t_s: float) -> tuple[Spotlight, ...]:
        """The lamps of all bodies that exist at a time, in world coordinates."""
        return tuple(
            replace(lamp, position=transform(T, lamp.position[:, None])[:, 0], axis=T[:3, :3] @ lamp.axis)
            for body in self.bodies
            if isinstance(body, Body) and body.track.visible_at(t_s)
            for T in [body.track.pose_at(t_s)]
            for lamp in body.spotlights
        )
