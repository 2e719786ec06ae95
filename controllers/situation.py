"""The input of lighting functions: the car, its lamps and the tracked objects at one time."""

import math
from bisect import bisect_left
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal, Protocol, Self, runtime_checkable

import torch
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.controllers.geometry import Place
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.secondary import PotentialLight
from luxloop.world.frames import View, inverse, transform
from luxloop.world.headlight.lamp import Commands
from luxloop.world.params import Distance, Length, NotNegative, Params, Real, in_order
from luxloop.world.scene.body import Body, Figure
from luxloop.world.symbols import SymbolSource
from luxloop.world.traffic.tracked import Category

LAYERS = 16  # most layers of primitives that a function may stack
Side = Literal["left", "right"]
Indicator = Literal["off", "left", "right", "hazard"]
Priority = Annotated[int, Field(ge=0, le=100, description="where functions overlap, the higher priority is drawn")]
DrawingModules = Annotated[tuple[str, ...], Field(description="lamps or modules that draw the light; left out: all")]
SURE = 0.7  # confidence below which an object may be another, or none
MASK = 1000  # priority of the nearest object's mask
SOFT_MASK = 101  # of soft zones and fading masks: above every function's own, which are at most 100


@dataclass(frozen=True, eq=False)
class TrackedObject:
    """A tracked object and its box.

    name: unique name of the object or its track. category: its class. T_world_object: `[4, 4]`, pose of the box in the world, origin at the
    centre of its foot, x along its length, z up. size_m: length, width, height. since_s: time at which the tracker first saw it. until_s:
    time at which the tracker lost it, infinite while it is tracked; a lost object stays in the list while its functions fade out.
    confidence: 0..1, of the class, filtered over frames. score: confidence in the last frame alone, NaN without a detection.
    """

    name: str
    category: Category
    T_world_object: Tensor
    size_m: tuple[float, float, float]
    since_s: float = -math.inf
    until_s: float = math.inf
    confidence: float = 1.0
    score: float = 1.0

    @property
    def bounds(self) -> Tensor:
        """Two opposite corners `[2, 3]` m of the box in its frame."""
        length, width, height = self.size_m
        return torch.tensor([[-length / 2, -width / 2, 0.0], [length / 2, width / 2, height]], dtype=torch.float64)

    def present(self, time_s: float) -> bool:
        """Whether the object is tracked at a time."""
        return self.since_s <= time_s < self.until_s

    @classmethod
    def of(cls, body: Body | Figure, category: Category, time_s: float) -> "TrackedObject":
        """A body as a perfect tracker reports it: the smallest box along its axes."""
        low, high = body.bounds
        length, width, height = (high - low).tolist()
        foot = torch.eye(4, dtype=torch.float64)
        foot[:3, 3] = torch.stack([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        track = body.track
        return cls(
            body.name, category, track.pose_at(time_s) @ foot, (length, width, height), since_s=track.appears_s, until_s=track.vanishes_s
        )


@dataclass(frozen=True, eq=False)
class CameraImage:
    """Measured quantities of the last camera frame.

    time_s: when the frame was taken. view: of the camera. luminance: `[height, width]` cd/m^2. saturation: largest measurable luminance,
    cd/m^2. albedo: `[height, width]` in 0..1, None without a source of albedo. material: `[height, width]` int64, index in materials, -1
    for none; None without a source of materials. materials: names of the materials.
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
    """The situation at one time.

    All positions are in the ground frame, which moves with the car and is the world frame of lighting functions.

    time_s: since the start. T_world_vehicle: `[4, 4]`, pose of the vehicle frame; the road is its plane z = 0. lamps: `[L, 3]` m,
    photometric centres of all modules, by the measured attitude of the body. objects: the tracked objects, lost ones until they have faded.
    speed_m_s: of the car. curvature_1_m: of its course, left positive. wet: whether the road is wet. street_lit: whether street lamps light
    the road. symbols: the functions' images by name. seen: the last frame, None without a camera or before the first frame. lights: names
    and potential lights of the modules in their commanded turn and dimming. pitch_rad: measured pitch of the body relative to the road,
    nose down positive, 0 without a sensor. commands: turn and dimming of each module, empty if all are at rest. indicator: direction
    indicator; `hazard` indicates both sides. lit: names of the objects that object light lights. rate_hz: of the control steps. seed: of
    what the car draws by lot.
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
    seen: CameraImage | None = None
    lights: tuple[tuple[str, PotentialLight], ...] = ()
    pitch_rad: float = 0.0
    commands: Commands = ()
    indicator: Indicator = "off"
    lit: frozenset[str] = frozenset()
    rate_hz: float = 30.0
    seed: int = 0

    def under(self, commands: Commands) -> "Situation":
        """The situation with commanded turns and dimming of the modules."""
        lights = ((name, light.under(command)) for (name, light), command in zip(self.lights, commands, strict=True))
        return replace(self, commands=commands, lights=tuple(lights))

    def indicates(self, side: Side) -> bool:
        """Whether the indicator is on for a side."""
        return self.indicator in (side, "hazard")

    def distance_m(self, each: TrackedObject) -> float:
        """Distance in m along the road from the car's origin to the object's nearest corner; negative behind the car."""
        length, width, _ = each.size_m
        x, y, zero = (
            torch.tensor(v, dtype=torch.float64) / 2 for v in ([length, length, -length, -length], [width, -width] * 2, [0.0] * 4)
        )
        T_vehicle_object = inverse(self.T_world_vehicle.double()) @ each.T_world_object.double()
        corners = transform(T_vehicle_object, torch.stack([x, y, zero]))
        return float(corners[:2].norm(dim=0).amin().copysign(corners[0].amax()))

    @cached_property
    def _distances_m(self) -> list[float]:
        return sorted(map(self.distance_m, self.objects))

    def mask_layer(self, each: TrackedObject) -> int:
        """Priority of an object's mask: that of nearer objects is higher, with room for their own light in between."""
        nearer = bisect_left(self._distances_m, self.distance_m(each))
        return (MASK - 2 * nearer) * LAYERS


def check_share(quantity: str, value: float) -> None:
    """Raises ValueError for a u_abs above 1."""
    if quantity == "u_abs" and value > 1:
        raise ValueError(
            f'value: u_abs is a share of what a pixel can give, at most 1, not {value:g}; lower it, or give quantity = "u_rel", say'
        )


class SelectionParams(Params):
    """Selection of tracked objects by class, name and distance."""

    categories: tuple[Category, ...] = Field(
        ("car", "truck", "motorcycle", "cyclist"), min_length=1, description="classes of objects selected"
    )
    names: tuple[str, ...] | None = Field(None, description="select only objects of these names; left out: all names")
    nearer_than_m: Length = Field(200.0, description="select only objects nearer than this")
    farther_than_m: Distance = Field(0.0, description="select only objects at least this far away")

    _distances_in_order = in_order("farther_than_m", "nearer_than_m")

    def select(self, now: Situation) -> tuple[TrackedObject, ...]:
        """The selected objects that lie ahead, including those that the tracker has lost."""
        return tuple(
            each
            for each in now.objects
            if each.category in self.categories
            and (self.names is None or each.name in self.names)
            and self.farther_than_m <= now.distance_m(each) < self.nearer_than_m
        )

    def select_present(self, now: Situation) -> list[TrackedObject]:
        """The selected objects that are tracked now."""
        return [each for each in self.select(now) if each.present(now.time_s)]


class LightingFunction(Protocol):
    """A lighting function: the planner composes the primitives of all of them."""

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """The function's primitives now; empty if it draws nothing."""
        ...


@runtime_checkable
class AdaptiveFunction(Protocol):
    """A lighting function that closes a loop over camera frames; its state is a value, so that a run can resume at any step."""

    def start(self) -> Any:
        """The state before the first frame."""
        ...

    def step(self, state: Any, now: Situation) -> Any:
        """The state after `now.seen` and the objects detected in it."""
        ...

    def adapted(self, state: Any, now: Situation) -> tuple[Primitives, ...]:
        """The primitives now."""
        ...

    def base_share(self, state: Any) -> float | None:
        """Demanded share of the base beam, 0..1, or None for no demand; the largest demand of all functions applies."""
        ...


class ScheduleParams(Params):
    """When a function is active."""

    start_s: Real | None = Field(None, description="time from which the function is active; left out: from the start")
    stop_s: Real | None = Field(None, description="time until which the function is active; left out: to the end")
    indicated: Side | None = Field(None, description="active only while the indicator shows this side; left out: always")

    _times_in_order = in_order("start_s", "stop_s")

    def active(self, now: Situation) -> bool:
        """Whether the function is active now."""
        begun = self.start_s is None or now.time_s >= self.start_s
        return begun and (self.stop_s is None or now.time_s < self.stop_s) and not self.waits(now)

    def waits(self, now: Situation) -> bool:
        """Whether the function waits for the indicator of its side."""
        return self.indicated is not None and not now.indicates(self.indicated)


class DrawingParams(ScheduleParams):
    """Common parameters of the functions that draw light."""

    quantity: Literal["I_v", "E_v", "u_abs", "u_rel"] = Field(
        "u_abs", description="unit of the setpoint: I_v in cd, E_v in lx, u_abs as utilisation, u_rel as share of the base beam"
    )
    value: float = Field(1.0, ge=0, le=1e9, description="setpoint of a white image; black is 0, or 1 for u_rel, which keeps the base beam")
    weight: NotNegative = Field(1.0, description="weight against other light where a pixel lights more than this")
    priority: Priority = 0
    forced: bool = Field(False, description="drawn even behind other primitives, except masks")
    modules: DrawingModules = ()
    share: bool = Field(True, description="the drawing modules share the cd or lx; false: each module gives the whole value")

    @model_validator(mode="after")
    def _share_of_a_pixel(self) -> Self:
        check_share(self.quantity, self.value)
        return self

    def draw(self, place: Place, image: Tensor | None = None, layer: int = 0, opacity: Tensor | None = None) -> Primitives:
        """One primitive. image: `[h, w]` in 0..1, by default white. layer: among primitives of one function, the higher layer lies on top.

        Black is dark, except for u_rel, where it keeps the base beam. opacity: `[h, w]` in 0..1, by default opaque.
        """
        value = self.value
        if self.quantity == "u_rel" and image is not None:
            value = max(self.value, 1.0)
            image = (image * self.value + (1 - image)) / value
        if opacity is not None:
            image = torch.stack([torch.ones_like(opacity) if image is None else image, opacity])
        return place.light(
            value,
            self.quantity,
            symbol=image,
            weight=self.weight,
            forced=self.forced,
            priority=self.priority * LAYERS + layer,
            modules=self.modules,
            shared=self.share,
        )


def fade(time_s: float, since_s: float, until_s: float, in_s: float, out_s: float) -> float:
    """Strength of a function at a time, 0..1: a rise from `since_s` on for `in_s`, and a fall from `until_s` on for `out_s` (T 3.5.1)."""
    return min(_sigmoid(time_s - since_s, in_s), 1 - _sigmoid(time_s - until_s, out_s))


def _sigmoid(t: float, duration: float) -> float:
    """A logistic curve cut at +-6 and scaled from 0 at t = 0 to 1 after the duration; a step if the duration is zero."""
    if duration == 0 or math.isinf(t):
        return float(t >= 0)
    x = min(max(t / duration, 0.0), 1.0)
    return 0.5 + 0.5 * math.tanh(6 * (x - 0.5)) / math.tanh(3.0)
