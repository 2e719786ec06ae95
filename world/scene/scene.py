"""The scene: bodies that appear, move and vanish, and the light besides the headlights."""

from dataclasses import dataclass, replace

import torch
from pydantic import Field
from torch import Tensor

from luxloop.world.frames import transform
from luxloop.world.params import Metres, Params
from luxloop.world.scene.air import AirParams, Medium
from luxloop.world.scene.body import Body, Figure, PoseTrack, Spotlight
from luxloop.world.scene.ground import Ground
from luxloop.world.scene.triangles import NOTHING, Group, Instance, Triangles

__all__ = ["Body", "Ground", "PoseTrack", "Scene", "StreetLamp"]

# (object id, the 16 numbers of T_world_body, a figure's phase) of every body that exists
Key = tuple[tuple[int, tuple[float, ...]], ...]


class StreetLamp(Params):
    """A point light with equal intensity in all directions, without shadows."""

    position_m: tuple[Metres, Metres, Metres] = Field(
        examples=[[20.0, 5.0, 6.0]], description="position in the world (x forward, y left, z up)"
    )
    intensity_cd: float = Field(gt=0, le=1e9, examples=[2000.0], description="luminous intensity in every direction")


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene. bodies: the road first; their order gives the object ids. ambient_lx: illuminance of a surface facing up by an overcast
    sky. air: fog, rain and snow over time, in ascending time; empty for clear air.
    """

    bodies: tuple[Body | Ground | Figure, ...]
    ambient_lx: float = 0.0
    street_lamps: tuple[StreetLamp, ...] = ()
    air: tuple[AirParams, ...] = ()

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
