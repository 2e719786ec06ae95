"""Ground truth of a scene's objects in a view, from its G-buffer: boxes, classes, occlusion, parts and materials."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from luxloop.world.frames import View, inverse, transform
from luxloop.world.materials.library import MaterialName
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.rendering.raycast import first_hits
from luxloop.world.scene.triangles import Instance, Triangles
from luxloop.world.traffic.tracked import Category

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class GroundTruth:
    """Ground truth of one object in one view.

    box: left, top, right, bottom in px of the visible part. whole: box of the whole object, with parts that are hidden or outside the
    image. pixels: number of visible pixels. visible: visible pixels over pixels without occlusion. inside: share of `whole` in the image.
    materials: number of pixels by name of material, for bodies with parts.
    """

    name: str
    object_id: int
    category: Category | None
    box: Box
    whole: Box
    pixels: int
    visible: float
    inside: float
    materials: Mapping[str, int]


def ground_truth(surfaces: GBuffer, triangles: Triangles, view: View, categories: Sequence[Category | None]) -> tuple[GroundTruth, ...]:
    """All objects visible in at least one pixel, in the order of their ids.

    surfaces: of `triangles` in `view`. categories: of the objects 1, 2, ...; the road is object 0. Boxes are in px of the view,
    including its oversampling of rows.
    """
    found = []
    parts = dict((placed.object_id, placed) for placed in triangles.placed if placed.object_id > 0)
    on_any = torch.nonzero(surfaces.object_id > 0)  # rows and columns, [m, 2]
    ids = surfaces.object_id[on_any.unbind(1)]
    for object_id, placed in sorted(parts.items()):
        seen = on_any[ids == object_id]
        pixels = len(seen)
        if not pixels:
            continue
        whole = _whole(placed, view)
        alone = _pixels_alone(placed, view, whole)
        width, height = whole[2] - whole[0], whole[3] - whole[1]
        shown = _clip(whole, view)
        inside = (shown[2] - shown[0]) * (shown[3] - shown[1]) / (width * height)
        # rasteriser and rays may differ on an outline's pixel
        visible = min(pixels / max(alone, 1), 1.0)
        materials = _materials(surfaces, seen, placed)
        found.append(
            GroundTruth(placed.body.name, object_id, categories[object_id - 1], _box(seen), whole, pixels, visible, inside, materials)
        )
    return tuple(found)


def part_picture(surfaces: GBuffer, triangles: Triangles, names: Sequence[str]) -> Tensor:
    """Index in names of the part that each pixel sees, such as a head, `[height, width]` int64; -1 for other parts."""
    bodies = {placed.object_id: placed.body.parts for placed in triangles.placed if placed.body.parts}
    if surfaces.part is None or not bodies:
        return torch.full_like(surfaces.object_id, -1, dtype=torch.int64)
    rows = max(placed.object_id for placed in triangles.placed) + 2  # the last row belongs to no object, -1
    index = {name: k for k, name in enumerate(names)}
    known = torch.full((rows, max(map(len, bodies.values()))), -1)
    for object_id, parts in bodies.items():
        known[object_id, : len(parts)] = torch.tensor([index.get(part.name, -1) for part in parts])
    return known.to(surfaces.part.device)[surfaces.object_id.long(), surfaces.part.long()]


def part_mask(surfaces: GBuffer, triangles: Triangles, names: Collection[str]) -> Tensor:
    """Pixels that see parts of these names, such as heads and windscreens, `[height, width]` bool."""
    return part_picture(surfaces, triangles, tuple(names)) >= 0


def _box(pixels: Tensor) -> Box:
    """The box around pixels, rows and columns `[m, 2]`."""
    (top, left), (bottom, right) = pixels.amin(0).tolist(), pixels.amax(0).tolist()
    return float(left), float(top), float(right + 1), float(bottom + 1)


def _whole(placed: Instance, view: View) -> Box:
    """Box of the corners in front of the camera; the part of an object behind the camera is clipped."""
    image, depth = view.project(placed.corners.flatten(0, 1).T)
    u, v = image[:, depth > 0.1]
    return float(u.min()), float(v.min()), float(u.max()), float(v.max())


def _clip(box: Box, view: View) -> Box:
    u0, v0, u1, v1 = np.clip(box, 0.0, (view.width, view.height) * 2).tolist()
    return u0, v0, u1, v1


def _pixels_alone(placed: Instance, view: View, whole: Box) -> int:
    """Number of pixels of the object without occlusion."""
    u0, v0, u1, v1 = _clip(whole, view)
    columns, rows = slice(int(u0), min(int(u1) + 1, view.width)), slice(int(v0), min(int(v1) + 1, view.height))
    return int((first_hits(Triangles.of(placed), view.origin, view.within(rows, columns).rays().flatten(1)) >= 0).sum())


def _materials(surfaces: GBuffer, seen: Tensor, placed: Instance) -> dict[str, int]:
    if surfaces.part is None or not placed.body.parts:
        return {}
    counts = torch.bincount(surfaces.part[seen.unbind(1)].long(), minlength=len(placed.body.parts)).tolist()
    found: dict[str, int] = {}
    for part, count in zip(placed.body.parts, counts, strict=True):
        if count:
            found[part.material] = found.get(part.material, 0) + count
    return found


def material_picture(surfaces: GBuffer, triangles: Triangles) -> tuple[Tensor, tuple[MaterialName, ...]]:
    """Material image `[height, width]` int64 of indices in the returned names, -1 for none.

    surfaces: of `triangles`.
    """
    names: dict[MaterialName, int] = {}
    picture = torch.full(surfaces.object_id.shape, -1, dtype=torch.int64, device=surfaces.object_id.device)
    for placed in triangles.placed:
        seen = surfaces.object_id == placed.object_id
        if not bool(seen.any()):
            continue
        own, which = _body_materials(placed, surfaces, seen)
        known = torch.tensor([names.setdefault(name, len(names)) for name in own], device=picture.device)
        picture[seen] = known[which]
    return picture, tuple(names)


def _body_materials(placed: Instance, surfaces: GBuffer, seen: Tensor) -> tuple[tuple[MaterialName, ...], Tensor]:
    """Names of a body's materials, and the index of the material at each of its visible pixels."""
    body = placed.body
    if body.parts and surfaces.part is not None:
        return tuple(part.material for part in body.parts), surfaces.part[seen].long()
    points = surfaces.position[:, seen].double().cpu()
    if body.texture is None:
        return ("matt",), torch.zeros_like(points[0], dtype=torch.int64)
    x, y, _ = transform(inverse(placed.T_world_body), points)
    return body.texture.names, body.texture.material_at(x, y).to(seen.device)
