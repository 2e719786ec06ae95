"""Where the body stands over the ground when frames and drawings are exposed, from what the vehicle's sensors say."""

from dataclasses import dataclass, replace
from typing import Final

from torch import Tensor

from controllers.symbol.heights.body_filter import BodyFilter, exact
from controllers.symbol.sensing.planes import HERE
from controllers.symbol.sensing.protocol import Look
from perception.egomotion import Ego
from world.frames import inverse

EVEN = 2e-3  # in m and rad: smaller movements of a body that stands are taken for errors of its sensors
LATER_S = 0.2  # a quarter of a slow oscillation, after which one that swings through its rest is furthest from it


@dataclass(frozen=True)
class Following:
    """The body when the next drawing is exposed; all poses `[4, 4]`, float64 on the CPU.

    until: the ground frame of that time in that of the last look. body: `T_ground_body` then.
    """

    until: Tensor = HERE
    body: Tensor = HERE

    @classmethod
    def of(cls, ego: Ego | None, body: BodyFilter, since_s: float) -> "Following":
        """As far as is known now. since_s: time of the last look."""
        if ego is None:
            return cls()
        T_ground_body = body.T_ground_body(ego.time_s)
        return cls() if ego.stands and _rests(body, ego.time_s) else cls(exact(ego.way(ego.time_s - since_s)), T_ground_body)

    @property
    def still(self) -> bool:
        """Whether the vehicle stands on even wheels."""
        return self.body is HERE


AT_REST: Final = Following()


@dataclass(frozen=True)
class Stances:
    """The body over a look; all poses `[4, 4]`, float64 on the CPU.

    time_s: of the look's on frame. since: its ground frame in that of the look before. on, off: `T_ground_body` of its two frames in its
    ground frame.
    """

    time_s: float = 0.0
    since: Tensor = HERE
    on: Tensor = HERE
    off: Tensor = HERE

    @classmethod
    def of(cls, look: Look, body: BodyFilter | None, before_s: float) -> "Stances":
        """With the body as it is known now; without one the vehicle stands on even wheels. before_s: time_s of the look before."""
        then = look.shown.ego
        if look.ego is None or then is None or body is None:
            return cls()
        seen_s, on_s = then.time_s, then.on_s
        on = body.T_ground_body(seen_s)
        if then.stands and _rests(body, seen_s) and Following.of(look.ego, body, seen_s).still:
            return cls(seen_s)
        return cls(seen_s, exact(then.way(seen_s - before_s)), on, exact(then.way(on_s)) @ body.T_ground_body(seen_s + on_s))

    @property
    def still(self) -> bool:
        """Whether the look is that of a standing vehicle on even wheels."""
        return self.on.equal(HERE) and self.off.equal(HERE)

    def over(self, T_ground_plane: Tensor) -> "Stances":
        """The same over a plane at `[4, 4]` in place of the ground, of a vehicle that stands."""
        T = inverse(T_ground_plane)
        return replace(self, on=T @ self.on, off=T @ self.off)


def _rests(body: BodyFilter, time_s: float) -> bool:
    """Whether the body stands even at a time and does not only swing through; heave, of which no sensor tells the rate, may do so."""
    away, later = ((body.T_ground_body(t_s) - HERE).abs() for t_s in (time_s, time_s + LATER_S))
    return bool((away < EVEN).all() and (later[:3, :3] < EVEN).all())
