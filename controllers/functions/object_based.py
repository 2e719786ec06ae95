"""Object-based lighting: a dimmed base beam, and on each object the illuminance at which its detection is best (T 9.3)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, Self

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.functions.object_loop import Ambient, AmbientLoopParams, ObjectLoop, ObjectLoopParams
from luxloop.controllers.geometry import Place
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.situation import LAYERS, SURE, DrawingModules, Priority, SelectionParams, Situation, TrackedObject, fade
from luxloop.perception.tracking import LINGER_S
from luxloop.world.frames import transform
from luxloop.world.params import Distance, NotNegative, Params, Share
from luxloop.world.traffic.tracked import ROAD_USERS, Category

NEAREST_M = 1.0  # objects nearer to a lamp are not lit; no lamp's light falls on heads there
TEXEL_RAD = 1e-3  # texel width, over which light is interpolated
CELLS = 16  # texels per stripe
CORE_M = 0.3  # width of an object's opaque core, in its middle
Pattern = Literal["homogeneous", "stripes", "checks"]


class ObjectLightParams(Params):
    """Area and pattern of the light on an object."""

    pattern: Pattern = Field(
        "homogeneous", description="`homogeneous` or structured light: `stripes` (vertical) or `checks` show edges with less flux"
    )
    period_m: float = Field(0.5, ge=0.05, le=5, description="period of the structure on the object")
    margin_m: Distance = Field(
        0.1, description="margin of the light beyond the box on all sides; below the foot it shows the contact with the road"
    )
    dark: dict[Category, Annotated[float, Field(ge=0, le=1)]] = Field(
        {"pedestrian": 0.25, "cyclist": 0.25, "motorcycle": 0.3, "car": 0.45, "truck": 0.6},
        description="share of the box's height, from the top, that stays dark with all behind it: heads and windscreens",
    )
    dark_lx: NotNegative = Field(0.6, description="illuminance of the dark part, with `ssc.a_d` = 1; detectors need to see heads")

    def on(
        self, each: TrackedObject, lamps: Tensor, lx: float, priority: int, layer: int, modules: tuple[str, ...]
    ) -> tuple[Primitives, ...]:
        """Primitives that light the object with lx and leave part of it dark; none for objects beside or behind the lamps.

        lamps: positions `[L, 3]` m. layer: priority of the dark part, which overrides all light except on the opaque cores of nearer
        objects. Only road users have a core, since much of an animal's box is air. The dark part extends equally far above and below
        the top of the box, since a detector's box may end below a dark head.
        """
        (low, high), height = each.bounds, each.size_m[2]
        body = frontal(each.T_world_object, low, high, lamps, self.margin_m, self.margin_m)
        if body is None:
            return ()
        image = self._image(body)
        parts = [body.light(lx, "E_v", symbol=image, priority=priority * LAYERS, modules=modules)]
        if image is None and each.category in ROAD_USERS:
            across, down = min(1.0, CORE_M / float(body.d1.norm())), 1 - self.margin_m / float(body.d2.norm())
            core = Place(body.origin + (1 - across) / 2 * body.d1, across * body.d1, down * body.d2, body.normal)
            core_lx = min(lx, self.dark_lx) if math.isnan(each.score) or each.confidence < SURE else lx
            parts.append(core.light(core_lx, "E_v", forced=True, priority=layer - LAYERS, modules=modules))
        share = self.dark.get(each.category, 0.0)
        if each.confidence < SURE:
            share = max(share, self.dark.get("pedestrian", 0.0))
        low[2], high[2] = (1 - share) * height, (1 + share) * height
        below = TEXEL_RAD * float((body.origin - lamps.mean(0)).norm())
        eyes = frontal(each.T_world_object, low, high, lamps, self.margin_m, below) if share else None
        if eyes is not None:
            parts.append(eyes.light(self.dark_lx, "E_v", weight=math.inf, forced=True, priority=layer))
        return tuple(parts)

    def _image(self, place: Place) -> Tensor | None:
        """Image `[h, w]` of the structure, whole cells from the top left; None for homogeneous light."""
        if self.pattern == "homogeneous":
            return None
        across, down = (torch.arange(max(1, round(2 * float(d.norm()) / self.period_m))) % 2 == 0 for d in (place.d1, place.d2))
        cells = across[None] if self.pattern == "stripes" else across == down[:, None]
        return cells.double().repeat_interleave(CELLS, 0).repeat_interleave(CELLS, 1)


def frontal(T_world_box: Tensor, low: Tensor, high: Tensor, lamps: Tensor, margin_m: float, foot_m: float) -> Place | None:
    """The upright rectangle through the box's nearest corner that faces the lamps and covers the box as seen from each lamp.

    low, high: `[3]` m, opposite corners in the box's frame. lamps: `[L, 3]` m. margin_m: margin on all sides but the foot. foot_m: margin
    at the foot. None if a corner is nearer than NEAREST_M.
    """
    T, lamps = T_world_box.double(), lamps.double()
    up, viewer = T[:3, 2], lamps.mean(0)
    corners = transform(T, torch.cartesian_prod(*torch.stack([low, high]).double().T).T).T
    away = corners.mean(0) - viewer
    ahead = torch.nn.functional.normalize(away - (away @ up) * up, dim=0)
    nearest = ((corners - viewer) @ ahead).amin()
    rays = corners - lamps[:, None]
    depth = rays @ ahead
    if nearest < NEAREST_M or depth.amin() < NEAREST_M:
        return None
    plane = nearest - (lamps - viewer) @ ahead
    seen = lamps[:, None] + rays * (plane[:, None] / depth)[..., None] - viewer
    right = torch.linalg.cross(ahead, up)
    across, height = (seen @ right).flatten(), (seen @ up).flatten()
    left_at, right_at = across.amin() - margin_m, across.amax() + margin_m
    top_at, foot_at = height.amax() + margin_m, height.amin() - foot_m
    origin = viewer + nearest * ahead + left_at * right + top_at * up
    return Place(origin, (right_at - left_at) * right, (foot_at - top_at) * up, -ahead)


ALIKE = 1.5  # largest ratio of two apparent heights of the same object


@dataclass(frozen=True)
class Apparent:
    """Appearance of an object: azimuth (left positive), width and height in rad. Errors of the distance cancel out in the height."""

    bearing_rad: float
    width_rad: float
    height_rad: float

    @classmethod
    def of(cls, each: TrackedObject, lamps: Tensor) -> Self:
        """The appearance of an object from lamps at `[L, 3]` m."""
        x, y, _ = (each.T_world_object[:3, 3].double() - lamps.double().mean(0)).tolist()
        _, width, height = each.size_m
        distance_m = max(math.hypot(x, y), NEAREST_M)
        return cls(math.atan2(y, x), width / distance_m, height / distance_m)

    def same(self, other: "Apparent") -> bool:
        """Whether two appearances may be of the same object: azimuths within the larger width, heights within ALIKE."""
        off = abs(math.remainder(self.bearing_rad - other.bearing_rad, math.tau))
        low, high = sorted((self.height_rad, other.height_rad))
        return off < max(self.width_rad, other.width_rad) and high < ALIKE * low


@dataclass(frozen=True)
class ObjectBasedState:
    """State: the ambient loop, and the loop of each object by its name."""

    ambient: Ambient
    loops: Mapping[str, ObjectLoop] = field(default_factory=dict)

    @property
    def share(self) -> float:
        return self.ambient.share


class ObjectBasedParams(SelectionParams):
    """Light on objects, over a dimmed base beam."""

    kind: Literal["object_based"] = "object_based"
    method: Literal["confidence", "ambient", "class", "constant"] = Field(
        "confidence",
        description="`confidence`: loops on a detector's confidence; `ambient`: only the base beam's loop, without light on objects; "
        "`class`: a setpoint for each class; `constant`: one setpoint for all",
    )
    categories: tuple[Category, ...] = Field(
        ("pedestrian", "cyclist", "car", "animal", "truck", "motorcycle"), min_length=1, description="classes of objects to light"
    )
    ambient: AmbientLoopParams = Field(AmbientLoopParams(), description="loop of the base beam, for `confidence` and `ambient`")
    loop: ObjectLoopParams = Field(ObjectLoopParams(), description="loop of each object, for `confidence`")
    share: Share = Field(0.2, description="share of the base beam, for `class` and `constant`")
    setpoint_lx: NotNegative = Field(10.0, description="setpoint on each object for `constant`, and on classes not in setpoints_lx")
    setpoints_lx: dict[Category, Annotated[float, Field(ge=0, le=1e6)]] = Field(
        {"pedestrian": 10.0, "cyclist": 10.0, "animal": 15.0, "car": 3.0, "truck": 3.0, "motorcycle": 5.0},
        description="setpoints on objects by their class, for `class`",
    )
    light: ObjectLightParams = Field(ObjectLightParams(), description="area and pattern of the light on objects")
    fade_out_s: float = Field(0.6, ge=0, le=LINGER_S, description="time until the light on a vanished object is off")
    priority: Priority = 20
    modules: DrawingModules = ()

    @property
    def _closed(self) -> bool:
        """Whether the method learns from a detector."""
        return self.method in ("confidence", "ambient")

    def start(self) -> ObjectBasedState:
        return ObjectBasedState(Ambient(self.ambient.first if self._closed else self.share))

    def step(self, state: ObjectBasedState, now: Situation) -> ObjectBasedState:
        """The state after a frame; objects that the tracker no longer reports are dropped.

        A new object at the place of a lost object continues the lost object's loop.
        """
        if not self._closed:
            return state
        objects = self.select(now)
        seen = {each.name: Apparent.of(each, now.lamps) for each in objects}
        missed = [each.name for each in objects if each.name in state.loops and math.isnan(each.score)]
        loops: dict[str, ObjectLoop] = {}
        for each in objects:
            at, old = seen[each.name], state.loops.get(each.name)
            if each.until_s <= now.time_s:
                loops |= {} if old is None else {each.name: old}
            elif each.since_s <= now.time_s:
                old = old or next((replace(state.loops[name], scores=()) for name in missed if at.same(seen[name])), None)
                if old is None:
                    loops[each.name] = self.loop.start(each, at.height_rad)
                else:
                    loops[each.name] = self.loop.step(old, each, at.height_rad) if _in_sight(each, now) else old
        known = [
            loop
            for each in now.objects
            if (loop := loops.get(each.name)) and each.until_s > now.time_s and self.ambient.sure(loop.peak) and _in_sight(each, now)
        ]
        doubtful = [loop.recent for loop in known if self.method == "ambient" or self.loop.at_limit(loop)]
        return ObjectBasedState(self.ambient.step(state.ambient, [loop.recent for loop in known], doubtful), loops)

    def adapted(self, state: ObjectBasedState, now: Situation) -> tuple[Primitives, ...]:
        """The primitives of each object: its light and its dark part."""
        parts: list[Primitives] = []
        for each in self.lit(now):
            share = fade(now.time_s, each.since_s, each.until_s, 0.0, self.fade_out_s)
            if share:
                parts += self.light.on(each, now.lamps, share * self.lx(state, each), self.priority, now.mask_layer(each), self.modules)
        return tuple(parts)

    def lit(self, now: Situation) -> tuple[TrackedObject, ...]:
        """The selected objects, on which it sets the light; none where it dims the base beam alone."""
        return () if self.method == "ambient" else self.select(now)

    def base_share(self, state: ObjectBasedState) -> float:
        return state.share

    def lx(self, state: ObjectBasedState, each: TrackedObject) -> float:
        """Setpoint of an object in lx."""
        if self.method == "constant":
            return self.setpoint_lx
        if self.method == "class":
            return self.setpoints_lx.get(each.category, self.setpoint_lx)
        loop = state.loops.get(each.name)
        return self.loop.first_lx if loop is None else loop.lx


def _in_sight(each: TrackedObject, now: Situation) -> bool:
    """Whether the camera sees the centre of an object; True without a camera."""
    if now.seen is None:
        return True
    middle = each.T_world_object[:3, 3:] + each.T_world_object[:3, 2:3] * each.size_m[2] / 2
    (u, v), depth = now.seen.view.project(middle)
    return bool(depth > 0) and 0 <= float(u) < now.seen.view.width and 0 <= float(v) < now.seen.view.height
