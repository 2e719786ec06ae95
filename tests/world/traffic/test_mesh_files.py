"""Mesh files of others: glTF as its specification means it, and no file opened but what a glTF's buffers name in its own folder."""

import base64
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from luxloop.world.traffic.meshes import read_nodes
from tests.refusal import refusal

CORNERS = np.array([[0, 0, 0], [4, 0, 0], [4, 2, 0], [0, 2, 0]], np.float32)
FACES = np.array([0, 1, 2, 0, 2, 3], np.uint16)
Tree = dict[str, Any]
TYPES = {"<i2": 5122, "<u2": 5123, "<f4": 5126}


def plate(*, uri: str | None = None, **accessor: Any) -> Tree:
    """A glTF of a plate of 4 x 2 m in one node, with changed keys of its corners' accessor."""
    data = CORNERS.tobytes() + FACES.tobytes()
    tree: Tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "car", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"} | accessor],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "buffers": [{"byteLength": 60, "uri": uri or "data:application/octet-stream;base64," + base64.b64encode(data).decode()}],
    }
    tree["accessors"].append({"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"})
    return tree


def stored(tree: Tree, array: np.ndarray) -> int:
    """The number of a new view of a new buffer."""
    uri = "data:;base64," + base64.b64encode(array.tobytes()).decode()
    tree["buffers"].append({"byteLength": array.nbytes, "uri": uri})
    tree["bufferViews"].append({"buffer": len(tree["buffers"]) - 1, "byteLength": array.nbytes})
    return len(tree["bufferViews"]) - 1


def of_corners(array: np.ndarray, **node: Any) -> Tree:
    tree = plate(componentType=TYPES[array.dtype.str], normalized=array.dtype.kind != "f" and "scale" in node)
    tree["accessors"][0]["bufferView"] = stored(tree, array)
    tree["nodes"][0] |= node
    return tree


def sparse(base: bool) -> Tree:
    """Corners of half the width, or none, and in their sparse values those of the whole one."""
    tree = of_corners(CORNERS * np.float32([0.5, 1, 1]))
    at, values = stored(tree, np.array([1, 2, 3], np.uint16)), stored(tree, CORNERS[1:])
    tree["accessors"][0]["sparse"] = {"count": 3, "indices": {"bufferView": at, "componentType": 5123}, "values": {"bufferView": values}}
    if not base:
        del tree["accessors"][0]["bufferView"]
    return tree


def strided() -> Tree:
    tree = of_corners(np.concatenate([CORNERS, CORNERS + 7], 1))
    tree["bufferViews"][-1]["byteStride"] = 24
    return tree


def of_mode(mode: int, faces: list[int]) -> Tree:
    tree = plate()
    tree["meshes"][0]["primitives"][0]["mode"] = mode
    tree["accessors"][1] |= {"bufferView": stored(tree, np.array(faces, np.uint16)), "count": len(faces)}
    return tree


def deeper() -> Tree:
    tree = of_corners(CORNERS * np.float32([1, 1, 0.5]) - np.float32([1, 0, 0]), translation=[0, 0, 2.0])
    tree["nodes"].append({"children": [0], "translation": [1.0, 0, -2], "camera": 0})
    tree["scenes"][0]["nodes"] = [1]
    return tree


SHARES = np.round(CORNERS / 4 * 32767).astype("<i2")
RIGHT = {
    "as it is": plate(),
    "sparse": sparse(True),
    "sparse alone": sparse(False),
    "quantised": of_corners(CORNERS.astype("<u2")),
    "quantised to shares of 1": of_corners(SHARES, scale=[4.0, 4, 4]),
    "strided": strided(),
    "a strip": of_mode(5, [1, 2, 0, 3]),
    "a fan": of_mode(6, [0, 1, 2, 3]),
    "below a camera": deeper(),
    "textures are not opened": plate() | {"images": [{"uri": "pipe"}], "textures": [{"source": 0}]},
    "extensions of looks": plate() | {"extensionsRequired": ["KHR_mesh_quantization", "KHR_materials_unlit", "EXT_texture_webp"]},
}


def written(tree: Tree, file: Path) -> Path:
    file.write_text(json.dumps(tree))
    return file


