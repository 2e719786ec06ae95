"""`luxloop export scene`: the file that other programs open holds the scene, each body where it is."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from luxloop import load, validate
from luxloop.loop.report.export_scene import SCENE, T_GLTF_WORLD, write_scene
from tests.loop.conftest import box, simulation_of

AT_S = 0.5
SMALL = ["camera.width_px=320", "camera.height_px=160", "renderer=raycast"]


def test_scene_opens_in_trimesh_with_every_vertex_where_it_is(lux, tmp_path):
    given = [*SMALL, "vehicle.course=[{speed_m_s=8.0}]", "light.street_lamps=[{position_m=[20.0, 7.0, 6.0], intensity_cd=500.0}]"]
    code, out, error = lux("export", "scene", "night_traffic", "--at", str(AT_S), "--out", "night.glb", "--set", *given)
    assert (code, error) == (0, "") and out.startswith("night.glb written: night_traffic at 0.5 s, ")
    simulation = simulation_of(load("night_traffic", given))
    world, state = simulation.world, simulation.world.motion.at(AT_S)
    opened = trimesh.load(tmp_path / "night.glb")
    graph = opened.graph
    assert np.allclose(graph.get(SCENE)[0], T_GLTF_WORLD)

    def triangles(nodes: list[str]) -> np.ndarray:
        meshes = [opened.geometry[graph.get(each)[1]].copy().apply_transform(graph.get(each, SCENE)[0]) for each in nodes]
        found: np.ndarray = np.concatenate([each.triangles for each in meshes])
        return found

    placed = world.scene.at(AT_S, state.T_world_ground).placed
    for each in placed:
        if each.object_id > 0:
            name = each.body.name
            assert np.allclose(graph.get(name, SCENE)[0], each.T_world_body.numpy(), atol=1e-6), name
            nodes = [node for node in graph.nodes_geometry if node == name or node.startswith(f"{name}/")]
            same(triangles(nodes), each.corners.numpy())
            assert any(node.endswith("/head") for node in nodes) == any(part.name == "head" for part in each.body.parts)
    road = [node for node in graph.nodes_geometry if node.startswith("road ")]
    same(triangles(road), np.concatenate([each.corners.numpy() for each in placed if each.object_id == 0]))
    assert all(opened.geometry[graph.get(node)[1]].visual.material.baseColorTexture is not None for node in road)

    T_world_camera = world.view_at(AT_S).T_world_view.numpy() @ np.diag([1, -1, -1, 1])
    assert np.allclose(opened.camera_transform, T_GLTF_WORLD @ T_world_camera, atol=1e-6)
    (camera,) = tree(tmp_path / "night.glb")["cameras"]
    wide = camera["perspective"]["aspectRatio"] * math.tan(camera["perspective"]["yfov"] / 2)  # as glTF defines both
    assert 2 * math.atan(wide) == pytest.approx(math.radians(simulation.scenario.camera.hfov_deg))
    for module in world.modules:
        T_world_module = state.T_world_body @ module.T_body_headlight.double()
        assert np.allclose(graph.get(f"lamp {module.name}", SCENE)[0], T_world_module.numpy(), atol=1e-6)
    assert graph.get("street lamp 1", SCENE)[0][:3, 3].tolist() == [20, 7, 6]


def tree(file: Path) -> dict[str, Any]:
    """The JSON of a .glb: its first chunk, behind a header of 12 bytes, begins with its length and type."""
    data = file.read_bytes()
    found: dict[str, Any] = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    return found


def test_no_name_of_an_object_is_taken_and_albedos_are_exact(tmp_path):
    names = ["world", "scene", "camera", "road"]
    objects = [box(each, (1.0, 1.0, 1.0), (10.0 + k, 0.0, 0.0), albedo=0.0018 + 1e-4 * k) for k, each in enumerate(names)]
    scenario = validate({"name": "boxes", "renderer": "raycast", "headlight": {"model": "ssl-hd-lores"}, "objects": objects}, "boxes")
    write_scene(simulation_of(scenario), 0.0, tmp_path / "boxes.glb")
    found = tree(tmp_path / "boxes.glb")
    for k, each in enumerate(names):
        (node,) = (node for node in found["nodes"] if node["name"] == each)
        assert node["matrix"][12:15] == [10.0 + k, 0, 0]
        material = found["materials"][found["meshes"][node["mesh"]]["primitives"][0]["material"]]
        assert material["pbrMetallicRoughness"]["baseColorFactor"] == [*[pytest.approx(0.0018 + 1e-4 * k, rel=1e-6)] * 3, 1]


def same(triangles: np.ndarray, others: np.ndarray) -> None:
    """Triangles `[n, 3, 3]` m in any order, compared by the distances of their corners from a place that none of them is near to."""
    found, wanted = (np.sort(np.linalg.norm(each.reshape(-1, 3) - [3.0, -50.0, 20.0], axis=1)) for each in (triangles, others))
    assert found == pytest.approx(wanted, abs=1e-4), "in single precision, 100 m away"
