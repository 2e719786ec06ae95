"""From a scenario to the things it names: scene, lamps, symbol."""

from dataclasses import replace
from functools import partial
from pathlib import Path

from luxloop.controllers.symbol import AnyParams, build_controller
from luxloop.controllers.symbol.heights.feedforward import FeedforwardParams
from luxloop.controllers.symbol.sensing.protocol import SymbolController
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.shipped import named
from luxloop.loop.simulation.made import Made
from luxloop.world.errors import locate
from luxloop.world.materials.library import SpottedTexture
from luxloop.world.roads.base import Road
from luxloop.world.roads.scan import OpenCrgRoad
from luxloop.world.scene.body import Body, Figure
from luxloop.world.scene.ground import AROUND_M, SIGHT_M, RoadPatches, RoadTiles, StandingRoad
from luxloop.world.scene.scene import Ground, Scene
from luxloop.world.scene.vehicle import STANDING, Motion, drive
from luxloop.world.traffic.objects import ObjectParams


def build_road(scenario: Scenario) -> Road:
    """The road, with its file found. Raises LuxloopError where that is not on this machine."""
    return _located(scenario.road)


def build_motion(scenario: Scenario, before: Motion = STANDING) -> Motion:
    """The drive, over half a period more than all steps. before: another one, of which moments are kept as `drive` says.

    Raises LuxloopError where a file is missing or broken.
    """
    if scenario.vehicle is None:
        return STANDING
    return drive(scenario.vehicle, build_road(scenario), (scenario.steps + 1) / scenario.rate_hz, before)


def build_scene(scenario: Scenario, motion: Motion = STANDING, made: Made | None = None) -> Scene:
    """Road, along the vehicle's course, and objects. Raises LuxloopError where a file is missing or broken."""
    made, vehicle = made or Made(), scenario.vehicle
    road, surface, spots, light = build_road(scenario), scenario.surface, scenario.spots, scenario.light
    texture = made("texture", (surface, spots), lambda: SpottedTexture(surface, spots))
    objects = tuple(made(f"object {item.name}", (item, road), partial(_built, item, road)) for item in scenario.all_objects)
    sight_m = SIGHT_M if scenario.traffic is None else max(SIGHT_M, scenario.traffic.sight_m + AROUND_M)
    ground: Ground
    if motion is STANDING:
        ground = made("ground", (road, texture), lambda: StandingRoad(road, surface.albedo, texture))
    elif vehicle is not None and vehicle.roams:
        ground = made("ground", (road, texture, sight_m), lambda: RoadPatches(road, surface.albedo, texture, sight_m=sight_m))
    else:
        others_y_m = tuple(y for each in objects for y in each.track.T_world_body[:, 1, 3].tolist())
        range_y_m = motion.range_y_m
        tiles = partial(RoadTiles, road, range_y_m, surface.albedo, texture, others_y_m=others_y_m, sight_m=sight_m)
        ground = made("ground", (road, texture, range_y_m, others_y_m, sight_m), tiles)
    bodies = (ground, *objects)
    return made("scene", (bodies, light), lambda: Scene(bodies, light.ambient_lx, light.street_lamps))


def _built(item: ObjectParams, road: Road) -> Body | Figure:
    body = item.build()
    return replace(body, track=replace(body.track, road=road, wheels_m=item.wheels_m)) if item.on_road else body


def build_symbol_controller(params: AnyParams, sensor: SymbolSensor) -> SymbolController:
    """The controller of a symbol. Raises LuxloopError where a road's file is missing, or a controller of one's own cannot be made."""
    if isinstance(params, FeedforwardParams):
        params = params.model_copy(update={"road": _located(params.road)})
    return build_controller(params, sensor)


def _located(road: Road) -> Road:
    return road.model_copy(update={"file": data.locate(road.file)}) if isinstance(road, OpenCrgRoad) else road


def symbol_path(image: str) -> Path:
    """File of a symbol given by shipped name or path. Raises LuxloopError with the nearest name."""
    with locate("image"):
        return named(image, "symbols")
