"""The scene: bodies that come, move and go, and the light that is there without the headlights."""

from dataclasses import dataclass, field

from pydantic import Field

from world.body import Body, PoseTrack
from world.params import Params
from world.triangles import Placed, Triangles

__all__ = ["Body", "PoseTrack", "Scene", "StreetLamp"]

# (object id, the 16 numbers of T_world_body) of every body that is there
Key = tuple[tuple[int, tuple[float, ...]], ...]


class StreetLamp(Params):
    """A point light that shines equally into all directions, without shadows."""

    position_m: tuple[float, float, float] = Field(description="Where it hangs in the world (x forward, y left, z up)")
    intensity_cd: float = Field(gt=0, description="Luminous intensity into every direction")


@dataclass(frozen=True, eq=False)
class Scene:
    """bodies: the road first; their order gives the object ids. ambient_lx: illuminance of a surface facing up, from an overcast sky."""

    bodies: tuple[Body, ...]
    ambient_lx: float = 0.0
    street_lamps: tuple[StreetLamp, ...] = ()
    _last_placed: dict[int, Placed] = field(default_factory=dict, init=False, repr=False)

    def key_at(self, t_s: float) -> Key:
        """Which bodies are there at a time, and where: cheap, and equal as long as nothing moves."""
        return tuple(
            (i, tuple(body.track.pose_at(t_s).flatten().tolist())) for i, body in enumerate(self.bodies) if body.track.visible_at(t_s)
        )

    def at(self, t_s: float) -> Triangles:
        """The scene's triangles at a time. Bodies that stood still since the last call are reused with all that was derived from them."""
        return Triangles(tuple(self._place(i, t_s) for i, _ in self.key_at(t_s)))

    def _place(self, i: int, t_s: float) -> Placed:
        T = self.bodies[i].track.pose_at(t_s)
        last = self._last_placed.get(i)
        if last is None or not last.T_world_body.equal(T):
            self._last_placed[i] = Placed(i, self.bodies[i], T)
        return self._last_placed[i]
