"""The picture of materials names what is there, without knowing how it was drawn."""

import pytest
import torch

from luxloop.loop.simulation.simulated import build_scene
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.perception.ground_truth import material_picture
from luxloop.world.materials.library import MATERIALS
from luxloop.world.rendering.gbuffer import gbuffer
from luxloop.world.rendering.surfaces import face_source
from tests.loop.conftest import scenario_of

STREET = """
name = "street"
surface = { markings = true, grain = 0.0, albedo = 0.1 }
spots = [{ x_m = 9, y_m = 0, material = "wet_asphalt" }]
[[objects]]
kind = "pedestrian"
name = "eva"
track = [{ position_m = [12, -1, 0] }]
[[objects]]
kind = "box"
name = "wall"
size_m = [0.5, 2, 2]
material = "metal"
track = [{ position_m = [14, 1, 0], yaw_deg = 180 }]
[[objects]]
kind = "box"
name = "crate"
size_m = [0.5, 1, 1]
track = [{ position_m = [11, 1, 0] }]
"""


@pytest.mark.parametrize("beads", [False, True])
def test_materials_are_named(beads):
    scenario = scenario_of(STREET, f"surface.beads={str(beads).lower()}")
    view = camera_view(CameraParams(width_px=320, height_px=180))
    triangles = build_scene(scenario).at(0.0)
    surfaces = gbuffer(triangles, view, face_source("raycast").face_ids(triangles, view))
    picture, names = material_picture(surfaces, triangles)
    seen = {name: picture == k for k, name in enumerate(names)}
    assert {"asphalt", "lane_paint", "wet_asphalt", "skin", "cloth", "metal", "matt"} <= set(names) <= set(MATERIALS)
    assert torch.equal(picture == -1, surfaces.object_id == -1)
    assert torch.equal(seen["metal"], surfaces.object_id == 2) and torch.equal(seen["matt"], surfaces.object_id == 3)
    # paint is 0.5 brighter than its asphalt; a pixel's centre may lie where the texture is between two texels
    assert float((surfaces.albedo[seen["lane_paint"]] > 0.35).double().mean()) > 0.9
    assert float((surfaces.albedo[seen["asphalt"]] < 0.35).double().mean()) > 0.99
