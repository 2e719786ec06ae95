"""Files of triangle meshes. Materials, skins, cameras and animations of glTF 2.0 are ignored, so no textures are opened."""

import base64
import io
import json
import re
import struct
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, cast
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.transformations import quaternion_matrix, translation_matrix

from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import afford, content, reading

# Beginnings of the names of required extensions that change no triangles, and of the one that is decoded.
READ: Final = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "KHR_xmp")
DTYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # by componentType
WIDTHS: Final = {"SCALAR": 1, "VEC3": 3}
TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives
BYTES_A_NUMBER: Final = 64  # of a corner: decoded, in a mesh, placed and joined with others, in double precision

Json = dict[str, Any]
Numbers = NDArray[Any]


def _read_gltf(file: Path, data: bytes) -> dict[str, trimesh.Trimesh]:
    """The placed meshes of a .gltf or .glb by the names of their nodes; of nodes with several materials, by node and material.

    Raises LuxloopError for required extensions that change triangles, and for buffers that are no regular files in the file's folder; and
    whatever a damaged file provokes.
    """
    tree, chunk = _parts(data)
    if not isinstance(required := tree.get("extensionsRequired", []), list):
        raise LuxloopError(f"{file}: extensionsRequired is {required!r}, not a list of names; export it again")
    if unread := [str(each) for each in required if not str(each).startswith(READ)]:
        raise LuxloopError(f"{file}: extensionsRequired: {', '.join(unread)} cannot be decoded; export it without, uncompressed")
    buffers = [_buffer(file, each, chunk) for each in tree.get("buffers", [])]
    nodes, found = tree.get("nodes", []), dict[str, trimesh.Trimesh]()
    roots = tree["scenes"][tree.get("scene", 0)].get("nodes", [])
    todo, seen, n_numbers = [(number, np.eye(4)) for number in roots], set[int](), 0
    while todo:
        number, T_world_parent = todo.pop(0)
        if number in seen:
            raise ValueError("its nodes are no tree")
        seen.add(number)
        node, T_world_node = nodes[number], T_world_parent @ _node_pose(nodes[number])
        todo += [(child, T_world_node) for child in node.get("children", [])]
        primitives = tree["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []
        drawn = [each for each in primitives if each.get("mode", TRIANGLES) in (TRIANGLES, STRIP, FAN) and "POSITION" in each["attributes"]]
        for k, primitive in enumerate(drawn):
            name = str(node.get("name", number))
            if len(drawn) > 1:
                name = f"{name}_{tree['materials'][primitive['material']].get('name', k) if 'material' in primitive else k}"
            n_numbers += sum(each["count"] * WIDTHS[each["type"]] for each in _accessors(tree, primitive).values())
            afford(f"{file}: its corners and faces", BYTES_A_NUMBER * n_numbers, "export fewer")
            found[trimesh.util.unique_name(name, found)] = _mesh(file, tree, buffers, primitive).apply_transform(T_world_node)
    return found


def _parts(data: bytes) -> tuple[Json, bytes | None]:
    """The JSON of a .gltf or .glb, and the first binary chunk of a .glb."""
    if not data.startswith(b"glTF"):
        return json.loads(data.decode("utf-8-sig")), None
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at < len(data):
        length, kind = struct.unpack_from("<I4s", data, at)
        chunks.setdefault(kind, data[at + 8 : at + 8 + length])
        at += 8 + length
    return json.loads(chunks[b"JSON"]), chunks.get(b"BIN\0")


def _buffer(file: Path, buffer: Json, chunk: bytes | None) -> bytes | None:
    if (uri := buffer.get("uri")) is None:
        return chunk
    if not isinstance(uri, str) or "\0" in unquote(uri):
        raise LuxloopError(f"{file}: buffers: the uri {uri!r} is no name of a file; export it again")
    if uri.startswith("data:"):
        head, _, text = uri.partition(",")
        return base64.b64decode(text) if head.endswith(";base64") else unquote_to_bytes(text)
    folder = file.parent.resolve()
    path = (folder / unquote(uri)).resolve()
    if not path.is_relative_to(folder):
        raise LuxloopError(f"{file}: buffers: {uri} is not in the file's folder; put it there")
    with locate(f"{file}: buffers"):
        return content(path)


def _node_pose(node: Json) -> NDArray[np.float64]:
    """T_parent_node (glTF 2.0, 3.5.3)."""
    if "matrix" in node:
        return np.reshape(np.asarray(node["matrix"], np.float64), (4, 4)).T
    turn = quaternion_matrix(np.roll(node.get("rotation", (0, 0, 0, 1)), 1))  # x, y, z, w in the file
    return translation_matrix(node.get("translation", (0, 0, 0))) @ turn @ np.diag([*node.get("scale", (1, 1, 1)), 1])


def _accessors(tree: Json, primitive: Json) -> dict[str, Json]:
    """Those of its corners, normals and faces."""
    numbers = primitive["attributes"] | {"indices": primitive.get("indices")}
    return {name: tree["accessors"][numbers[name]] for name in ("POSITION", "NORMAL", "indices") if numbers.get(name) is not None}


def _mesh(file: Path, tree: Json, buffers: list[bytes | None], primitive: Json) -> trimesh.Trimesh:
    accessors = _accessors(tree, primitive)
    if not {"bufferView", "sparse"} & accessors["POSITION"].keys():
        where = ", ".join(primitive.get("extensions", ["no buffer"]))
        raise LuxloopError(f"{file}: meshes: a primitive has its corners in {where} alone; export it uncompressed")
    numbers = {name: _numbers(tree, buffers, each) for name, each in accessors.items()}
    index = numbers["indices"][:, 0].astype(np.int64) if "indices" in numbers else np.arange(len(numbers["POSITION"]))
    mode = primitive.get("mode", TRIANGLES)
    if mode == TRIANGLES:
        faces = index.reshape(-1, 3)
    else:
        faces = np.stack([index[:-2] if mode == STRIP else np.full(len(index) - 2, index[0]), index[1:-1], index[2:]], 1)
    if mode == STRIP:
        faces[1::2] = faces[1::2, ::-1]
    return trimesh.Trimesh(numbers["POSITION"], faces, vertex_normals=numbers.get("NORMAL"), process=False)


def _numbers(tree: Json, buffers: list[bytes | None], accessor: Json) -> Numbers:
    """`[count, components]` of an accessor: sparse ones with their values, normalised ones as shares of 1 (glTF 2.0, 3.6.2)."""
    count, width, dtype = accessor["count"], WIDTHS[accessor["type"]], np.dtype(DTYPES[accessor["componentType"]])

    def view_numbers(part: Json, count: int, width: int, dtype: "np.dtype[Any]") -> Numbers:
        view = tree["bufferViews"][part["bufferView"]]
        start = view.get("byteOffset", 0)
        strides = (view.get("byteStride") or width * dtype.itemsize, dtype.itemsize)
        data = buffers[view["buffer"]][start : start + view["byteLength"]]
        return np.ndarray((count, width), dtype, data, part.get("byteOffset", 0), strides).copy()

    found = view_numbers(accessor, count, width, dtype) if "bufferView" in accessor else np.zeros((count, width), dtype)
    if sparse := accessor.get("sparse"):
        places = view_numbers(sparse["indices"], sparse["count"], 1, np.dtype(DTYPES[sparse["indices"]["componentType"]]))
        found[places[:, 0]] = view_numbers(sparse["values"], sparse["count"], width, dtype)
    if accessor.get("normalized"):
        return np.maximum(found / np.iinfo(dtype).max, -1)
    return found


MESHES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")


def read_nodes(file: Path) -> Mapping[str, trimesh.Trimesh]:
    """The meshes of a file in its frame, by the names of its nodes. Raises LuxloopError where it is missing or unreadable."""
    form = file.suffix.lower()[1:]
    if f".{form}" not in MESHES:  # trimesh also reads archives and documents, which may contain anything
        raise LuxloopError(f"{file}: meshes are {', '.join(MESHES)} files; export it as one of them")
    with reading(file, "not readable as a mesh", "export it again as .obj, .ply, .stl or .glb"):
        data = content(file)  # which gives no more bytes than there are, whatever the file declares
        found = _read_gltf(file, data) if form in ("glb", "gltf") else _read(file, form, data)
    nodes = {name: mesh for name, mesh in found.items() if len(mesh.faces)}
    if not nodes:
        raise LuxloopError(f"{file}: holds no triangles; export it with its faces")
    if not all(
        np.isfinite(each.vertices).all() and each.faces.min() >= 0 and each.faces.max() < len(each.vertices) for each in nodes.values()
    ):
        raise LuxloopError(f"{file}: has corners that are not numbers or not there; export it again")
    return nodes


def join_meshes(meshes: Iterable[trimesh.Trimesh]) -> trimesh.Trimesh:
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
