"""From a scenario to the things it names: scene, lamps, symbol."""

import difflib
from pathlib import Path

import torch

from controllers.primitives import load_symbol
from controllers.ssc import Ssc
from controllers.symbol.projector import DrawingModule, Projector
from loop import data
from loop.scenario import Scenario, shipped_symbols
from world.body import Body
from world.errors import LuxloopError
from world.frames import pose_from_degrees
from world.presets import idealised
from world.roadmesh import road_mesh
from world.scanroad import OpenCrgRoad
from world.scene import Scene


def build_scene(scenario: Scenario) -> Scene:
    """Road and objects. Raises LuxloopError where a file is missing or broken."""
    road = scenario.road
    if isinstance(road, OpenCrgRoad):
        road = road.model_copy(update={"file": data.locate(road.file)})
    mesh = road_mesh(road)
    ground = Body("road", mesh, scenario.surface.albedo, scenario.surface.texture(), smooth=True)
    objects = tuple(item.build() for item in scenario.objects)
    return Scene((ground, *objects), scenario.light.ambient_lx, scenario.light.street_lamps)


def build_projector(scenario: Scenario, device: torch.device) -> Projector:
    """The lamps that draw the symbol, and the symbol's image."""
    lamp = scenario.headlight
    ssc = Ssc.prepare(idealised(intensity_cd=lamp.intensity_cd).to(device), scenario.ssc)
    half = lamp.distance_m / 2
    positions = {"left": (0.0, half, lamp.height_m), "right": (0.0, -half, lamp.height_m)}
    lamps = tuple(DrawingModule(name, ssc, pose_from_degrees(positions[name]).to(device)) for name in lamp.lamps)
    return Projector(lamps, load_symbol(symbol_path(scenario.symbol.image)).to(device), scenario.symbol)


def symbol_path(image: str) -> Path:
    """File of a symbol given by shipped name or path. Raises LuxloopError with the nearest name."""
    known = shipped_symbols()
    if image in known:
        return known[image]
    if "/" in image or "." in image:
        return Path(image)
    nearest = difflib.get_close_matches(image, known, 1)
    hint = f"did you mean {nearest[0]!r}?" if nearest else f"shipped are {', '.join(known)}; a picture is given by its path"
    raise LuxloopError(f"symbol.image: there is no symbol {image!r}; {hint}")
