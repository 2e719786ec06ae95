"""The car's lamps: modules with pixel controllers and base beams, how a scenario's are built, and their utilisations and powers."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import torch
from torch import Tensor

from luxloop.controllers.functions.base_beams import BaseBeam, RawParams
from luxloop.controllers.functions.planner import Plan
from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.controllers.pixels.jpo import Jpo, JpoParams
from luxloop.controllers.pixels.morphing import Morphing
from luxloop.controllers.pixels.mrpc import limit_power
from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import Primitives, names_module
from luxloop.controllers.pixels.secondary import SecondaryRays, scene_caster
from luxloop.controllers.pixels.ssc import PixelController, Ssc, Utilisation
from luxloop.controllers.pixels.windows import projected_windows
from luxloop.controllers.situation import LAYERS, SOFT_MASK, Situation
from luxloop.loop.scenario.model import HeadlightParams, Scenario
from luxloop.loop.scenario.shipped import find_file
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.truth import LampModule
from luxloop.loop.simulation.world import World
from luxloop.perception.egomotion import Ego
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.frames import inverse, pose_from_degrees, transform
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Commands, Lamp, Module, ModuleCommand, Range, pixel_area
from luxloop.world.lamps.description import Side, load_lamp
from luxloop.world.lamps.utilisations import RawUtilisation, read_sequence
from luxloop.world.regulation import Result, check_beam
from luxloop.world.scene.scene import StreetLamp

Lights = tuple[Utilisation, ...]  # one a module


@dataclass(frozen=True, eq=False)
class MountedModule:
    """A lamp's module on the car.

    number: index in the lamp. headlight: light at the scenario's intensity. T_world_module: pose `[4, 4]` at rest. swivel_deg, level_deg:
    smallest and largest turn from rest.
    """

    side: str
    lamp: Lamp
    number: int
    headlight: Headlight
    T_world_module: Tensor
    swivel_deg: Range
    level_deg: Range

    @property
    def name(self) -> str:
        """Name in lighting functions, such as "left hires"."""
        return f"{self.side} {self.lamp.modules[self.number].name}"


class Beams:
    """Beams of a lamp's module by name, each made on first use, as a fit takes half a second. Raises LuxloopError for an unknown beam."""

    def __init__(self, lamp: Lamp, number: int, headlight: Headlight) -> None:
        self._lamp, self._number, self._headlight = lamp, number, headlight
        self._made: dict[str, Morphing] = {}

    def __getitem__(self, name: str) -> Morphing:
        if name not in self._made:
            beam = self._lamp.beam(name)[self._number].to(self._headlight.matrix.values)
            self._made[name] = Morphing(self._headlight, beam)
        return self._made[name]


@dataclass(frozen=True, eq=False)
class ShiningModule(MountedModule):
    """A module with its pixel controller. beams: digital movement of the lamp's beams. raw: what it shows in place of a base beam.

    intensity: commanded dimming, 0..1.
    """

    controller: PixelController
    beams: Beams
    raw: RawUtilisation | None = None
    intensity: float = 1.0

    @property
    def flux(self) -> Tensor:
        """Luminous flux in lm of each pixel at full utilisation, `[n_p]`, also the measure of power."""
        return self.headlight.pixel_flux

    @property
    def flux_lm(self) -> float:
        """Luminous flux at full utilisation."""
        return float(self.flux.sum())

    def under(self, command: ModuleCommand) -> "ShiningModule":
        """The module turned and dimmed by a command."""
        return replace(self, T_world_module=command.turn(self.T_world_module), intensity=command.intensity)

    def beam(self, name: str) -> Tensor:
        """Utilisation `[n_p]` of a lamp's beam. Raises LuxloopError for an unknown beam."""
        return self.beams[name].beam

    def showing(self, beam: str) -> "ShiningModule":
        """The module with this base beam alone. Raises LuxloopError for an unknown beam."""
        self.lamp.require_beam(beam)
        return replace(self, raw=None)

    def base(self, plan: Plan) -> Tensor:
        """Utilisation `[n_p]` below all functions: raw, else the base beam, morphed and dimmed."""
        if self.raw is not None:
            return self.raw.at(plan.time_s).to(self.headlight.matrix.values)
        beam = plan.base
        still = beam == BaseBeam(beam.name, share=beam.share, rest=beam.rest)

        def shown(name: str) -> Tensor:
            moved = self.beams[name]
            return moved.beam if still else moved.utilisation(beam.morph)

        if beam.share == 1:
            return shown(beam.name)
        dimmed = beam.share * shown(beam.name)
        return dimmed if beam.rest == "off" else dimmed + (1 - beam.share) * shown(beam.rest)

    def utilisation(self, plan: Plan, secondary: SecondaryRays) -> Utilisation:
        """Utilisation from base beam, functions and painted pictures. secondary: secondary rays of this module."""
        base, primitives, layer = self.base(plan), plan.for_module(self.name), plan.painted.get(self.name)
        if primitives is None or (layer is not None and not layer.over):
            light = Utilisation(base, slice(0, 0) if self.raw is None and plan.base.name == plan.base.rest == "off" else None)
        else:
            light = self.controller.over(base).utilisation(primitives.to(base.device), self.T_world_module, secondary)
        return light if layer is None else layer.on(light, self.mask_limit(plan) if layer.over else 1.0)

    def mask_limit(self, plan: Plan) -> Tensor:
        """Largest utilisation `[n_p]` that masks and their soft zones leave."""
        full, drawn = torch.ones_like(self.flux), plan.for_module(self.name)
        masks = None if drawn is None else drawn.select(drawn.priority >= SOFT_MASK * LAYERS)
        return self.controller.over(full).utilisation(masks.to(full.device), self.T_world_module).u if masks else full


