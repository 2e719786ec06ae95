"""A body that moves later than the vehicle's dynamics say, so that it fits to light that comes late (T 4.3)."""

from dataclasses import dataclass, replace
from typing import Self

from luxloop.world.scene.vehicle import STANDING, Motion, VehicleState


@dataclass(frozen=True, eq=False)
class LateBody(Motion):
    """A drive whose body heaves, rolls and pitches `late_s` later; way, ground and speed are those of the time.

    dynamics: the drive as it is, which the sensors feel.
    """

    dynamics: Motion = STANDING
    late_s: float = 0.0

    @classmethod
    def behind(cls, motion: Motion, late_s: float) -> Self:
        """late_s: in s."""
        own = motion.times_s, motion.states, motion.pivot_x_m, motion.rear_x_m, motion.modes, motion.of
        return cls(*own, motion, late_s)

    def at(self, t_s: float) -> VehicleState:
        """The vehicle at a time in s."""
        then = self.dynamics.at(t_s - self.late_s)
        moved = {name: getattr(then, name) for name in ("T_ground_body", "heave_m", "roll_rad", "pitch_rad")}
        return replace(self.dynamics.at(t_s), **moved)
