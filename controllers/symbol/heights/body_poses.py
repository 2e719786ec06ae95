"""Poses of the body over the ground at the exposure of frames and projections, from the vehicle's sensors."""

from dataclasses import dataclass, replace
from typing import Final

from torch import Tensor

from luxloop.controllers.symbol.heights.body_filter import BodyFilter, exact
from luxloop.controllers.symbol.sensing.road_shape import HERE
from luxloop.controllers.symbol.sensing.symbol_sensor import Observation
from luxloop.perception.egomotion import Ego
from luxloop.world.frames import inverse
from luxloop.world.scene.vehicle import ground_pose

EVEN = 2e-3  # in m and rad: smaller movements of a standing body count as sensor noise
LATER_S = 0.2  # a quarter of a slow oscillation, from its zero crossing to its peak


@dataclass(frozen=True)
class BodyPrediction:
    """Predicted poses at the exposure of the next projection, `[4, 4]` float64 on the CPU.

    until: ground frame at that exposure, in the ground frame of the last observation. body: `T_ground_body` at that exposure.
    """

    until: Tensor = HERE
    body: Tensor = HERE

    @classmethod
    def of(cls, ego: Ego | None, body: BodyFilter, since_s: float, ground: Tensor) -> "BodyPrediction":
        """The prediction of a body filter. since_s: time of the last observation. ground: `T_level_ground` `[4, 4]` at since_s."""
        if ego is None:
            return cls()
        now = ground_pose(body.ground(ego, ego.time_s)[:2])
        if ego.stands and _rests(body, now, ego.time_s):
            return cls()
        # T_ground_level (then) T_then_now T_level_ground (now), and T_ground_level T_level_body (both now).
        return cls(inverse(ground) @ exact(ego.way(ego.time_s - since_s)) @ now, inverse(now) @ body.T_level_body(ego.time_s))

    @property
    def still(self) -> bool:
        """Whether the vehicle stands on level wheels."""
        return self.body is HERE


AT_REST: Final = BodyPrediction()


@dataclass(frozen=True)
class BodyPoses:
    """Poses at an observation, `[4, 4]` float64 on the CPU.

    time_s: time of the on frame. ground: `T_level_ground` at time_s. since: ground frame at time_s in the ground frame of the previous
    observation. on, off: `T_ground_body` at on and off frame, both in the ground frame of time_s.
    """

    time_s: float = 0.0
    ground: Tensor = HERE
    since: Tensor = HERE
    on: Tensor = HERE
    off: Tensor = HERE

    @classmethod
    def of(cls, observation: Observation, body: BodyFilter | None, before_s: float, before: Tensor | None) -> "BodyPoses":
        """Poses estimated by a body filter; None: the vehicle stands on level wheels.

        before_s, before: time_s and ground of the previous observation; None without one.
        """
        then = observation.shown.ego
        if observation.ego is None or then is None or body is None:
            return cls()
        seen_s, on_s = then.time_s, then.on_s
        ground = ground_pose(body.ground(then, seen_s)[:2])
        if then.stands and _rests(body, ground, seen_s) and BodyPrediction.of(observation.ego, body, seen_s, ground).still:
            return cls(seen_s, ground)
        T_ground_level, way = inverse(ground), exact(then.way(seen_s - before_s))
        since = inverse(ground if before is None else before) @ way @ ground  # T_ground_level (before) T_before_then T_level_ground (then)
        off = exact(then.way(on_s)) @ body.T_level_body(seen_s + on_s)  # T_level_body, in the level frame of the on frame
        return cls(seen_s, ground, since, T_ground_level @ body.T_level_body(seen_s), T_ground_level @ off)

    @property
    def still(self) -> bool:
        """Whether the vehicle stood on level wheels at the observation."""
        return self.on.equal(HERE) and self.off.equal(HERE)

    def over(self, T_ground_plane: Tensor) -> "BodyPoses":
        """Poses in the frame of a plane at `[4, 4]` instead of the ground frame, for a standing vehicle."""
        T = inverse(T_ground_plane)
        return replace(self, on=T @ self.on, off=T @ self.off)


def _rests(body: BodyFilter, ground: Tensor, time_s: float) -> bool:
    """Whether the body is level at a time and still level LATER_S afterwards; its heave may oscillate, as no sensor measures its rate."""
    # Third row of T_ground_body - 1, [4]: to first order -pitch, roll, 0, and heave + pitch times the pivot's x.
    away, later = ((inverse(ground) @ body.T_level_body(t_s) - HERE)[2].abs() for t_s in (time_s, time_s + LATER_S))
    return bool((away < EVEN).all() and (later[:3] < EVEN).all())
