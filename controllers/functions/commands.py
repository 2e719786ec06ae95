"""Functions that command modules instead of drawing: mechanical bending and levelling, and dimming (T 3.4, 4.1)."""

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal, Protocol, Self, runtime_checkable

import numpy as np
from pydantic import Field, model_validator

from luxloop.controllers.functions.base_beams import bend_of_course
from luxloop.controllers.pixels.primitives import Primitives, names_module
from luxloop.controllers.situation import ScheduleParams, Situation
from luxloop.world.headlight.lamp import REST, Commands, ModuleCommand, Range
from luxloop.world.params import Degrees, NotNegative, Params, Share, Slope, ascending

Movement = Literal["swivel_deg", "level_deg", "intensity"]
MOVEMENTS: Final[Mapping[Movement, str]] = {"swivel_deg": "swivelled", "level_deg": "levelled", "intensity": "dimmed"}


class Movable(Protocol):
    """A module: name, such as "left hires", and ranges of swivel and level from rest, in deg."""

    @property
    def name(self) -> str: ...

    @property
    def swivel_deg(self) -> Range: ...

    @property
    def level_deg(self) -> Range: ...


@dataclass(frozen=True)
class FunctionCommands:
    """Commands of a function at a time, by module."""

    time_s: float
    commands: tuple[tuple[str, ModuleCommand], ...]


@runtime_checkable
class CommandingFunction(Protocol):
    """A function that commands modules."""

    def command(self, before: FunctionCommands | None, now: Situation, modules: Sequence[Movable]) -> FunctionCommands:
        """The present commands for the car's modules. before: the function's previous commands, None at the start."""
        ...


class CommandParams(ScheduleParams):
    """Common parameters of the functions that command modules."""

    movements: ClassVar[tuple[Movement, ...]] = tuple(MOVEMENTS)
    modules: tuple[str, ...] = Field((), description="lamps or modules to command; left out: all that support the command")

    @abstractmethod
    def active_command(self, now: Situation) -> ModuleCommand:
        """The command while the function is active."""

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """No primitives: the function draws nothing."""
        return ()

    def command(self, before: FunctionCommands | None, now: Situation, modules: Sequence[Movable]) -> FunctionCommands:
        """The command of each module; rest while the function is not active."""
        command = self.active_command(now) if self.active(now) else REST
        return FunctionCommands(now.time_s, tuple((module.name, command) for module in modules if self.moves(module)))

    def moves(self, module: Movable) -> bool:
        """Whether the function commands this module and the module supports the command."""
        return names_module(self.modules, module.name)


class TurningParams(CommandParams):
    """Common parameters of the functions that turn modules."""

    rate_deg_s: float

    @abstractmethod
    def target_deg(self, now: Situation) -> float:
        """The target angle."""

    def active_command(self, now: Situation) -> ModuleCommand:
        """The target angle, without a motor's limits."""
        return ModuleCommand(**{self.movements[0]: self.target_deg(now)})

    def moves(self, module: Movable) -> bool:
        """Whether the function commands this module and the module can turn."""
        return super().moves(module) and any(getattr(module, self.movements[0]))

    def command(self, before: FunctionCommands | None, now: Situation, modules: Sequence[Movable]) -> FunctionCommands:
        """The target angle within each module's range, limited by the motors' rate from the previous command on."""
        angle = self.movements[0]
        ranges = {module.name: getattr(module, angle) for module in modules}
        was = {} if before is None else dict(before.commands)
        far = 0.0 if before is None else self.rate_deg_s * max(now.time_s - before.time_s, 0.0)
        given = []
        for name, command in super().command(before, now, modules).commands:
            low, high = ranges[name]
            wanted = min(max(getattr(command, angle), low), high)  # before the rate limit, or a motor at its end would wind up
            begins = getattr(was[name], angle) if name in was else wanted
            given.append((name, ModuleCommand(**{angle: min(max(wanted, begins - far), begins + far)})))
        return FunctionCommands(now.time_s, tuple(given))


