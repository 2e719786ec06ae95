"""The car's lamps, ready to be driven: every module that shines, with its pixel controller and its base beams."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from controllers.functions.base_beams import BaseBeam
from controllers.morphing import Morphing, over
from controllers.mrpc import MrpcParams
from controllers.planner import Plan
from controllers.power import limit_power, pixel_flux
from controllers.secondary import SecondaryRays
from controllers.ssc import Ssc
from loop.build import turned
from loop.lamp_description import load_lamp
from loop.scenario import CarLampsParams
from world.errors import LuxloopError
from world.frames import pose_from_degrees
from world.headlight import Headlight
from world.lamp import Lamp


@dataclass(frozen=True, eq=False)
class ShiningModule:
    """One module of a lamp. number: its place in the lamp. flux: `[n_p]` lm at full utilisation, which stands for power as well."""

    side: str
    lamp: Lamp
    number: int
    ssc: Ssc
    T_world_module: Tensor
    flux: Tensor
    _straight: dict[str, Tensor] = field(default_factory=dict, init=False, repr=False)
    _morphings: dict[str, Morphing] = field(default_factory=dict, init=False, repr=False)

    @property
    def name(self) -> str:
        """As lighting functions name it, "left hires"."""
        return f"{self.side} {self.lamp.modules[self.number].name}"

    @property
    def headlight(self) -> Headlight:
        return self.ssc.headlight

    def base(self, beam: BaseBeam) -> Tensor:
        """Utilisation `[n_p]` of a base beam, morphed. Raises LuxloopError where the lamp has no such beam."""
        name = beam.name
        if name not in self._straight:
            self._straight[name] = self.lamp.beam(name)[self.number].to(self.flux)
        if beam == BaseBeam(name):
            return self._straight[name]
        if name not in self._morphings:
            self._morphings[name] = Morphing.prepare(self.headlight, self._straight[name])
        return self._morphings[name].utilisation(beam.morph)

    def utilisation(self, plan: Plan, secondary: SecondaryRays) -> Tensor:
        """Utilisation `[n_p]` of base beam and functions; secondary: what this module's rays ask where they hit."""
        base, primitives = self.base(plan.base), plan.for_module(self.name)
        if primitives is None:
            return base
        return over(self.ssc, base).utilisation(primitives.to(base.device), self.T_world_module, secondary).u


@dataclass(frozen=True)
class LampPower:
    """What a lamp gives: flux in lm, power as a share of all pixels on, and the factor by which its limit has dimmed it."""

    flux_lm: float
    share: float
    factor: float


def shining_modules(params: CarLampsParams, ssc: MrpcParams, device: torch.device) -> tuple[ShiningModule, ...]:
    """All modules of a scenario's lamps. Raises LuxloopError where there is no such lamp, module or movement."""
    return tuple(module for side in params.lamps for module in _modules_of(side, params, ssc, device))


def _modules_of(side: str, params: CarLampsParams, ssc: MrpcParams, device: torch.device) -> Iterator[ShiningModule]:
    lamp = load_lamp(params.model, "left" if side == "left" else "right")
    names = [module.name for module in lamp.modules]
    chosen = [lamp.module(name) for name in params.modules or names]
    peak_cd = max(module.headlight.peak_cd for module in chosen)
    if not peak_cd > 0:
        raise LuxloopError(f"headlight.modules: {', '.join(module.name for module in chosen)} give no light; name others")
    scale = 1.0 if params.intensity_cd is None else params.intensity_cd / peak_cd
    T_world_lamp = pose_from_degrees((0.0, (0.5 if side == "left" else -0.5) * params.distance_m, params.height_m))
    for module in chosen:
        T_world_module = T_world_lamp @ turned(module, side, params).T_lamp_module
        light = module.headlight.scaled(scale).to(device)
        yield ShiningModule(side, lamp, names.index(module.name), Ssc.prepare(light, ssc), T_world_module.to(device), pixel_flux(light))


def driven(
    modules: Sequence[ShiningModule], plan: Plan, secondary: Sequence[SecondaryRays], power_limit: float | None
) -> tuple[tuple[Tensor, ...], Mapping[str, LampPower]]:
    """Utilisations `[n_p]`, one a module, and the power of each lamp by its side, within the limit if there is one.

    secondary: of each module.
    """
    asks = dict(zip((module.name for module in modules), secondary, strict=True))
    lights, powers = [], {}
    for side in dict.fromkeys(module.side for module in modules):
        mine = [module for module in modules if module.side == side]
        u = torch.cat([module.utilisation(plan, asks[module.name]) for module in mine])
        flux = torch.cat([module.flux for module in mine])
        u, factor = limit_power(u, flux, flux.sum() * (1.0 if power_limit is None else power_limit))
        total = float((u * flux).sum())
        powers[side] = LampPower(total, total / float(flux.sum()), float(factor))
        lights += u.split([len(module.flux) for module in mine])
    return tuple(lights), powers
