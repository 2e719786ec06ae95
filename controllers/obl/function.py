"""Object-based lighting: the road stays nearly dark, and each object gets as much light as a detector benefits from (T 9.3)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from pydantic import Field, field_validator

from luxloop.controllers.obl.ambient import Ambient, AmbientLoopParams
from luxloop.controllers.obl.apparent import Apparent
from luxloop.controllers.obl.light import ObjectLightParams
from luxloop.controllers.obl.object_loop import ObjectLoop, ObjectLoopParams
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.situation import SelectionParams, Situation, TrackedObject, fade
from luxloop.perception.tracking import LINGER_S
from luxloop.world.traffic.tracked import Category


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
    method: Literal["confidence", "class", "constant"] = Field(
        "confidence",
        description="`confidence`: loops on a detector's confidence; `class`: a setpoint for each class; `constant`: one setpoint for all",
    )
    categories: tuple[Category, ...] = Field(
        ("pedestrian", "cyclist", "car", "animal", "truck", "motorcycle"), min_length=1, description="classes of objects that it lights"
    )
    ambient: AmbientLoopParams = Field(AmbientLoopParams(), description="loop of the base beam, for `confidence`")
    loop: ObjectLoopParams = Field(ObjectLoopParams(), description="loop of each object, for `confidence`")
    share: float = Field(0.2, ge=0, le=1, description="share of the base beam, for `class` and `constant`")
    setpoint_lx: float = Field(
        10.0, ge=0, le=1e6, description="setpoint on each object, for `constant`, and for classes without one of their own"
    )
    setpoints_lx: dict[Category, Annotated[float, Field(ge=0, le=1e6)]] = Field(
        {"pedestrian": 10.0, "cyclist": 10.0, "animal": 15.0, "car": 3.0, "truck": 3.0, "motorcycle": 5.0},
        description="setpoints on objects by their class, for `class`",
    )
    light: ObjectLightParams = Field(ObjectLightParams(), description="where and how objects are lit")
    fade_out_s: float = Field(0.6, ge=0, le=LINGER_S, description="time until the light on a vanished object is off")
    priority: int = Field(20, ge=0, le=100, description="where functions overlap, the higher priority is drawn")
    modules: tuple[str, ...] = Field((), description="lamps or modules that draw it; left out: all")

    @field_validator("setpoints_lx")
    @classmethod
    def _not_negative(cls, setpoints_lx: dict[Category, float]) -> dict[Category, float]:
        for category, lx in setpoints_lx.items():
            if lx < 0:
                raise ValueError(f"{category}: {lx:g} lx is negative; give 0 or more")
        return setpoints_lx

    def start(self) -> ObjectBasedState:
        return ObjectBasedState(Ambient(self.ambient.first if self.method == "confidence" else self.share))

    def step(self, state: ObjectBasedState, now: Situation) -> ObjectBasedState:
        """The state after one more frame; objects that the tracker no longer reports are dropped.

        A new object at the place of a lost one is taken for it and continues its loop.
        """
        if self.method != "confidence":
            return state
        objects = self.selected(now)
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
        doubtful = [loop.recent for loop in known if self.loop.exhausted(loop)]
        return ObjectBasedState(self.ambient.step(state.ambient, [loop.recent for loop in known], doubtful), loops)

    def adapted(self, state: ObjectBasedState, now: Situation) -> tuple[Primitives, ...]:
        """The primitives of each object: its light and its dark part."""
        parts: list[Primitives] = []
        for nearer, each in enumerate(sorted(self.selected(now), key=now.distance_m)):
            share = fade(now.time_s, each.since_s, each.until_s, 0.0, self.fade_out_s)
            if share:
                parts += self.light.on(each, now.lamps, share * self.lx(state, each), self.priority, nearer, self.modules)
        return tuple(parts)

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
    """Whether the camera sees its centre; true without a camera."""
    if now.seen is None:
        return True
    middle = each.T_world_object[:3, 3:] + each.T_world_object[:3, 2:3] * each.size_m[2] / 2
    (u, v), depth = now.seen.view.project(middle)
    return bool(depth > 0) and 0 <= float(u) < now.seen.view.width and 0 <= float(v) < now.seen.view.height
