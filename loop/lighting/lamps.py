"""The car's lamps, ready to be driven: every module that shines, with its pixel controller and its base beams."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from controllers.functions.base_beams import BaseBeam
from controllers.functions.planner import Plan
from controllers.pixels.morphing import Morphing
from controllers.pixels.power import limit_power, pixel_flux
from controllers.pixels.primitives import meant
from controllers.pixels.secondary import SecondaryRays
from controllers.pixels.ssc import PixelController
from loop.assembly.build import turned
from loop.assembly.pixel_control import pixel_controller
from loop.scenario.model import LightingScenario
from loop.scenario.shipped import named
from world.errors import LuxloopError, located
from world.frames import pose_from_degrees
from world.headlight import Headlight
from world.headlight.lamp import Lamp
from world.lampfiles.description import load_lamp
from world.lampfiles.utilisations import RawUtilisation, read_sequence


@dataclass(frozen=True, eq=False)
class ShiningModule:
    """One module of a lamp. number: its place in the lamp. flux: `[n_p]` lm at full utilisation, which stands for power as well.

    beams: all that its base beam may come to, by name; none where it shows raw utilisations.
    """

    side: str
    lamp: Lamp
    number: int
    controller: PixelController
    T_world_module: Tensor
    flux: Tensor
    beams: Mapping[str, Morphing]
    raw: RawUtilisation | None = None

    @property
    def name(self) -> str:
        """As lighting functions name it, "left hires"."""
        return f"{self.side} {self.lamp.modules[self.number].name}"

    @property
    def headlight(self) -> Headlight:
        return self.controller.headlight

    def base(self, plan: Plan) -> Tensor:
        """Utilisation `[n_p]` below all functions: the raw one, else a base beam, morphed and dimmed."""
        if self.raw is not None:
            return self.raw.at(plan.time_s).to(self.flux)
        beam = plan.base
        moved = self.beams[beam.name]
        return beam.share * (moved.beam if beam == BaseBeam(beam.name, share=beam.share) else moved.utilisation(beam.morph))

    def utilisation(self, plan: Plan, secondary: SecondaryRays) -> Tensor:
        """Utilisation `[n_p]` of base beam and functions; secondary: what this module's rays ask where they hit."""
        base, primitives = self.base(plan), plan.for_module(self.name)
        if primitives is None:
            return base
        return self.controller.over(base).utilisation(primitives.to(base.device), self.T_world_module, secondary).u


@dataclass(frozen=True)
class LampPower:
    """What a lamp gives and takes: flux in lm, power as a share of all pixels on, the factor by which its limit dims it, and watts."""

    flux_lm: float
    share: float
    factor: float
    watts: float


def shining_modules(scenario: LightingScenario, device: torch.device) -> tuple[ShiningModule, ...]:
    """All modules of a scenario's lamps. Raises LuxloopError where there is no such lamp, module, beam or movement."""
    return tuple(module for side in scenario.headlight.lamps for module in _modules_of(side, scenario, device))


def _modules_of(side: str, scenario: LightingScenario, device: torch.device) -> Iterator[ShiningModule]:
    params = scenario.headlight
    lamp = load_lamp(params.model, "left" if side == "left" else "right")
    names = [module.name for module in lamp.modules]
    if strange := [name for name in params.modules or () if name not in names]:
        raise LuxloopError(
            f"headlight.modules: lamp {params.model!r} has no module {strange[0]!r}, it has {', '.join(names)}; name these here, and in "
            "the modules of lighting.functions and lighting.raw"
        )
    chosen = [lamp.module(name) for name in params.modules or names]
    peak_cd = max(module.headlight.peak_cd for module in chosen)
    if not peak_cd > 0:
        raise LuxloopError(f"headlight.modules: {', '.join(module.name for module in chosen)} give no light; name others")
    scale = 1.0 if params.intensity_cd is None else params.intensity_cd / peak_cd
    T_world_lamp = pose_from_degrees((0.0, (0.5 if side == "left" else -0.5) * params.distance_m, params.height_m))
    for module in chosen:
        T_world_module = T_world_lamp @ turned(module, side, params).T_lamp_module
        light = module.headlight.scaled(scale).to(device)
        controller, raw = pixel_controller(scenario, light), _raw(scenario, f"{side} {module.name}", light)
        number, flux = names.index(module.name), pixel_flux(light)
        base = scenario.lighting.base.names if raw is None else ()
        beams: dict[str, Morphing] = {name: Morphing(controller.headlight, lamp.beam(name)[number].to(flux)) for name in base}
        yield ShiningModule(side, lamp, number, controller, T_world_module.to(device), flux, beams, raw)


def _raw(scenario: LightingScenario, name: str, headlight: Headlight) -> RawUtilisation | None:
    """The raw utilisations of a module. Raises LuxloopError that names the key and the file where they are not its own."""
    mine = [(i, raw) for i, raw in enumerate(scenario.lighting.raw) if meant(raw.modules, name)]
    if len(mine) > 1:
        both = " and ".join(f"lighting.raw[{i}]" for i, _ in mine[:2])
        raise LuxloopError(f"{both} are both meant for module {name!r}; name the modules of each in its modules")
    for i, raw in mine:
        with located(f"lighting.raw[{i}].file, for module {name!r} (its modules say which are meant)"):
            file = named(raw.file, "utilisations")
            return read_sequence(file, headlight.pixel_rows, headlight.pixel_cols, raw.rate_hz, raw.repeat)
    return None


def flux_by_side(modules: Sequence[ShiningModule], lights: Sequence[Tensor]) -> dict[str, float]:
    """Flux in lm of each lamp; lights: utilisations `[n_p]`, one a module."""
    sides = dict.fromkeys((module.side for module in modules), 0.0)
    for module, u in zip(modules, lights, strict=True):
        sides[module.side] += float((u * module.flux).sum())
    return sides


def driven(
    modules: Sequence[ShiningModule],
    plan: Plan,
    secondary: Sequence[SecondaryRays],
    power_limit: float | None,
    power_w: Callable[[float], float],
) -> tuple[tuple[Tensor, ...], Mapping[str, LampPower]]:
    """Utilisations `[n_p]`, one a module, and the power of each lamp by its side, within the limit if there is one.

    secondary: of each module. power_w: electrical power of a lamp that gives so many lm.
    """
    asks = dict(zip((module.name for module in modules), secondary, strict=True))
    lights, powers = [], {}
    for side in dict.fromkeys(module.side for module in modules):
        mine = [module for module in modules if module.side == side]
        u = torch.cat([module.utilisation(plan, asks[module.name]) for module in mine])
        flux = torch.cat([module.flux for module in mine])
        u, factor = limit_power(u, flux, flux.sum() * (1.0 if power_limit is None else power_limit))
        total = float((u * flux).sum())
        powers[side] = LampPower(total, total / float(flux.sum()), float(factor), power_w(total))
        lights += u.split([len(module.flux) for module in mine])
    return tuple(lights), powers