@pytest.mark.parametrize("case", RIGHT)
def test_corners_are_where_the_specification_has_them(case, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    mesh = read_nodes(written(RIGHT[case], tmp_path / "a.gltf"))["car"]
    assert mesh.bounds == pytest.approx(np.array([[0, 0, 0], [4, 2, 0]]), abs=1e-4)  # quantised to 4 m / 32767
    assert mesh.area == pytest.approx(8, abs=1e-3) and (mesh.face_normals[:, 2] > 0.999).all()


def test_buffers_are_regular_files_in_the_folder_of_their_file(tmp_path):
    folder = tmp_path / "a folder"
    folder.mkdir()
    data = CORNERS.tobytes() + FACES.tobytes()
    for place in (folder / "a part.bin", tmp_path / "beside.bin"):
        place.write_bytes(data)
    os.mkfifo(folder / "pipe")
    (folder / "link.bin").symlink_to(tmp_path / "beside.bin")
    assert read_nodes(written(plate(uri="a%20part.bin"), folder / "a.gltf"))["car"].area == pytest.approx(8)
    for uri in ("../beside.bin", str(tmp_path / "beside.bin"), "link.bin", "pipe", "none.bin", "."):
        with refusal(r"a\.gltf: buffers: .*(put it|check the path)"):
            read_nodes(written(plate(uri=uri), folder / "a.gltf"))


def test_other_meshes_open_no_other_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "a.obj").write_text("mtllib pipe\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl paint\nf 1 2 3\nusemtl glass\nf 1 2 4\n")
    assert set(read_nodes(tmp_path / "a.obj")) == {"paint", "glass"}
    ply = trimesh.creation.box().export(file_type="ply", encoding="ascii")
    (tmp_path / "a.ply").write_bytes(ply.replace(b"\nelement", b"\ncomment TextureFile pipe\nelement", 1))
    assert len(read_nodes(tmp_path / "a.ply")) == 1


def test_parts_of_several_materials_are_named_after_these(tmp_path):
    tree = plate()
    (primitive,) = tree["meshes"][0]["primitives"]
    tree["meshes"][0]["primitives"] = [primitive | more for more in ({"material": 1}, {"material": 0}, {"material": 0}, {})]
    tree["materials"] = [{"name": "glass"}, {"name": "paint"}]
    tree["meshes"].append({"primitives": [primitive | {"material": 1}]})
    tree["nodes"] += [{"name": "trailer", "mesh": 0}, {"name": "hook", "mesh": 1}, {"mesh": 1}]
    tree["scenes"][0]["nodes"] = [0, 1, 2, 3]
    four = ["paint", "glass", "glass_1", "3"]
    expected = [*(f"car_{each}" for each in four), *(f"trailer_{each}" for each in four), "hook", "3"]
    for _ in range(2):
        assert list(read_nodes(written(tree, tmp_path / "a.gltf"))) == expected


def circle() -> Tree:
    tree = plate()
    tree["nodes"][0]["children"] = [0]
    return tree


def packed() -> Tree:
    tree = plate()
    del tree["accessors"][0]["bufferView"]
    tree["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    return tree


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        (plate() | {"extensionsRequired": ["KHR_draco_mesh_compression"]}, "extensionsRequired: KHR_draco_mesh_compression cannot"),
        (plate() | {"extensionsRequired": ["KHR_materials_unlit", "EXT_meshopt_compression"]}, "extensionsRequired: EXT_meshopt"),
        (plate() | {"extensionsRequired": "KHR_draco"}, "extensionsRequired is 'KHR_draco', not a list"),
        (plate() | {"buffers": [{"uri": 5}]}, "the uri 5 is no name of a file"),
        (plate(uri="a%00.bin"), "the uri 'a%00.bin' is no name of a file"),
        (packed(), "corners in KHR_draco_mesh_compression"),
        (circle(), "no tree"),
        (plate(bufferView=1), "not readable as a mesh"),
        (plate(count=10**12), "GB of memory"),
        (plate() | {"scenes": [{}]}, "no triangles"),
        (of_mode(4, [0, 1, 9]), "not there"),
        (of_corners(CORNERS * np.float32("nan")), "not numbers"),
    ],
)
def test_gltf_that_cannot_be_read_as_meant_is_refused(tree, words, tmp_path):
    with refusal(rf"a\.gltf: .*{words}") as error:
        read_nodes(written(tree, tmp_path / "a.gltf"))
    assert "\n" not in str(error.value)
