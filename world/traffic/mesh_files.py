"""Files of triangle meshes."""

import io
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import trimesh

from luxloop.world.errors import LuxloopError
from luxloop.world.files import content, reading
from luxloop.world.traffic import gltf

MESHES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")


def read_nodes(file: Path) -> Mapping[str, trimesh.Trimesh]:
    """The meshes of a file in its frame, by the names of its nodes. Raises LuxloopError where it is missing or unreadable."""
    if not os.path.isfile(file):
        raise LuxloopError(f"{file}: there is no such mesh file; correct the object's key 'file'")
    form = file.suffix.lower()[1:]
    if f".{form}" not in MESHES:  # archives and documents that trimesh reads as well may hold anything
        raise LuxloopError(f"{file}: meshes are {', '.join(MESHES)} files; export it as one of them")
    with reading(file, "not readable as a mesh", "export it again as .obj, .ply, .stl or .glb"):
        data = content(file)  # which gives no more bytes than there are, whatever the file declares
        found = gltf.read(file, data) if form in ("glb", "gltf") else _read(file, form, data)
    nodes = {name: mesh for name, mesh in found.items() if len(mesh.faces)}
    if not nodes:
        raise LuxloopError(f"{file}: holds no triangles; export it with its faces")
    if not all(
        np.isfinite(each.vertices).all() and each.faces.min() >= 0 and each.faces.max() < len(each.vertices) for each in nodes.values()
    ):
        raise LuxloopError(f"{file}: has corners that are not numbers or not there; export it again")
    return nodes


def joined(meshes: Iterable[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several, their faces one after the other."""
    return cast(trimesh.Trimesh, trimesh.util.concatenate(list(meshes)))


def _read(file: Path, form: str, data: bytes) -> Mapping[str, trimesh.Trimesh]:
    """Meshes by trimesh, without opening other files: an .obj file itself has the names of its materials, and no textures are needed."""
    library = b"".join(b"newmtl %s\n" % each for each in (*re.findall(rb"^usemtl +(.*\S)", data, re.M), b"unused"))  # two or more are named
    stream = io.BytesIO(b"mtllib names\n" + data if form == "obj" else data)
    stream.name = file.name
    scene = trimesh.load_scene(stream, file_type=form, resolver={"names": library}, split_objects=True, skip_materials=form != "obj")
    meshes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]
    return dict(zip(_names(meshes), meshes, strict=True))


def _names(meshes: Sequence[trimesh.Trimesh]) -> list[str]:
    """Of the nodes, without the material that a reader puts behind them where each is of one material alone."""
    nodes = [str(mesh.metadata["node"]) for mesh in meshes]
    materials = [getattr(getattr(mesh.visual, "material", None), "name", None) for mesh in meshes]
    alone = [node.removesuffix(f"_{material}") for node, material in zip(nodes, materials, strict=True)]
    return [short if alone.count(short) == 1 else node for short, node in zip(alone, nodes, strict=True)]
