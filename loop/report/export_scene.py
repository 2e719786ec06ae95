"""The scene of a scenario at one time as a glTF file: road, objects, camera and lamps, each a node with its pose."""

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
import trimesh
from kornia.color import linear_rgb_to_rgb
from PIL import Image
from torch import Tensor
from trimesh.visual.material import PBRMaterial

from luxloop.loop.report.export_light import modules_at, refuse_time
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write
from luxloop.world.frames import View
from luxloop.world.scene.body import Body, albedo_picture
from luxloop.world.scene.triangles import Instance

ROOT, SCENE, CAMERA = "world y-up", "world z-up", "front camera"  # names that no object can have
ALBEDO: Final = "albedo "  # before the number in the name of a plain material
T_GLTF_WORLD: Final = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
T_VIEW_CAMERA: Final = np.diag([1.0, -1, -1, 1])  # a camera of glTF looks along -z, y up


def write_scene(simulation: Simulation, time_s: float, file: Path) -> trimesh.Scene:
    """Write the scene at a time as .glb; returns the scene.

    Raises LuxloopError for another suffix, a time beyond the scenario, a plant that does not know the truth, and where the file cannot be
    written.
    """
    if file.suffix.lower() != ".glb":
        raise LuxloopError(f"--out {file}: gives no format of a scene; end it in .glb")
    scene = scene_at(simulation, time_s)
    atomic_write(file, scene.export(file_type="glb", tree_postprocessor=_exact))
    return scene


def scene_at(simulation: Simulation, time_s: float) -> trimesh.Scene:
    """The scene at a time: a node CAMERA, and a node SCENE of the world with nodes for road, objects, modules and street lamps.

    Raises LuxloopError as `write_scene`.
    """
    refuse_time(simulation, time_s)
    world, state = simulation.world, simulation.world.motion.at(time_s)
    found = trimesh.Scene(base_frame=ROOT)
    found.graph.update(SCENE, matrix=T_GLTF_WORLD)
    for number, placed in enumerate(world.scene.at(time_s, state.T_world_ground).placed):
        _add(found, placed, placed.body.name if placed.object_id else f"road {number}")
    for name, T_body_module in modules_at(simulation, time_s):
        found.graph.update(f"lamp {name}", SCENE, matrix=(state.T_world_body @ T_body_module).numpy())
    for number, lamp in enumerate(world.scene.street_lamps, 1):
        T = trimesh.transformations.translation_matrix(lamp.position_m)
        found.graph.update(f"street lamp {number}", SCENE, matrix=T, metadata={"intensity_cd": lamp.intensity_cd})
    _add_camera(found, world.view_at(time_s))
    return found


def _add_camera(scene: trimesh.Scene, view: View) -> None:
    wide, high = view.width / view.fx, view.height / view.fy
    fov_deg = math.degrees(2 * math.atan(high / 2)) * np.array([wide / high, 1.0])  # trimesh writes the ratio of the angles
    scene.camera = trimesh.scene.Camera(CAMERA, resolution=(view.width, view.height), fov=fov_deg)
    scene.camera_transform = T_GLTF_WORLD @ view.T_world_view.numpy() @ T_VIEW_CAMERA


def _add(scene: trimesh.Scene, placed: Instance, name: str) -> None:
    """Add a node for a body with its mesh, or with a node for each of its parts."""
    body, T = placed.body, placed.T_world_body.numpy()
    if body.part_of_face is None:
        parts = body.parts or (None,)
        mesh = _mesh(body, None, body.albedo if parts[0] is None else parts[0].albedo)
        scene.add_geometry(mesh, name, name, SCENE, transform=T)
        return
    scene.graph.update(name, SCENE, matrix=T)
    for k, part in enumerate(body.parts):
        if bool((faces := body.part_of_face == k).any()):
            own = f"{name}/{part.name}"
            own = own if own not in scene.geometry else f"{own} {k}"
            scene.add_geometry(_mesh(body, faces, part.albedo), own, own, name, metadata={"material": part.material})


def _mesh(body: Body, faces: Tensor | None, albedo: float) -> trimesh.Trimesh:
    """The mesh of a body's faces, all or those in a mask `[faces]`. Smooth faces share vertices and normals, flat ones have their own."""
    chosen = torch.ones(len(body.corners), dtype=torch.bool) if faces is None else faces
    vertices = np.asarray(body.mesh.vertices)
    if body.smooth:
        used, index = np.unique(np.asarray(body.mesh.faces)[chosen.numpy()], return_inverse=True)
        corners, triangles, normals = vertices[used], index.reshape(-1, 3), np.asarray(body.mesh.vertex_normals)[used]
    else:
        corners, normals = (each[chosen].flatten(0, 1).numpy() for each in (body.corners, body.corner_normals))
        triangles = np.arange(len(corners)).reshape(-1, 3)
    look = PBRMaterial(
        f"{ALBEDO}{albedo}", baseColorFactor=[albedo] * 3 + [1.0], metallicFactor=0.0, roughnessFactor=1.0, doubleSided=body.two_sided
    )
    uv = None
    if body.texture is not None:
        picture, low, high = albedo_picture(body)
        srgb = linear_rgb_to_rgb(picture.clamp(0, 1).expand(3, -1, -1)).flip(1)  # v of trimesh runs up
        grey = Image.fromarray((255 * srgb).round().byte().movedim(0, -1).contiguous().numpy())
        look = PBRMaterial(baseColorTexture=grey, metallicFactor=0.0, roughnessFactor=1.0, doubleSided=body.two_sided)
        uv = (corners[:, :2] - low) / np.subtract(high, low)
    visual = trimesh.visual.TextureVisuals(uv=uv, material=look)
    return trimesh.Trimesh(corners, triangles, vertex_normals=normals, visual=visual, process=False)


def _exact(tree: dict[str, Any]) -> None:
    """Set exact albedos, by the names of materials, in which trimesh keeps 8 bits."""
    for material in tree["materials"]:
        if (name := material.get("name", "")).startswith(ALBEDO):
            material["pbrMetallicRoughness"]["baseColorFactor"][:3] = [float(name.removeprefix(ALBEDO))] * 3
