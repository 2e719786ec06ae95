"""From a scenario to the things it names: scene, lamps, symbol."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import torch

from controllers.symbol import build_controller
from controllers.symbol.heights.feedforward import FeedforwardParams
from controllers.symbol.sensing.observer import Observer
from controllers.symbol.sensing.projector import DrawingModule, Projector
from controllers.symbol.sensing.protocol import SymbolController
from loop.assembly.pixel_control import pixel_controller
from loop.scenario import data
from loop.scenario.model import HeadlightParams, Scenario, WorldScenario
from loop.scenario.shipped import named
from perception.camera import camera_view
from world.errors import LuxloopError, located
from world.frames import pose_from_degrees
from world.headlight.lamp import Lamp, Module
from world.lampfiles.description import load_lamp
from world.materials.spots import SpottedTexture
from world.roads.base import Road
from world.roads.mesh import road_mesh
from world.roads.scan import OpenCrgRoad
from world.scene.body import Body
from world.scene.figure import Figure
from world.scene.road_tiles import RoadTiles
from world.scene.scene import Scene
from world.scene.vehicle import STANDING, Motion, drive
from world.symbols import load_still
from world.traffic.objects import ObjectParams

TurnedPart = TypeVar("TurnedPart", Lamp, Module)


def build_road(scenario: WorldScenario) -> Road:
    """The road, with its file found. Raises LuxloopError where that is not on this machine."""
    return _located(scenario.road)


def build_motion(scenario: Scenario) -> Motion:
    """The drive, over half a period more than all steps. Raises LuxloopError where a file is missing or broken."""
    if scenario.vehicle is None:
        return STANDING
    return drive(scenario.vehicle, build_road(scenario), (scenario.steps + 1) / scenario.rate_hz)


def build_scene(scenario: WorldScenario, motion: Motion = STANDING) -> Scene:
    """Road, along the vehicle's course, and objects. Raises LuxloopError where a file is missing or broken."""
    road, surface = build_road(scenario), scenario.surface
    texture = SpottedTexture(surface, scenario.spots) if scenario.spots else surface.texture()
    ground: Body | RoadTiles
    if motion is STANDING:
        ground = Body("road", road_mesh(road), surface.albedo, texture, smooth=True)
    else:
        ground = RoadTiles(road, motion.range_y_m, surface.albedo, texture)
    objects = tuple(_built(item, road) for item in scenario.all_objects)
    return Scene((ground, *objects), scenario.light.ambient_lx, scenario.light.street_lamps)


def _built(item: ObjectParams, road: Road) -> Body | Figure:
    body = item.build()
    return replace(body, track=replace(body.track, road=road)) if item.on_road else body


def build_symbol_controller(scenario: Scenario, observer: Observer) -> SymbolController:
    """The controller of the symbol. Raises LuxloopError where a road's file is missing, or a controller of one's own cannot be made."""
    params = scenario.controller
    if isinstance(params, FeedforwardParams):
        params = params.model_copy(update={"road": _located(params.road)})
    return build_controller(params, observer)


def _located(road: Road) -> Road:
    return road.model_copy(update={"file": data.locate(road.file)}) if isinstance(road, OpenCrgRoad) else road


def build_projector(scenario: Scenario, device: torch.device) -> Projector:
    """The lamp modules that draw the symbol, and the symbol's image. Raises LuxloopError where the lamp has no such module or movement."""
    modules = tuple(_drawing_modules(scenario, device))
    symbol = load_still(symbol_path(scenario.symbol.image)).to(device)
    return Projector(modules, symbol, scenario.symbol, camera_view(scenario.camera).origin)


def _drawing_modules(scenario: Scenario, device: torch.device) -> Iterator[DrawingModule]:
    params = scenario.headlight
    for side in params.lamps:
        lamp = load_lamp(params.model, side)
        beam = dict(zip((module.name for module in lamp.modules), lamp.beam(params.beam), strict=True))
        modules = [lamp.module(name) for name in params.modules] if params.modules else [lamp.finest]
        _check_movements(params, modules)
        scale = 1.0 if params.intensity_cd is None else params.intensity_cd / _brightest(modules)
        T_world_lamp = pose_from_degrees((0.0, (0.5 if side == "left" else -0.5) * params.distance_m, params.height_m))
        for module in modules:
            T_world_module = T_world_lamp @ turned(module, side, params).T_lamp_module
            controller = pixel_controller(scenario, module.headlight.scaled(scale).to(device), beam[module.name].to(device))
            yield DrawingModule(f"{side} {module.name}", controller, T_world_module.to(device))


def turned(part: TurnedPart, side: str, params: HeadlightParams) -> TurnedPart:
    """A lamp or module turned as a scenario says. Raises LuxloopError that names the lamp's side where it cannot be turned so far."""
    try:
        return part.turned(params.swivel_deg, params.level_deg)
    except LuxloopError as error:
        mirrored = "; a right lamp is the left one's mirror image, and so is its range" if side == "right" else ""
        raise LuxloopError(f"headlight: {side} lamp, {error}{mirrored}") from error


def _brightest(modules: Sequence[Module]) -> float:
    peak_cd = max(module.headlight.peak_cd for module in modules)
    if not peak_cd > 0:
        raise LuxloopError(f"headlight.modules: {', '.join(module.name for module in modules)} give no light; name others")
    return peak_cd


def _check_movements(params: HeadlightParams, modules: Sequence[Module]) -> None:
    for movement in ("swivel_deg", "level_deg"):
        if getattr(params, movement) and not any(any(getattr(module, movement)) for module in modules):
            names = ", ".join(module.name for module in modules)
            raise LuxloopError(f"headlight.{movement}: none of the modules that draw ({names}) can turn so; leave it out or name others")


def symbol_path(image: str) -> Path:
    """File of a symbol given by shipped name or path. Raises LuxloopError with the nearest name."""
    with located("symbol.image"):
        return named(image, "symbols")
