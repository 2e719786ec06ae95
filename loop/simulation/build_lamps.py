"""Builds the lamps of a scenario: mounted and turned modules, beams, raw utilisations and pixel controllers."""

from collections.abc import Iterable, Sequence
from typing import TypeVar, cast

import torch
from torch import Tensor

from luxloop.controllers.functions.base_beams import RawParams
from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.controllers.pixels.jpo import Jpo, JpoParams
from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import names_module
from luxloop.controllers.pixels.ssc import PixelController, Ssc
from luxloop.loop.scenario.model import HeadlightParams, Scenario
from luxloop.loop.scenario.shipped import find_file
from luxloop.loop.simulation.lamps import Beams, MountedModule, ShiningModule
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, Module, pixel_area
from luxloop.world.lamps.description import Side, load_lamp
from luxloop.world.lamps.utilisations import RawUtilisation, read_sequence

PartOfLamp = TypeVar("PartOfLamp", Lamp, Module)
PIXEL_METHODS = ("headlight", "default", "utilisation", "over")


def mount(params: HeadlightParams, device: str = "cpu") -> tuple[MountedModule, ...]:
    """The shining modules of a scenario's lamps, all by default.

    Raises LuxloopError for an unknown lamp or module, an impossible movement, and modules without light.
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
