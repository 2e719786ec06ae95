"""A lighting function of the user's own, named in the scenario by `package.module:Name`."""

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from typing import Any

from pydantic import Field

from controllers.functions.commands import Given
from controllers.pixels.primitives import QUANTITIES, Primitives
from controllers.situation import AdaptiveFunction, LightingFunction, Situation
from world import plugin
from world.errors import LuxloopError
from world.headlight.lamp import ModuleCommand
from world.params import Params

KEY = "kind"
METHODS = ("primitives",)
ADAPTIVE = ("start", "step", "adapted", "base_share")
SHARE = QUANTITIES.index("u_abs")


class OwnFunction(Params):
    """`Name(**options)` of a module of the user's own makes the function."""

    kind: plugin.OwnName
    options: dict[str, Any] = Field({}, description="keyword arguments of Name")


def own_function(params: OwnFunction) -> LightingFunction | AdaptiveFunction:
    """Import and make it. Raises LuxloopError where there is none, it does not take its options, or lacks a method."""
    return function_of(plugin.load(params.kind, KEY, ()), params)


def function_of(made_by: type, params: OwnFunction) -> "CheckedFunction | CheckedAdaptive":
    """The same of a class that is at hand."""
    learns = any(hasattr(made_by, method) for method in ADAPTIVE)
    plugin.check_methods(made_by, f"{KEY}: {params.kind}", ADAPTIVE if learns else METHODS)
    own = plugin.made(made_by, params.kind, KEY, {}, params.options)
    return CheckedAdaptive(own) if learns else CheckedFunction(own)


@dataclass(frozen=True)
class CheckedFunction:
    """The user's own function, whose primitives are checked."""

    own: plugin.Guarded

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """Raises LuxloopError where it fails, or gives something else."""
        return checked(self.own.primitives(now), self.own, "primitives")


@dataclass(frozen=True)
class CheckedAdaptive:
    """One that learns from what is seen, whose primitives are checked."""

    own: plugin.Guarded

    def start(self) -> Any:
        """Its state before anything is seen."""
        return self.own.start()

    def step(self, state: Any, now: Situation) -> Any:
        """Its state after a frame."""
        return self.own.step(state, now)

    def adapted(self, state: Any, now: Situation) -> tuple[Primitives, ...]:
        """Raises LuxloopError where it fails, or gives something else."""
        return checked(self.own.adapted(state, now), self.own, "adapted")

    def base_share(self, state: Any) -> float | None:
        """Raises LuxloopError where that is no share."""
        share = self.own.base_share(state)
        if share is not None and not (isinstance(share, int | float) and 0 <= share <= 1):
            raise LuxloopError(
                f"{KEY}: {self.own.name}: base_share gives {share!r}; give 0..1 of the base beam, or None for what others want"
            )
        return share


def own_commands(function: Any) -> Any:
    """What commands modules of a function: of one of the user's own its `commands`, if it has any; of others the function itself."""
    own = getattr(function, "own", None)
    if not isinstance(own, plugin.Guarded):
        return function
    return OwnCommands(own) if hasattr(own.part, "commands") else None


@dataclass(frozen=True)
class OwnCommands:
    """The `commands` of the user's own function, by names of lamps and modules, which are checked."""

    own: plugin.Guarded

    def commanded(self, before: Given | None, now: Situation) -> Given:
        """Raises LuxloopError where it fails, or gives something else."""
        given = self.own.commands(now)
        if not isinstance(given, Mapping) or not all(isinstance(name, str) and _possible(each) for name, each in given.items()):
            raise LuxloopError(
                f"{KEY}: {self.own.name}: commands gives {given!r}; give luxloop.ModuleCommand by names of lamps or modules, of finite "
                "angles in deg and an intensity of 0 to 1"
            )
        return Given(now.time_s, tuple(((name,), each) for name, each in given.items()))


def _possible(command: Any) -> bool:
    return isinstance(command, ModuleCommand) and all(map(math.isfinite, astuple(command))) and 0 <= command.intensity <= 1


def checked(parts: Any, own: plugin.Guarded, method: str) -> tuple[Primitives, ...]:
    """Raises LuxloopError where parts are no primitives that lamps can draw."""
    where = f"{KEY}: {own.name}: {method}"
    if not isinstance(parts, tuple | list) or not all(isinstance(each, Primitives) for each in parts):
        what = (
            type(parts).__name__ if not isinstance(parts, tuple | list) else f"list of {', '.join(type(each).__name__ for each in parts)}"
        )
        raise LuxloopError(f"{where} gives a {what}; give a list of what luxloop.rectangle makes, an empty one where nothing is drawn")
    for each in parts:
        if each.origin.ndim != 2:
            raise LuxloopError(
                f"{where} gives corners {list(each.origin.shape)}; give rectangles [P, 3], for one situation there is no batch"
            )
        if not all(bool(value.isfinite().all()) for value in (each.origin, each.d1, each.d2, each.normal, each.value)):
            raise LuxloopError(f"{where} gives places or setpoints that are not finite; leave out what is not to be drawn")
        shares = each.value[each.quantity == SHARE]
        if bool((each.value < 0).any()) or bool((shares > 1).any()):
            raise LuxloopError(
                f'{where} gives the setpoint {float(each.value.max()):g}; give 0 to 1 for the quantity "u_abs", no less than 0 for others: '
                '"I_v" in cd, "E_v" in lx, "u_rel" as a multiple of the base beam'
            )
    return tuple(parts)
