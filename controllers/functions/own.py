"""A user-defined lighting function, named in the scenario by `package.module:Name`."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any

from luxloop.controllers.functions.commands import FunctionCommands, Movable
from luxloop.controllers.pixels.primitives import QUANTITIES, Primitives, names_module
from luxloop.controllers.situation import Situation
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import ModuleCommand

KEY = "kind"
METHODS = ("primitives",)
ADAPTIVE = ("start", "step", "adapted", "base_share")
SHARE = QUANTITIES.index("u_abs")


class OwnFunction(plugin.OwnPart):
    """A user-defined function: `Name(**options)`."""


def own_function(params: OwnFunction) -> "CheckedFunction":
    """Import and construct the function. Raises LuxloopError if it does not exist, refuses its options or lacks a method."""
    return function_of(plugin.load(params.kind, KEY, ()), params)


def function_of(made_by: type, params: OwnFunction) -> "CheckedFunction":
    """As `own_function`, for a class that is already imported."""
    adaptive = any(hasattr(made_by, method) for method in ADAPTIVE)
    plugin.check_methods(made_by, f"{KEY}: {params.kind}", ADAPTIVE if adaptive else METHODS)
    own = plugin.construct(made_by, params.kind, KEY, {}, params.options)
    return CheckedFunction(own, adaptive, hasattr(own.part, "commands"))


@dataclass(frozen=True)
class CheckedFunction:
    """A user-defined function whose results are checked. adaptive: whether it closes a loop over camera frames. commanding: whether it
    commands modules.

    All methods raise LuxloopError if the function fails.
    """

    own: plugin.Guard
    adaptive: bool
    commanding: bool

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """Raises LuxloopError if the result is not a list of primitives that lamps can draw."""
        return check_primitives(self.own.primitives(now), self.own, "primitives")

    def start(self) -> Any:
        """The state before the first frame."""
        return self.own.start()

    def step(self, state: Any, now: Situation) -> Any:
        """The state after a frame."""
        return self.own.step(state, now)

    def adapted(self, state: Any, now: Situation) -> tuple[Primitives, ...]:
        """Raises LuxloopError if the result is not a list of primitives that lamps can draw."""
        return check_primitives(self.own.adapted(state, now), self.own, "adapted")

    def base_share(self, state: Any) -> float | None:
        """Raises LuxloopError if the result is not a share of the base beam."""
        share = self.own.base_share(state)
        if share is not None and not (isinstance(share, int | float) and 0 <= share <= 1):
            raise LuxloopError(
                f"{KEY}: {self.own.name}: base_share gives {share!r}; give a share of the base beam, 0..1, or None for no demand"
            )
        return share

    def command(self, before: FunctionCommands | None, now: Situation, modules: Sequence[Movable]) -> FunctionCommands:
        """The commands by module. Raises LuxloopError if the function's `commands` returns no commands, or names unknown modules."""
        given = self.own.commands(now)
        if not isinstance(given, Mapping) or not all(isinstance(name, str) and _possible(each) for name, each in given.items()):
            raise LuxloopError(
                f"{KEY}: {self.own.name}: commands gives {given!r}; give luxloop.ModuleCommand by names of lamps or modules, of finite "
                "angles in deg and an intensity of 0 to 1"
            )
        for name in given:
            if not any(names_module((name,), module.name) for module in modules):
                known = ", ".join(module.name for module in modules)
                raise LuxloopError(f"{KEY}: {self.own.name}: commands the module {name!r}, which is not there; there are {known}")
        return FunctionCommands(
            now.time_s, tuple((module.name, given[name]) for module in modules for name in given if names_module((name,), module.name))
        )


def _possible(command: Any) -> bool:
    return isinstance(command, ModuleCommand) and all(map(math.isfinite, astuple(command))) and 0 <= command.intensity <= 1


def check_primitives(parts: Any, own: plugin.Guard, method: str) -> tuple[Primitives, ...]:
    """The primitives that a method of a user-defined function returned. Raises LuxloopError if lamps cannot draw them."""
    where = f"{KEY}: {own.name}: {method}"
    listed = isinstance(parts, tuple | list)
    if not listed or not all(isinstance(each, Primitives) for each in parts):
        what = f"list of {', '.join(type(each).__name__ for each in parts)}" if listed else type(parts).__name__
        raise LuxloopError(f"{where} gives a {what}; give a list of values made by luxloop.rectangle; an empty one draws nothing")
    for each in parts:
        if each.origin.ndim != 2:
            raise LuxloopError(f"{where} gives corners {list(each.origin.shape)}; give rectangles [P, 3] without batch dimensions")
        if not all(bool(value.isfinite().all()) for value in (each.origin, each.d1, each.d2, each.normal, each.value)):
            raise LuxloopError(f"{where} gives positions or setpoints that are not finite; leave out what should not be drawn")
        shares = each.value[each.quantity == SHARE]
        if bool((each.value < 0).any()) or bool((shares > 1).any()):
            raise LuxloopError(
                f'{where} gives the setpoint {float(each.value.max()):g}; give 0 to 1 for the quantity "u_abs", no less than 0 for others: '
                '"I_v" in cd, "E_v" in lx, "u_rel" as a multiple of the base beam'
            )
    return tuple(parts)