class BendingParams(TurningParams):
    """Swivels modules into curves by the speed and the curvature of the car's course."""

    movements: ClassVar[tuple[Movement, ...]] = ("swivel_deg",)
    kind: Literal["bending"] = "bending"
    look_ahead_s: float = Field(2.0, gt=0, le=5, description="travel time to the point on the course at which modules aim")
    largest_deg: float = Field(15.0, gt=0, le=30, description="limit of the swivel; each module's own range limits it as well")
    rate_deg_s: float = Field(25.0, gt=0, le=1000, description="rate of the swivel motors")

    def target_deg(self, now: Situation) -> float:
        bend = math.degrees(bend_of_course(now.curvature_1_m, self.look_ahead_s * now.speed_m_s))
        return min(max(bend, -self.largest_deg), self.largest_deg)


class LevelAtParams(Params):
    """A levelling angle at a time."""

    time_s: NotNegative = Field(0.0, description="time of this entry")
    level_deg: float = Field(0.0, ge=-10, le=10, description="turned down")


class LevellingParams(TurningParams):
    """Levels modules against the pitch of the body, so that the cut-off stays in place on the road."""

    movements: ClassVar[tuple[Movement, ...]] = ("level_deg",)
    kind: Literal["levelling"] = "levelling"
    dynamic: bool = Field(True, description="compensate the measured pitch of the body")
    entries: Annotated[tuple[LevelAtParams, ...], ascending("time_s")] = Field(
        (), description="additional angles over ascending time; linear in between, constant outside"
    )
    rate_deg_s: float = Field(20.0, gt=0, le=1000, description="rate of the levelling motors")

    @model_validator(mode="after")
    def _levels(self) -> Self:
        if not (self.dynamic or self.entries):
            raise ValueError("entries: with dynamic = false and no entries nothing is levelled; give entries, or leave dynamic out")
        return self

    def target_deg(self, now: Situation) -> float:
        fixed = over_time(self.entries, now.time_s, "level_deg") if self.entries else 0.0
        return fixed - (math.degrees(now.pitch_rad) if self.dynamic else 0.0)


class IntensityAtParams(Params):
    """A maximum intensity at a time."""

    time_s: NotNegative = Field(0.0, description="time of this entry")
    share: Share = Field(examples=[0.5], description="share of a module's maximum intensity")


class DimmingParams(CommandParams):
    """Lowers the maximum intensity of modules over time."""

    movements: ClassVar[tuple[Movement, ...]] = ("intensity",)
    kind: Literal["dimming"] = "dimming"
    entries: Annotated[tuple[IntensityAtParams, ...], ascending("time_s")] = Field(
        min_length=1, examples=[[{"share": 0.5}]], description="maximum intensity over ascending time; linear in between, constant outside"
    )

    def active_command(self, now: Situation) -> ModuleCommand:
        return ModuleCommand(intensity=over_time(self.entries, now.time_s, "share"))


class DirectParams(CommandParams):
    """Commands modules directly, without a rate limit, for example from another program in each step."""

    kind: Literal["command"] = "command"
    modules: tuple[str, ...] = Field((), description="lamps or modules to command; left out: all")
    swivel_deg: Degrees = Field(0.0, description="turned to the left; limited by each module's own range")
    level_deg: Slope = Field(0.0, description="turned down; limited by each module's own range")
    intensity: Share = Field(1.0, description="share of the maximum intensity")

    def active_command(self, now: Situation) -> ModuleCommand:
        return ModuleCommand(self.swivel_deg, self.level_deg, self.intensity)


def compose(given: Iterable[FunctionCommands], modules: Iterable[Movable]) -> Commands:
    """One command for each module from the commands of all functions: turns add up within the module's range, intensities multiply."""
    of_all, commands = [command for each in given for command in each.commands], []
    for module in modules:
        mine = [command for name, command in of_all if name == module.name]
        swivel, level = (
            min(max(sum(getattr(each, key) for each in mine), low), high)
            for key, (low, high) in (("swivel_deg", module.swivel_deg), ("level_deg", module.level_deg))
        )
        commands.append(ModuleCommand(swivel, level, math.prod(each.intensity for each in mine)))
    return tuple(commands)


def over_time(entries: Sequence[Any], time_s: float, key: str) -> float:
    """Linear interpolation of a key between entries in ascending `time_s`, constant outside."""
    return float(np.interp(time_s, [each.time_s for each in entries], [getattr(each, key) for each in entries]))
