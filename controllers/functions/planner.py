"""The planner: base beam and lighting functions, composed for one moment into primitives (T 4.1, 7.2.2)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, cast

import torch
from pydantic import AfterValidator, Field, TypeAdapter
from torch import Tensor

from luxloop.controllers.functions.base_beams import BaseBeam, BaseBeamParams, PaintedParams, PaintLayer, RawParams, paint_layers
from luxloop.controllers.functions.commands import (
    BendingParams,
    CommandingFunction,
    DimmingParams,
    DirectParams,
    FunctionCommands,
    LevellingParams,
    Movable,
)
from luxloop.controllers.functions.material import MaterialParams
from luxloop.controllers.functions.object_based import ObjectBasedParams
from luxloop.controllers.functions.objects import GlareFreeParams, MarkerParams, SignParams
from luxloop.controllers.functions.own import OwnFunction, own_function
from luxloop.controllers.functions.path import LaneParams, PathParams, WidthParams
from luxloop.controllers.functions.symbol import PrimitiveParams, SymbolFunctionParams
from luxloop.controllers.functions.zone import ZoneParams
from luxloop.controllers.pixels.primitives import Primitives, concatenate
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import AdaptiveFunction, Indicator, LightingFunction, Situation
from luxloop.world.errors import locate
from luxloop.world.params import Params, PlainName
from luxloop.world.plugin import OWN, KnownOrOwn
from luxloop.world.symbols import SymbolSource, load

FunctionParams = Annotated[
    GlareFreeParams
    | MarkerParams
    | SignParams
    | SymbolFunctionParams
    | PrimitiveParams
    | PathParams
    | LaneParams
    | WidthParams
    | ObjectBasedParams
    | MaterialParams
    | ZoneParams
    | BendingParams
    | LevellingParams
    | DimmingParams
    | DirectParams
    | OwnFunction,
    KnownOrOwn("kind"),
]
ORDER: Final = (  # from top to bottom, for functions of equal priority that overlap
    ("glare_free",),
    ("symbol",),
    ("primitive",),
    (OWN,),
    ("path", "lane", "width"),
    ("marker",),
    ("sign",),
    ("object_based",),
    ("zone", "material"),
    ("bending", "levelling", "dimming", "command"),  # these draw nothing
)


def in_order(functions: Mapping[str, FunctionParams]) -> dict[str, FunctionParams]:
    """Functions from top to bottom: by ORDER, symbols with a controller before other symbols, equal ones by name."""
    rank = {kind: k for k, kinds in enumerate(ORDER) for kind in kinds}

    def place(item: tuple[str, FunctionParams]) -> tuple[int, bool, str]:
        name, function = item
        return rank.get(function.kind, rank[OWN]), getattr(function, "controller", None) is None, name

    return dict(sorted(functions.items(), key=place))


Functions = Annotated[Mapping[PlainName, FunctionParams], AfterValidator(in_order)]
States = Mapping[str, Any]  # by function name; None for functions without state


class LightingParams(Params):
    """The base beam, and settings that hold for all lighting functions of the car."""

    base: BaseBeamParams = Field(BaseBeamParams(), description="the light on which all functions are drawn")
    indicator: Indicator = Field("off", description="direction indicator, for functions with `indicated`; `hazard` indicates both sides")
    raw: tuple[RawParams, ...] = Field((), description="pixel utilisations from files that replace the base beam")
    painted: tuple[PaintedParams, ...] = Field((), description="painted pixel utilisations, over or instead of the functions' light")
    power_limit: float | None = Field(None, gt=0, le=1, description="power limit of a lamp, as a share of all pixels on; left out: none")
    share: bool = Field(True, description="modules that reach the same point share its illuminance, so that light is not doubled")
    street_lamps: bool = Field(False, description="subtract the light of street lamps from setpoints")
    shadow_rays: bool = Field(
        False, description="other lamps compensate for one that an object blocks; what the observer cannot see is not lit"
    )


@dataclass(frozen=True, eq=False)
class Plan:
    """The light of the lamps at one time. primitives: None if no function draws, for the base beam alone. painted: layers by module."""

    time_s: float
    base: BaseBeam
    primitives: Primitives | None
    painted: Mapping[str, PaintLayer] = field(default_factory=dict)

    def for_module(self, name: str) -> Primitives | None:
        """The primitives of a module, named by itself, its lamp or both ("left hires"); None without any."""
        mine = None if self.primitives is None else self.primitives.for_module(name)
        return mine if mine is not None and len(mine) else None


@dataclass(frozen=True, eq=False)
class Planner:
    """The functions of a scenario by name, from top to bottom, with their symbol images."""

    functions: Mapping[str, LightingFunction | AdaptiveFunction]
    lighting: LightingParams
    symbols: Mapping[str, SymbolSource]
    dtype: torch.dtype = torch.float32

    @classmethod
    def prepare(
        cls,
        functions: Mapping[str, Any],
        lighting: LightingParams,
        find: Callable[[str], Path] = Path,
        dtype: torch.dtype = torch.float32,
    ) -> "Planner":
        """Load every symbol once. functions: parameters, or tables as in scenario files, by name. find: returns the path of a shipped
        symbol's name or of a path.

        Raises pydantic's ValidationError for a bad table, and LuxloopError that names the key of a bad symbol or of a user-defined function
        that cannot be made.
        """
        valid = all(isinstance(each, Params) for each in functions.values())
        ordered, symbols = in_order(functions) if valid else TypeAdapter(Functions).validate_python(functions), dict[str, SymbolSource]()
        made: dict[str, LightingFunction | AdaptiveFunction] = {}
        for name, function in ordered.items():
            with locate(f"functions.{name}"):
                made[name] = own_function(function) if isinstance(function, OwnFunction) else function
            if (image := getattr(function, "image", None)) and image not in symbols:
                with locate(f"functions.{name}.image"):
                    symbols[image] = load(find(image))
        return cls(made, lighting, symbols, dtype)

    @cached_property
    def adaptive(self) -> Mapping[str, AdaptiveFunction]:
        """The functions whose state depends on camera frames, by name."""
        return {
            name: each for name, each in self.functions.items() if isinstance(each, AdaptiveFunction) and getattr(each, "adaptive", True)
        }

    @cached_property
    def painted(self) -> Mapping[str, PaintLayer]:
        """The painted layers, by module."""
        return paint_layers(self.lighting.painted)

    def paint(self, module: str, light: Utilisation, limit: Tensor | float = 1.0) -> Utilisation:
        """The light of a module under its painted layer. limit: as of `PaintLayer.on`."""
        return self.painted[module].on(light, limit) if module in self.painted else light

    @cached_property
    def commanding(self) -> Mapping[str, CommandingFunction]:
        """The functions that command modules, by name."""
        return {
            name: each
            for name, each in self.functions.items()
            if isinstance(each, CommandingFunction) and getattr(each, "commanding", True)
        }

    @property
    def learns(self) -> bool:
        """Whether any function depends on earlier frames."""
        return bool(self.adaptive)

    def start(self) -> States:
        """The states before the first frame."""
        return {name: self.adaptive[name].start() if name in self.adaptive else None for name in self.functions}

    def step(self, states: States, now: Situation) -> States:
        """The states after `now.seen`."""
        now = replace(now, symbols=dict(self.symbols))
        stepped = {}
        for name in self.functions:
            with locate(f"functions.{name}"):
                stepped[name] = self.adaptive[name].step(states[name], now) if name in self.adaptive else None
        return stepped

    def command(self, given: Mapping[str, FunctionCommands], now: Situation, modules: Sequence[Movable]) -> Mapping[str, FunctionCommands]:
        """The present commands of all functions for the car's modules, by function. given: the previous commands."""
        found = {}
        for name, each in self.commanding.items():
            with locate(f"functions.{name}"):
                found[name] = each.command(given.get(name), now, modules)
        return found

    def draw(self, now: Situation, states: States) -> dict[str, tuple[Primitives, ...]]:
        """The primitives of each function."""
        lights = [each for each in self.functions.values() if isinstance(each, ObjectBasedParams)]
        lit = frozenset(each.name for light in lights for each in light.lit(now) if each.present(now.time_s))
        now = replace(now, symbols=dict(self.symbols), lit=lit)
        found = {}
        for name, function in self.functions.items():
            with locate(f"functions.{name}"):
                learns = self.adaptive.get(name)
                found[name] = cast(LightingFunction, function).primitives(now) if learns is None else learns.adapted(states[name], now)
        return found

    def plan(self, now: Situation, states: States | None = None) -> Plan:
        """Compose the primitives of all functions into a plan. states: of the adaptive functions, by default the initial states."""
        states = self.start() if states is None else states
        return self.compose(now, states, self.draw(now, states))

    def compose(self, now: Situation, states: States, drawn: Mapping[str, Sequence[Primitives]]) -> Plan:
        """Compose the functions' primitives, given by name. Masks of road users override all else. Otherwise the higher priority wins where
        two overlap, and at equal priority the one that `in_order` puts on top.
        """
        parts = [primitives for name in reversed(tuple(self.functions)) for primitives in drawn.get(name, ())]
        base = self.lighting.base.at(now)
        base = replace(base, share=self._base_share(states, base.share))
        if not parts:
            return Plan(now.time_s, base, None, self.painted)
        primitives = concatenate(*parts).to(self.dtype)
        shared = replace(primitives, shared=primitives.shared & self.lighting.share)
        return Plan(now.time_s, base, shared, self.painted)

    def _base_share(self, states: States, default: float) -> float:
        asked = (each.base_share(states[name]) for name, each in self.adaptive.items())
        return max((share for share in asked if share is not None), default=default)
