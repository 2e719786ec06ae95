"""The planner: base beam and lighting functions, composed for one moment into primitives (T 4.1, 7.2.2)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import Field

from controllers.functions.base_beams import BaseBeam, BaseBeamParams, RawParams
from controllers.functions.glare_free import GlareFreeParams
from controllers.functions.lane import LaneParams, WidthParams
from controllers.functions.marker import MarkerParams
from controllers.functions.path import PathParams
from controllers.functions.sign import SignParams
from controllers.functions.symbol import SymbolFunctionParams
from controllers.obl.function import ObjectBasedParams
from controllers.pixels.primitives import Primitives, concatenate
from controllers.situation import AdaptiveFunction, LightingFunction, Situation
from controllers.zones.material import MaterialParams
from controllers.zones.zone import ZoneParams
from world.errors import located
from world.params import Params
from world.symbols import SymbolSource, load

FunctionParams = Annotated[
    GlareFreeParams
    | MarkerParams
    | SignParams
    | SymbolFunctionParams
    | PathParams
    | LaneParams
    | WidthParams
    | ObjectBasedParams
    | MaterialParams
    | ZoneParams,
    Field(discriminator="kind"),
]


States = tuple[Any, ...]  # of all functions, by their place in the scenario; None of those that learn nothing


class LightingParams(Params):
    """All light of the car: a base beam, and functions on top of it."""

    base: BaseBeamParams = Field(BaseBeamParams(), description="the light below all functions")
    raw: tuple[RawParams, ...] = Field((), description="utilisations of pixels that take the place of the base beam")
    functions: tuple[FunctionParams, ...] = Field((), description="lighting functions; of equal priority, later ones lie on top")
    power_limit: float | None = Field(None, gt=0, le=1, description="largest power of a lamp, as a share of all pixels on; none: unlimited")
    share: bool = Field(True, description="modules that reach a point share its illuminance, so that light is not doubled")
    street_lamps: bool = Field(False, description="take off what street lamps give already")
    shadow_rays: bool = Field(
        False, description="lamps that an object blocks are made up for by others; what an observer cannot see is off"
    )


@dataclass(frozen=True, eq=False)
class Plan:
    """What the lamps shall do at one moment. primitives: None where no function has anything to do, then the base beam is all."""

    time_s: float
    base: BaseBeam
    primitives: Primitives | None

    def for_module(self, name: str) -> Primitives | None:
        """What a module may draw, by its name, its lamp's, or both ("left hires"); None where that is nothing."""
        mine = None if self.primitives is None else self.primitives.for_module(name)
        return mine if mine is not None and len(mine) else None


@dataclass(frozen=True, eq=False)
class Planner:
    """The functions of a scenario with the symbols that they draw."""

    params: LightingParams
    symbols: Mapping[str, SymbolSource]
    dtype: torch.dtype = torch.float32

    @classmethod
    def prepare(cls, params: LightingParams, find: Callable[[str], Path] = Path, dtype: torch.dtype = torch.float32) -> "Planner":
        """Load every symbol once. find: turns the name of a shipped symbol or a path into a path.

        Raises LuxloopError that names the key of a bad one.
        """
        symbols: dict[str, SymbolSource] = {}
        for number, function in enumerate(params.functions):
            if (image := getattr(function, "image", None)) and image not in symbols:
                with located(f"lighting.functions[{number}].image"):
                    symbols[image] = load(find(image))
        return cls(params, symbols, dtype)

    @property
    def functions(self) -> tuple[LightingFunction | AdaptiveFunction, ...]:
        return self.params.functions

    @property
    def learns(self) -> bool:
        """Whether any function depends on what was seen before."""
        return any(isinstance(function, AdaptiveFunction) for function in self.functions)

    def start(self) -> States:
        """Before anything is seen."""
        return tuple(function.start() if isinstance(function, AdaptiveFunction) else None for function in self.functions)

    def step(self, states: States, now: Situation) -> States:
        """What the functions have learnt once `now.seen` has come."""
        now = replace(now, symbols=dict(self.symbols))
        stepped = []
        for number, (function, state) in enumerate(zip(self.functions, states, strict=True)):
            with located(f"lighting.functions[{number}]"):
                stepped.append(function.step(state, now) if isinstance(function, AdaptiveFunction) else None)
        return tuple(stepped)

    def drawn(self, now: Situation, states: States) -> tuple[tuple[Primitives, ...], ...]:
        """The primitives of each function."""
        now = replace(now, symbols=dict(self.symbols))
        found = []
        for number, (function, state) in enumerate(zip(self.functions, states, strict=True)):
            with located(f"lighting.functions[{number}]"):
                found.append(function.adapted(state, now) if isinstance(function, AdaptiveFunction) else function.primitives(now))
        return tuple(found)

    def plan(self, now: Situation, states: States | None = None) -> Plan:
        """Compose all functions. Masks of road users beat everything else; else the higher priority wins where two lie in one place.

        states: what the functions have learnt; left out: nothing.
        """
        states = self.start() if states is None else states
        parts = [primitives for each in self.drawn(now, states) for primitives in each]
        base = replace(self.params.base.at(now), share=self._base_share(states))
        if not parts:
            return Plan(now.time_s, base, None)
        primitives = concatenate(*parts).to(self.dtype)
        return Plan(now.time_s, base, replace(primitives, shared=primitives.shared & self.params.share))

    def _base_share(self, states: Sequence[Any]) -> float:
        asked = (each.base_share(state) for each, state in zip(self.functions, states, strict=True) if isinstance(each, AdaptiveFunction))
        return max((share for share in asked if share is not None), default=1.0)
