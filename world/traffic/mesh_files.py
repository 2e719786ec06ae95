"""Files of triangle meshes."""

import io
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import trimesh

from world.errors import LuxloopError
from world.files import content

MESHES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")


def read_nodes(file: Path) -> Mapping[str, trimesh.Trimesh]:
    """The meshes of a file in its frame, by the names of its nodes. Raises LuxloopError where it is missing or unreadable."""
    if not os.path.isfile(file):
        raise LuxloopError(f"{file}: there is no such mesh file; correct the object's key 'file'")
    if file.suffix.lower() not in MESHES:  # archives and documents that trimesh reads as well may hold anything
        raise LuxloopError(f"{file}: meshes are {', '.join(MESHES)} files; export it as one of them")
    try:
        data = io.BytesIO(content(file))  # which gives no more bytes than there are, whatever the file declares
        resolver = trimesh.resolvers.FilePathResolver(str(file))
        found = trimesh.load_scene(data, file_type=file.suffix[1:].lower(), resolver=resolver, split_objects=True).dump()
    except Exception as error:  # trimesh's readers raise whatever their formats provoke
        raise LuxloopError(f"{file}: not readable as a mesh ({error}); export it again as .obj, .ply, .stl or .glb") from error
    meshes = [mesh for mesh in found if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not meshes:
        raise LuxloopError(f"{file}: holds no triangles; export it with its faces")
    if not all(np.isfinite(mesh.vertices).all() and mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices) for mesh in meshes):
        raise LuxloopError(f"{file}: has corners that are not numbers or not there; export it again")
    return dict(zip(_names(meshes), meshes, strict=True))


def joined(meshes: Iterable[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several, their faces one after the other."""
    return cast(trimesh.Trimesh, trimesh.util.concatenate(list(meshes)))


def _names(meshes: Sequence[trimesh.Trimesh]) -> list[str]:
    """Of the nodes, without the material that a reader puts behind them where each is of one material alone."""
    nodes = [str(mesh.metadata["node"]) for mesh in meshes]
    materials = [getattr(getattr(mesh.visual, "material", None), "name", None) for mesh in meshes]
    alone = [node.removesuffix(f"_{material}") for node, material in zip(nodes, materials, strict=True)]
    return [short if alone.count(short) == 1 else node for short, node in zip(alone, nodes, strict=True)]