@dataclass(frozen=True)
class LampPower:
    """Flux and power of a lamp.

    share: flux relative to all pixels on. factor: dimming by the power limit, 1 without. watts: electrical power. flux_lm_peak: flux of
    the brightest exposure.
    """

    flux_lm: float
    share: float
    factor: float
    watts: float
    flux_lm_peak: float


def mean_powers(powers: Sequence[Mapping[str, LampPower]], shares: Sequence[float]) -> Mapping[str, LampPower]:
    """Time means over exposures by lamp side, with the smallest factor and largest peak."""

    def of(lamps: Sequence[LampPower]) -> LampPower:
        mean = {key: sum(s * getattr(each, key) for s, each in zip(shares, lamps, strict=True)) for key in ("flux_lm", "share", "watts")}
        return LampPower(**mean, factor=min(each.factor for each in lamps), flux_lm_peak=max(each.flux_lm_peak for each in lamps))

    return {side: of([each[side] for each in powers]) for side in powers[0]}


def under(modules: tuple[ShiningModule, ...], commands: Commands) -> tuple[ShiningModule, ...]:
    """Modules turned and dimmed by commands, unchanged without commands."""
    return tuple(each.under(command) for each, command in zip(modules, commands, strict=True)) if commands else modules


def in_reach(modules: Sequence[ShiningModule], primitives: Primitives, now: Situation) -> bool:
    """Whether a ray of any module can hit one of its primitives."""
    for module, (_, light) in zip(modules, now.lights, strict=True):
        mine = primitives.for_module(module.name)
        if any(not window.empty for window in projected_windows(mine, module.headlight, light.T_world_headlight.cpu())):
            return True
    return False


def lamp_modules(modules: Iterable[MountedModule]) -> tuple[LampModule, ...]:
    """The modules as `LampModule`s for a plant."""
    return tuple(LampModule(each.name, each.headlight, each.T_world_module) for each in modules)


def flux_by_side(modules: Sequence[ShiningModule], lights: Sequence[Tensor]) -> dict[str, float]:
    """Flux in lm of each lamp; lights: utilisations `[n_p]`, one a module."""
    sides = dict.fromkeys((module.side for module in modules), 0.0)
    for module, u in zip(modules, lights, strict=True):
        sides[module.side] += float((u * module.flux).sum())
    return sides


def _flux_lm(light: Utilisation, flux: Tensor) -> float:
    """Flux of a light in lm. flux: `[n_p]` lm of each pixel. Sums only pixels that may be lit."""
    lit = slice(None) if light.band is None else light.band
    return float(light.u[lit] @ flux[lit])


