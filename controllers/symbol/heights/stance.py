"""Where the body stands over the ground when frames and drawings are exposed, from what the vehicle's sensors say."""

from dataclasses import dataclass, replace

from torch import Tensor

from controllers.symbol.heights.body_filter import BodyFilter, exact
from controllers.symbol.sensing.planes import HERE
from controllers.symbol.sensing.protocol import Look
from world.frames import inverse

EVEN = 2e-3  # in m and rad: smaller movements of a body that stands are taken for errors of its sensors


@dataclass(frozen=True)
class Stances:
    """The body over a look and the drawing that follows it; all poses `[4, 4]`, float64 on the CPU.

    time_s: of the look's on frame. since: its ground frame in that of the look before. on, off: `T_ground_body` of its two frames in its
    ground frame. until: the ground frame of when the next drawing is exposed in that of the look. following: `T_ground_body` then.
    """

    time_s: float = 0.0
    since: Tensor = HERE
    on: Tensor = HERE
    off: Tensor = HERE
    until: Tensor = HERE
    following: Tensor = HERE

    @classmethod
    def of(cls, look: Look, body: BodyFilter | None, before_s: float) -> "Stances":
        """With the body as it is known now; without one the vehicle stands on even wheels. before_s: time_s of the look before."""
        now, then = look.ego, look.shown.ego
        if now is None or then is None or body is None:
            return cls()
        seen_s, next_s = then.time_s + then.age_s, now.time_s + now.age_s + now.period_s
        half_s = now.period_s / 2
        on, following = body.T_ground_body(seen_s), body.T_ground_body(next_s)
        if now.stands and then.stands and all(bool(((T - HERE).abs() < EVEN).all()) for T in (on, following)):
            return cls(seen_s)
        return cls(
            seen_s,
            exact(then.way(seen_s - before_s)),
            on,
            exact(then.way(half_s)) @ body.T_ground_body(seen_s + half_s),
            exact(now.way(next_s - seen_s)),
            following,
        )

    @property
    def still(self) -> bool:
        """Whether the look is that of a standing vehicle on even wheels."""
        return self.on.equal(HERE) and self.off.equal(HERE)

    def over(self, T_ground_plane: Tensor) -> "Stances":
        """The same over a plane at `[4, 4]` in place of the ground, of a vehicle that stands."""
        T = inverse(T_ground_plane)
        return replace(self, on=T @ self.on, off=T @ self.off, following=T @ self.following)
