"""Functions that command modules in place of drawing: mechanical bending and levelling, and dimming (T 3.4, 4.1)."""

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, Final, Literal, Protocol, Self, runtime_checkable

import numpy as np
from pydantic import Field, model_validator

from controllers.functions.base_beams import bend_of_course
from controllers.pixels.primitives import Primitives, meant
from controllers.situation import Situation, Timed
from world.headlight.lamp import REST, Commands, ModuleCommand, Range
from world.params import Params

Movement = Literal["swivel_deg", "level_deg", "intensity"]
MOVED: Final[Mapping[Movement, str]] = {"swivel_deg": "swivelled", "level_deg": "levelled", "intensity": "dimmed"}


class Movable(Protocol):
    """A module by its name ("left hires"), with what it can be turned by from its rest, least and most."""

    @property
    def name(self) -> str: ...

    @property
    def swivel_deg(self) -> Range: ...

    @property
    def level_deg(self) -> Range: ...


@dataclass(frozen=True)
class Given:
    """What a function commanded at a time: each command with the lamps or modules that it is for, all where none are named."""

    time_s: float
    commands: tuple[tuple[tuple[str, ...], ModuleCommand], ...]


@runtime_checkable
class CommandingFunction(Protocol):
    """A function that commands modules."""

    def commanded(self, before: Given | None, now: Situation) -> Given:
        """What it commands now. before: what it did last, None of one that begins."""
        ...


class CommandParams(Timed):
    """What all functions have that command modules."""

    movement: ClassVar[Movement]
    modules: tuple[str, ...] = Field((), description="lamps or modules that it commands; left out: all that can do so")

    @abstractmethod
    def wanted(self, now: Situation) -> float:
        """What it wants of its movement."""

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """None: it draws nothing."""
        return ()

    def commanded(self, before: Given | None, now: Situation) -> Given:
        """What it wants, at rest while it is not active."""
        wanted = self.wanted(now) if self.active(now.time_s) else getattr(REST, self.movement)
        return self._given(now.time_s, wanted)

    def _given(self, time_s: float, value: float) -> Given:
        return Given(time_s, ((self.modules, ModuleCommand(**{self.movement: value})),))

    def moves(self, module: Movable) -> bool:
        """Whether it means a module that can do so."""
        return meant(self.modules, module.name) and (self.movement == "intensity" or any(getattr(module, self.movement)))


class TurningParams(CommandParams):
    """What functions have that turn modules."""

    rate_deg_s: float

    def commanded(self, before: Given | None, now: Situation) -> Given:
        """What it wants, as far as its motors get from where they were; one that begins is there."""
        given = super().commanded(before, now)
        if before is None:
            return given
        was, wanted = (getattr(each.commands[0][1], self.movement) for each in (before, given))
        far = self.rate_deg_s * max(now.time_s - before.time_s, 0.0)
        return self._given(now.time_s, min(max(wanted, was - far), was + far))


class BendingParams(TurningParams):
    """Swivels modules into curves, by speed and curvature of the car's course."""

    movement: ClassVar[Movement] = "swivel_deg"
    kind: Literal["bending"] = "bending"
    look_ahead_s: float = Field(2.0, gt=0, le=5, description="how far ahead modules point, as time at the car's speed")
    largest_deg: float = Field(15.0, gt=0, le=30, description="swivels no further than this, nor than a module can")
    rate_deg_s: float = Field(25.0, gt=0, le=1000, description="how fast motors swivel")

    def wanted(self, now: Situation) -> float:
        bend = math.degrees(bend_of_course(now.curvature_1_m, self.look_ahead_s * now.speed_m_s))
        return min(max(bend, -self.largest_deg), self.largest_deg)


class LevelAtParams(Params):
    """An angle of levelling at a time."""

    time_s: float = Field(0.0, ge=0, le=1e6, description="time of this entry")
    level_deg: float = Field(0.0, ge=-10, le=10, description="turned down")


class LevellingParams(TurningParams):
    """Levels modules against the pitch of the body, so that the cut-off stays where it is on the road."""

    movement: ClassVar[Movement] = "level_deg"
    kind: Literal["levelling"] = "levelling"
    dynamic: bool = Field(True, description="turns against the measured pitch of the body")
    entries: tuple[LevelAtParams, ...] = Field((), description="angles over ascending time, in addition; even in between, constant outside")
    rate_deg_s: float = Field(20.0, gt=0, le=1000, description="how fast motors level")

    @model_validator(mode="after")
    def _levels(self) -> Self:
        if not (self.dynamic or self.entries):
            raise ValueError("entries: nothing is levelled without them where dynamic is false; give some, or leave dynamic out")
        return _ascending(self)

    def wanted(self, now: Situation) -> float:
        fixed = over_time(self.entries, now.time_s, "level_deg") if self.entries else 0.0
        return fixed - (math.degrees(now.pitch_rad) if self.dynamic else 0.0)


class IntensityAtParams(Params):
    """A maximum intensity at a time."""

    time_s: float = Field(0.0, ge=0, le=1e6, description="time of this entry")
    share: float = Field(ge=0, le=1, description="share of a module's maximum intensity")


class DimmingParams(CommandParams):
    """Lowers the maximum intensity of modules over time."""

    movement: ClassVar[Movement] = "intensity"
    kind: Literal["dimming"] = "dimming"
    entries: tuple[IntensityAtParams, ...] = Field(
        min_length=1, description="maximum intensity over ascending time; even in between, constant outside"
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        return _ascending(self)

    def wanted(self, now: Situation) -> float:
        return over_time(self.entries, now.time_s, "share")


def composed(given: Iterable[Given], modules: Iterable[Movable]) -> Commands:
    """One command a module of what all functions give: turns add up, as far as a module can be turned, and intensities multiply."""
    of_all, commands = [command for each in given for command in each.commands], []
    for module in modules:
        mine = [command for names, command in of_all if meant(names, module.name)]
        swivel, level = (
            min(max(sum(getattr(each, key) for each in mine), low), high)
            for key, (low, high) in (("swivel_deg", module.swivel_deg), ("level_deg", module.level_deg))
        )
        commands.append(ModuleCommand(swivel, level, math.prod(each.intensity for each in mine)))
    return tuple(commands)


def over_time(entries: Sequence[Any], time_s: float, key: str) -> float:
    """A value between entries in ascending `time_s`."""
    return float(np.interp(time_s, [each.time_s for each in entries], [getattr(each, key) for each in entries]))


def _ascending(params: Any) -> Any:
    times = [each.time_s for each in params.entries]
    if any(later <= earlier for earlier, later in pairwise(times)):
        raise ValueError(f"entries: time_s must ascend from entry to entry, here {times}")
    return params