@dataclass(frozen=True, eq=False)
class LampDriver:
    """Drives all modules within the power limit. world: the true world, for street lamps and shadow rays."""

    scenario: Scenario
    modules: tuple[ShiningModule, ...]
    world: World | None

    def aim(self, now: Situation) -> list[ShiningModule]:
        """Modules at the poses and intensities of a situation."""
        return [
            replace(module, T_world_module=light.T_world_headlight, intensity=light.intensity)
            for module, (_, light) in zip(self.modules, now.lights, strict=True)
        ]

    def failures(self, plan: Plan, rule: str) -> tuple[Result, ...]:
        """A rule's requirements that the undimmed base beam of a lamp fails, those of the lamp that fails more."""
        base, failures = replace(plan, base=plan.base.undimmed), list[tuple[Result, ...]]()
        for side in dict.fromkeys(module.side for module in self.modules):
            mine = [module for module in self.modules if module.side == side]
            lamp = Lamp(side, tuple(Module(each.name, each.headlight, each.T_world_module) for each in mine))
            found = check_beam(lamp.lit([each.base(base) for each in mine]), rule)
            failures.append(tuple(each for each in found if each.verdict == "fail"))
        return max(failures, key=len)

    def drive(
        self, plan: Plan, now: Situation, more: tuple[Plan, tuple[Utilisation, ...]] | None = None
    ) -> tuple[tuple[Utilisation, ...], Mapping[str, LampPower]]:
        """Utilisations of all modules and powers by lamp, within the power limit if any.

        more: a plan with all primitives of this plan and possibly more, and its light, reused by modules without additional primitives.
        """
        params, modules = self.scenario.lighting, self.aim(now)
        street_lamps: tuple[StreetLamp, ...] = ()
        occluded = None
        if self.world is not None and (params.street_lamps or params.shadow_rays):
            T_world_ground = self.world.motion.at(now.time_s).T_world_ground
            for lamp in self.world.scene.street_lamps if params.street_lamps else ():
                place = transform(inverse(T_world_ground), torch.tensor([lamp.position_m], dtype=torch.float64).T)[:, 0].tolist()
                street_lamps += (lamp.model_copy(update={"position_m": tuple(place)}),)
            occluded = scene_caster(self.world.lit(now.time_s).triangles, T_world_ground) if params.shadow_rays else None
        known = [None] * len(modules) if more is None or params.power_limit is not None else more[1]
        wanted = {
            module.name: light
            if more is not None and light is not None and _drawn(more[0], module) == _drawn(plan, module)
            else module.utilisation(plan, SecondaryRays(now.lights, own, street_lamps, occluded))
            for own, (module, light) in enumerate(zip(modules, known, strict=True))
        }
        limited, factors = [], {}
        for side in dict.fromkeys(module.side for module in modules):
            mine = [module for module in modules if module.side == side]
            shown, factors[side] = [wanted[module.name] for module in mine], 1.0
            if params.power_limit is not None:
                flux = torch.cat([module.intensity * module.flux for module in mine])
                most = sum(each.flux_lm for each in mine) * params.power_limit
                u, least = limit_power(torch.cat([each.u for each in shown]), flux, most)
                parts, factors[side] = u.split([len(module.flux) for module in mine]), float(least)
                shown = [Utilisation(part, each.band) for part, each in zip(parts, shown, strict=True)]
            limited += shown
        return tuple(limited), self.powers(modules, limited, factors)

    def powers(
        self, modules: Sequence[ShiningModule], lights: Sequence[Utilisation], factors: Mapping[str, float]
    ) -> Mapping[str, LampPower]:
        """Power of each lamp. lights: of the modules. factors: dimming by the power limit, by lamp."""
        found, params = {}, self.scenario.headlight
        for side, factor in factors.items():
            mine = [(module, light) for module, light in zip(modules, lights, strict=True) if module.side == side]
            total, at_full_current = (
                sum(module.intensity * _flux_lm(Utilisation(of(light.u), light.band), module.flux) for module, light in mine)
                for of in (lambda u: u, params.at_full_current)
            )
            watts = params.power_w(at_full_current)
            found[side] = LampPower(total, total / sum(each.flux_lm for each, _ in mine), factor, watts, total)
        return found


def _drawn(plan: Plan, module: ShiningModule) -> int:
    """Number of primitives that a module draws."""
    return len(plan.for_module(module.name) or ())


def attitude(ego: Ego | None) -> Tensor:
    """Measured pose `[4, 4]` of the body in the ground frame, level without a measurement."""
    if ego is None or math.isnan(ego.attitude_s):
        return torch.eye(4, dtype=torch.float64)
    return ego.at(ego.time_s).T_ground_body.double().cpu()


PartOfLamp = TypeVar("PartOfLamp", Lamp, Module)
PIXEL_METHODS = ("headlight", "default", "utilisation", "over")


def mount(params: HeadlightParams, device: str = "cpu") -> tuple[MountedModule, ...]:
    """The shining modules of a scenario's lamps, all by default.

    Raises LuxloopError for an unknown lamp or module, an impossible movement, modules without light, and lamps that get too hot.
    """
    return tuple(module for side in params.lamps for module in _of_side(side, params, torch.device(device)))


