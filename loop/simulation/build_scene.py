"""Builds road, vehicle motion and scene of a scenario."""

from dataclasses import replace
from functools import partial

from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.world.materials.library import SpottedTexture
from luxloop.world.roads.base import Road
from luxloop.world.roads.scan import OpenCrgRoad
from luxloop.world.scene.body import Body, Figure
from luxloop.world.scene.ground import AROUND_M, SIGHT_M, RoadPatches, RoadTiles, StandingRoad
from luxloop.world.scene.scene import Ground, Scene
from luxloop.world.scene.vehicle import STANDING, LateBody, Motion, drive
from luxloop.world.traffic.objects import ObjectParams


def find_road(road: Road) -> Road:
    """A road with the path of its file on this machine. Raises LuxloopError for a missing file."""
    return road.model_copy(update={"file": data.locate(road.file)}) if isinstance(road, OpenCrgRoad) else road


def build_motion(scenario: Scenario, cache: PartCache) -> Motion:
    """Vehicle motion, one step longer than the scenario, with the body delay of a digitised module.

    Raises LuxloopError for a missing or broken file.
    """
    if (vehicle := scenario.vehicle) is None:
        return STANDING
    rate_hz, key = scenario.rate_hz, (vehicle, find_road(scenario.road), (scenario.steps + 1) / scenario.rate_hz)
    motion = cache("motion", lambda *_: drive(*key, cache.before("motion", STANDING)), *key)
    late = max((each.late_steps(rate_hz) for each in scenario.modules.values() if each.delay_body), default=0)
    return LateBody.behind(motion, late / rate_hz) if late else motion


def build_scene(scenario: Scenario, motion: Motion = STANDING, cache: PartCache | None = None) -> Scene:
    """Road along the vehicle's course, and objects. Raises LuxloopError for a missing or broken file."""
    cache, vehicle, road, albedo = cache or PartCache(), scenario.vehicle, find_road(scenario.road), scenario.surface.albedo
    texture = cache("texture", SpottedTexture, scenario.surface, scenario.spots, motion is not STANDING)
    objects = tuple(cache(f"object {item.name}", _object, item, road) for item in scenario.all_objects)
    sight_m = SIGHT_M if scenario.traffic is None else max(SIGHT_M, scenario.traffic.sight_m + AROUND_M)
    ground: Ground
    if motion is STANDING:
        ground = cache("ground", StandingRoad, road, albedo, texture)
    elif vehicle is not None and vehicle.roams:
        ground = cache("ground", lambda *_: RoadPatches(road, albedo, texture, sight_m=sight_m), road, albedo, texture, sight_m)
    else:
        others_y_m = tuple(y for each in objects for y in each.track.T_world_body[:, 1, 3].tolist())
        tiles = partial(RoadTiles, others_y_m=others_y_m, sight_m=sight_m)
        ground = cache("ground", lambda *key: tiles(*key[:4]), road, motion.range_y_m, albedo, texture, others_y_m, sight_m)
    return cache("scene", Scene, (ground, *objects), scenario.light.ambient_lx, scenario.light.street_lamps)


def _object(item: ObjectParams, road: Road) -> Body | Figure:
    body = item.build()
    return replace(body, track=replace(body.track, road=road, wheels_m=item.wheels_m)) if item.on_road else body
