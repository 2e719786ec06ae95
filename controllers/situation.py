"""What lighting functions know: the car, its lamps, and the objects that a tracker reports, at one time."""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol, Self, runtime_checkable

import torch
from pydantic import Field, model_validator
from torch import Tensor

from controllers.geometry import Place
from controllers.pixels.primitives import Primitives, rectangle
from controllers.pixels.secondary import Light
from world.frames import inverse, transform
from world.headlight.lamp import Commands
from world.params import Params
from world.scene.body import Body
from world.scene.figure import Figure
from world.symbols import SymbolSource
from world.traffic.tracked import Category
from world.view import View

LAYERS = 16  # a function's primitives may lie above each other in so many layers
MASK = 1000  # priority of masks: above every function's own, which are at most 100


@dataclass(frozen=True, eq=False)
class TrackedObject:
    """A box around an object.

    name: of the object or its track, no two have the same. category: its class. T_world_object: `[4, 4]`, of the box in the world, origin
    in the middle of its foot, x along its length, z up. size_m: length, width, height. since_s: when the tracker first saw it. until_s:
    when it lost it, infinite while it is there; a lost object stays in the list while its functions fade out. confidence: 0..1, of its
    class, filtered over frames. score: the same in the last frame alone, NaN where it was not found there.
    """

    name: str
    category: Category
    T_world_object: Tensor
    size_m: tuple[float, float, float]
    since_s: float = -math.inf
    until_s: float = math.inf
    confidence: float = 1.0
    score: float = 1.0

    @classmethod
    def of(cls, body: Body | Figure, category: Category, time_s: float) -> "TrackedObject":
        """What a perfect tracker says of a body: the smallest box along its axes."""
        low, high = body.bounds
        length, width, height = (high - low).tolist()
        foot = torch.eye(4, dtype=torch.float64)
        foot[:3, 3] = torch.stack([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        track = body.track
        return cls(
            body.name, category, track.pose_at(time_s) @ foot, (length, width, height), since_s=track.appears_s, until_s=track.vanishes_s
        )


@dataclass(frozen=True, eq=False)
class Seen:
    """What the camera saw last.

    time_s: when the frame was taken. view: of the camera. luminance: `[height, width]` cd/m^2 as measured. saturation: the most that can
    be, cd/m^2. albedo: `[height, width]` in 0..1 of what is seen, None without a source of it. material: `[height, width]` int64, index in
    materials, -1 for none; None without a source of it. materials: names of the materials.
    """

    time_s: float
    view: View
    luminance: Tensor
    saturation: float = math.inf
    albedo: Tensor | None = None
    material: Tensor | None = None
    materials: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Situation:
    """One moment.

    All places are in the ground frame, which drives with the car; it is the world of lighting functions.

    time_s: since the beginning. T_world_vehicle: `[4, 4]`, of the vehicle frame in that world; the road is its plane z = 0.
    lamps: `[L, 3]` m, photometric centres of all modules there, by the measured attitude of the body. objects: what the tracker reports,
    lost ones until they have faded. speed_m_s: of the car. curvature_1_m: of its course, to the left positive. wet: whether the road is.
    street_lit: whether street lamps light it. symbols: images of the functions that draw any, by the name that they use. seen: the last
    frame, None where there is no camera, or before its first frame. lights: what the car's modules can give, with their names, as they are
    turned and dimmed. pitch_rad: measured pitch of the body over the road, nose down positive, 0 where nothing measures it. commands: how
    modules are turned and dimmed, one a module, none where all are at rest.
    """

    time_s: float
    T_world_vehicle: Tensor
    lamps: Tensor
    objects: tuple[TrackedObject, ...] = ()
    speed_m_s: float = 0.0
    curvature_1_m: float = 0.0
    wet: bool = False
    street_lit: bool = False
    symbols: dict[str, SymbolSource] = field(default_factory=dict)
    seen: Seen | None = None
    lights: tuple[tuple[str, Light], ...] = ()
    pitch_rad: float = 0.0
    commands: Commands = ()

    def commanded(self, commands: Commands) -> "Situation":
        """The same with the modules as they are commanded."""
        lights = ((name, light.under(command)) for (name, light), command in zip(self.lights, commands, strict=True))
        return replace(self, commands=commands, lights=tuple(lights))

    def distance_m(self, each: TrackedObject) -> float:
        """Along the road from the car's origin to the nearest corner of the object; negative for what lies behind."""
        length, width, _ = each.size_m
        x, y, zero = (
            torch.tensor(v, dtype=torch.float64) / 2 for v in ([length, length, -length, -length], [width, -width] * 2, [0.0] * 4)
        )
        T_vehicle_object = inverse(self.T_world_vehicle.double()) @ each.T_world_object.double()
        corners = transform(T_vehicle_object, torch.stack([x, y, zero]))
        return float(corners[:2].norm(dim=0).amin().copysign(corners[0].amax()))


def check_share(quantity: str, value: float) -> None:
    """Raises ValueError for more than all that a pixel can give."""
    if quantity == "u_abs" and value > 1:
        raise ValueError(
            f'value: u_abs is a share of what a pixel can give, at most 1, not {value:g}; lower it, or give quantity = "u_rel", say'
        )


class SelectionParams(Params):
    """Which objects are meant."""

    categories: tuple[Category, ...] = Field(
        ("car", "truck", "motorcycle", "cyclist"), min_length=1, description="classes of objects meant"
    )
    names: tuple[str, ...] | None = Field(None, description="only objects of these names; left out: all of the classes")
    nearer_than_m: float = Field(200.0, gt=0, le=10_000, description="only objects nearer than this")
    farther_than_m: float = Field(0.0, ge=0, le=10_000, description="only objects at least this far away")

    @model_validator(mode="after")
    def _some_distance_is_meant(self) -> Self:
        if self.farther_than_m >= self.nearer_than_m:
            raise ValueError(
                f"farther_than_m: no object is at least {self.farther_than_m:g} m away and nearer than {self.nearer_than_m:g} m; "
                "lower it, or raise nearer_than_m"
            )
        return self

    def selected(self, now: Situation) -> tuple[TrackedObject, ...]:
        """The objects meant that lie ahead; those that the tracker has lost are among them."""
        return tuple(
            each
            for each in now.objects
            if each.category in self.categories
            and (self.names is None or each.name in self.names)
            and self.farther_than_m <= now.distance_m(each) < self.nearer_than_m
        )


class LightingFunction(Protocol):
    """What the planner composes."""

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """The function's primitives at this moment, none where it has nothing to do."""
        ...


@runtime_checkable
class AdaptiveFunction(Protocol):
    """A lighting function that closes a loop: it learns from what is seen. Its state is a value, so that a run can be taken up anywhere."""

    def start(self) -> Any:
        """The state before anything is seen."""
        ...

    def step(self, state: Any, now: Situation) -> Any:
        """What has been learnt once `now.seen`, and what was found in it, has come."""
        ...

    def adapted(self, state: Any, now: Situation) -> tuple[Primitives, ...]:
        """The primitives at this moment."""
        ...

    def base_share(self, state: Any) -> float | None:
        """How much of the base beam shall be left, 0..1, None if it may be dimmed or not; of several that ask, the least dimmed wins."""
        ...


class Timed(Params):
    """When a function acts."""

    start_s: float | None = Field(None, ge=-1e6, le=1e6, description="acts from this time on; left out: from the beginning")
    stop_s: float | None = Field(None, ge=-1e6, le=1e6, description="acts until this time; left out: to the end")

    @model_validator(mode="after")
    def _stops_after_its_start(self) -> Self:
        if self.start_s is not None and self.stop_s is not None and self.stop_s <= self.start_s:
            raise ValueError(f"stop_s: {self.stop_s:g} s is not after start_s = {self.start_s:g} s, so that it never acts; raise it")
        return self

    def active(self, time_s: float) -> bool:
        return (self.start_s is None or time_s >= self.start_s) and (self.stop_s is None or time_s < self.stop_s)


class Drawn(Timed):
    """What all functions that draw light have."""

    quantity: Literal["I_v", "E_v", "u_abs", "u_rel"] = Field("u_abs", description="I_v in cd, E_v in lx, u_abs or u_rel as a share")
    value: float = Field(1.0, ge=0, le=1e9, description="setpoint of white; black is 0, or for u_rel 1, which leaves the base beam")
    weight: float = Field(1.0, ge=0, le=1e6, description="how much it counts where a pixel lights more than it")
    priority: int = Field(0, ge=0, le=100, description="of two functions in one place on the road, the higher is drawn")
    forced: bool = Field(False, description="drawn even behind other primitives, masks excepted")
    modules: tuple[str, ...] = Field((), description="lamps or modules that draw it; left out: all")
    share: bool = Field(True, description="what draws it gives its cd or lx together; false: each gives the whole")

    @model_validator(mode="after")
    def _share_of_a_pixel(self) -> Self:
        check_share(self.quantity, self.value)
        return self

    def draw(self, place: Place, image: Tensor | None = None, layer: int = 0, opacity: Tensor | None = None) -> Primitives:
        """One primitive; image: `[h, w]` in 0..1, white where there is none; layer: of several of a function, the higher lies on top.

        Black is dark, but for u_rel it leaves the base beam as it is. opacity: `[h, w]` in 0..1, opaque where there is none.
        """
        value = self.value
        if self.quantity == "u_rel" and image is not None:
            value = max(self.value, 1.0)
            image = (image * self.value + (1 - image)) / value
        if opacity is not None:
            image = torch.stack([torch.ones_like(opacity) if image is None else image, opacity])
        return rectangle(
            place.origin,
            place.d1,
            place.d2,
            value,
            self.quantity,
            normal=place.normal,
            symbol=image,
            weight=self.weight,
            forced=self.forced,
            priority=self.priority * LAYERS + layer,
            modules=self.modules,
            shared=self.share,
        )


def fade(time_s: float, since_s: float, until_s: float, in_s: float, out_s: float) -> float:
    """How far a function is there at a time, 0..1: it rises from `since_s` for `in_s` and falls from `until_s` for `out_s` (T 3.5.1)."""
    return min(_sigmoid(time_s - since_s, in_s), 1 - _sigmoid(time_s - until_s, out_s))


def _sigmoid(t: float, duration: float) -> float:
    """A logistic curve cut at +-6 and stretched, so that it is 0 at t = 0 and 1 after the duration; a step where that is zero."""
    if duration == 0 or math.isinf(t):
        return float(t >= 0)
    x = min(max(t / duration, 0.0), 1.0)
    return 0.5 + 0.5 * math.tanh(6 * (x - 0.5)) / math.tanh(3.0)