def _of_side(side: Side, params: HeadlightParams, device: torch.device) -> Sequence[MountedModule]:
    lamp = load_lamp(params.model, side)
    with locate("headlight.modules"):
        modules = lamp.modules if params.modules is None else tuple(lamp.module(name) for name in params.modules)
    names = ", ".join(module.name for module in modules)
    if params.swivel_deg and not any(any(module.swivel_deg) for module in modules):
        raise LuxloopError(f"headlight.swivel_deg: none of the modules ({names}) can swivel; leave it out or name others")
    peak_cd = max(module.headlight.peak_cd for module in modules)
    if not peak_cd > 0:
        raise LuxloopError(f"headlight.modules: {names} give no light; name others")
    scale = 1.0 if params.intensity_cd is None else params.intensity_cd / peak_cd
    mounts = []
    for module in modules:
        rest, number = turn_part(module, side, params), [each.name for each in lamp.modules].index(module.name)
        T_world_module = (T_world_lamp(side, params) @ rest.T_lamp_module).to(device)
        light = module.headlight.scale(scale).to(device)
        mounts.append(MountedModule(side, lamp, number, light, T_world_module, rest.swivel_deg, rest.level_deg))
    params.power_w(sum(float(each.headlight.pixel_flux.sum()) for each in mounts))  # refuses a lamp that gets too hot in full light
    return mounts


def T_world_lamp(side: str, params: HeadlightParams) -> Tensor:
    """Pose `[4, 4]` of a lamp on the car."""
    return pose_from_degrees((0.0, (0.5 if side == "left" else -0.5) * params.distance_m, params.height_m))


def T_world_reference(sides: Iterable[str], params: HeadlightParams) -> Tensor:
    """Pose `[4, 4]` from which angles count: of the only lamp, or midway between both."""
    return torch.stack([T_world_lamp(each, params) for each in sides]).mean(0)


def turn_part(part: PartOfLamp, side: str, params: HeadlightParams) -> PartOfLamp:
    """A lamp or module turned by the scenario's angles. Raises LuxloopError, with the lamp's side, beyond its range."""
    try:
        return part.turn(params.swivel_deg, params.level_deg)
    except LuxloopError as error:
        mirrored = "; a right lamp is the left one's mirror image, and so is its range" if side == "right" else ""
        raise LuxloopError(f"headlight: {side} lamp, {error}{mirrored}") from error


def shining_module(scenario: Scenario, module: MountedModule, cache: PartCache) -> ShiningModule:
    """A module with its pixel controller and beams. Raises LuxloopError for a missing or broken file of raw utilisations, or a user's
    pixel controller that cannot be made.
    """
    light, name = module.headlight, module.name
    raw = cache(f"{name}: raw", _raw, scenario.lighting.raw, name, light)
    beams = cache(f"{name}: beams", Beams, module.lamp, module.number, light)
    controller = cache(f"{name}: pixel controller", pixel_controller, light, scenario.pixel_controller, scenario.ssc, scenario.jpo)

    def shining(mount: MountedModule, controller: PixelController, beams: Beams, raw: RawUtilisation | None) -> ShiningModule:
        return ShiningModule(**vars(mount), controller=controller, beams=beams, raw=raw)

    return cache(f"{name}: module", shining, module, controller, beams, raw)


def _raw(given: Sequence[RawParams], module: str, headlight: Headlight) -> RawUtilisation | None:
    """The raw utilisations of a module, None without any. Raises LuxloopError, with key and file, if they do not fit the module."""
    for i, raw in enumerate(given):
        if names_module(raw.modules, module):
            with locate(f"lighting.raw[{i}].file, for module {module!r} (its modules say which are meant)"):
                file = find_file(raw.file, "utilisations")
                return read_sequence(file, headlight.pixel_rows, headlight.pixel_cols, raw.rate_hz, raw.repeat)
    return None


def pixel_controller(headlight: Headlight, name: str, ssc: MrpcParams, jpo: JpoParams) -> PixelController:
    """The pixel controller of a name for one headlight, over a dark base pattern.

    A user's class, "package.module:Name", is made by `Name.prepare(headlight)`.
    Raises LuxloopError for a missing class, or if it cannot be made.
    """
    if name == "ssc":
        return Ssc.prepare(headlight, ssc)
    if name == "jpo":
        return Jpo.prepare(headlight, jpo, mrpc=ssc)
    key, own = "pixel_controller", plugin.Name(name)
    made_by = plugin.load(own, key, ("prepare", "utilisation", "over"))
    with plugin.running(own, key, "prepare"):
        made = made_by.prepare(headlight)
    if lacking := [part for part in PIXEL_METHODS if not hasattr(made, part)]:
        raise LuxloopError(f"{key}: {name} has no {lacking[0]!r}; write one as in docs/python.md")
    return cast(PixelController, plugin.Guard(made, own, key))


def drawing_modules(function: SymbolFunctionParams, modules: Sequence[MountedModule]) -> tuple[int, ...]:
    """Indices of the modules that draw a closed-loop symbol: the named modules, else the finest module of the first lamp."""
    if function.modules:
        return tuple(k for k, each in enumerate(modules) if names_module(function.modules, each.name))
    first = [k for k, each in enumerate(modules) if each.side == modules[0].side]
    return (min(first, key=lambda k: pixel_area(modules[k].headlight)),)
