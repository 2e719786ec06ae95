"""Bodies of a scene as numbered meshes, each sent once."""

from collections.abc import Sequence
from itertools import count
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from luxloop.world.scene.body import Body, albedo_picture
from luxloop.world.scene.triangles import Instance

KEPT_BYTES = 2**28  # of meshes, about 1.5 km of road

Mesh = tuple[dict[str, Any], dict[str, np.ndarray]]  # head and arrays


class Meshes:
    """Numbers and meshes of bodies; a mesh is made when its body first appears.

    of: meshes by number, up to KEPT_BYTES; the least recently visible ones are dropped. Other threads may read it.
    """

    def __init__(self) -> None:
        self.of: dict[int, Mesh] = {}
        self._known: WeakKeyDictionary[Body, int] = WeakKeyDictionary()
        self._seen: dict[int, int] = {}  # bytes of the meshes, the most recently visible last
        self._numbers = count()

    def number(self, placed: Instance) -> int:
        """Number of a placed body's mesh."""
        number = self._known.get(placed.body)
        if number is None:
            number = self._known[placed.body] = next(self._numbers)
        if number not in self.of:
            self.of[number] = mesh = _mesh(number, placed.body, "road" if placed.object_id == 0 else "object")
            self._seen[number] = sum(each.nbytes for each in mesh[1].values())
        self._seen[number] = self._seen.pop(number)
        return number

    def assign(self, placed: Sequence[Instance]) -> list[tuple[int, Instance]]:
        """Bodies of a step with the numbers of their meshes; old meshes beyond KEPT_BYTES are dropped."""
        found = [(self.number(each), each) for each in placed]
        while sum(self._seen.values()) > KEPT_BYTES and len(self._seen) > len(found):
            oldest = next(iter(self._seen))
            del self._seen[oldest], self.of[oldest]
        return found


def _mesh(number: int, body: Body, kind: str) -> Mesh:
    if body.smooth and body.part_of_face is None:
        vertices, normals, faces = np.asarray(body.mesh.vertices), np.asarray(body.mesh.vertex_normals), np.asarray(body.mesh.faces)
    else:  # different faces share no corners
        vertices, normals = body.corners.flatten(0, 1).numpy(), body.corner_normals.flatten(0, 1).numpy()
        faces = np.arange(len(vertices)).reshape(-1, 3)
    arrays = {"vertices": vertices.astype(np.float32), "normals": normals.astype(np.float32), "faces": faces.astype(np.uint32)}
    head: dict[str, Any] = {"id": number, "object": body.name, "kind": kind, "two_sided": body.two_sided}
    if body.texture is None:
        albedo = np.full(len(vertices), body.albedo)
        if body.part_of_face is not None:
            of_part = np.array([part.albedo for part in body.parts])
            albedo = of_part[body.part_of_face.numpy()].repeat(3)
        arrays["albedo"] = _byte(albedo)
    else:
        picture, low, high = albedo_picture(body)
        head["box"] = [*low, *high]
        arrays["texture"] = _byte(picture.numpy())
    return head, {f"{number}.{name}": array for name, array in arrays.items()}


def _byte(share: np.ndarray) -> np.ndarray:
    coded: np.ndarray = (255 * np.clip(share, 0, 1)).round().astype(np.uint8)
    return coded
