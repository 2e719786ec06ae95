"""G-buffer: the surface at each pixel of a view."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from luxloop.world.frames import View, inverse, transform, unit
from luxloop.world.materials.brdf import LAMBERTIAN, Material
from luxloop.world.materials.library import MATERIALS
from luxloop.world.rendering.raycast import hits_on
from luxloop.world.scene.air import Medium
from luxloop.world.scene.triangles import Hits, Instance, Triangles


@dataclass(frozen=True)
class Finish:
    """Reflection of a view's surfaces besides albedo.

    materials: those in sight, the first Lambertian. material: `[height, width]` int64, which of them. eye: `[3]` m, the view's origin, or
    `[3, height * width]`, one a pixel. lobes: whether surfaces have their gloss and retroreflection besides the matt ground below.
    """

    materials: tuple[Material, ...]
    material: Tensor
    eye: Tensor
    lobes: bool = True


@dataclass(frozen=True)
class Haze:
    """Air in front of a view's surfaces. transmittance: `[height, width]`, from the surface to the eye, 0 where there is no surface."""

    medium: Medium
    transmittance: Tensor


@dataclass(frozen=True)
class GBuffer:
    """Surfaces at the pixel centres of a view; all zero where there is none.

    position: `[3, height, width]` m, world. normal: `[3, height, width]`, unit, world, on the side that is seen of two-sided bodies.
    albedo: `[height, width]`. object_id: `[height, width]` int32, index of the body in the scene, -1 = none.
    finish: None where all surfaces are Lambertian. part: `[height, width]` int32, which of its body's parts, 0 of a body without;
    None where none has any. haze: None in clear air.
    """

    position: Tensor
    normal: Tensor
    albedo: Tensor
    object_id: Tensor
    finish: Finish | None = None
    part: Tensor | None = None
    haze: Haze | None = None

    def in_air(self, medium: Medium | None, eye: Tensor) -> "GBuffer":
        """The same surfaces in other air, None for clear air. eye: `[3]` m, the view's origin."""
        if medium is None:
            return replace(self, haze=None)
        away = self.position - eye.to(self.position)[:, None, None]
        return replace(self, haze=Haze(medium, medium.transmittance(away) * (self.object_id >= 0)))

    def to(self, device: torch.device) -> "GBuffer":
        moved = self._map(lambda image: image.to(device))
        return moved if moved.finish is None else replace(moved, finish=replace(moved.finish, eye=moved.finish.eye.to(device)))

    def at(self, pixels: Tensor) -> "GBuffer":
        """The surfaces at flat pixels `[m]`, as an image of one row."""
        return self._map(lambda image: image.flatten(-2)[..., None, pixels])

    def one_row_of(self, rows: int) -> "GBuffer":
        """The middle row of every `rows` rows, as a copy."""
        return self if rows == 1 else self._map(lambda image: image[..., rows // 2 :: rows, :].contiguous())

    def _map(self, change: Callable[[Tensor], Tensor]) -> "GBuffer":
        """Apply a function to every image `[..., height, width]`."""
        finish = None if self.finish is None else replace(self.finish, material=change(self.finish.material))
        part = None if self.part is None else change(self.part)
        haze = None if self.haze is None else replace(self.haze, transmittance=change(self.haze.transmittance))
        position, normal, albedo, object_id = map(change, (self.position, self.normal, self.albedo, self.object_id))
        return GBuffer(position, normal, albedo, object_id, finish, part, haze)


def gbuffer(triangles: Triangles, view: View, face_ids: Tensor) -> GBuffer:
    """Intersect the ray through each pixel's centre with the face `[height, width]` that it sees; float64 inside, float32 out."""
    return along(triangles, view.origin, view.rays(), face_ids)


def along(triangles: Triangles, origin: Tensor, rays: Tensor, face_ids: Tensor) -> GBuffer:
    """Intersect rays `[3, height, width]` of any length from an origin `[3]` m with their faces `[height, width]`, as `gbuffer` does."""
    return surfaces_of(triangles, hits_on(triangles, face_ids.flatten(), origin, rays.flatten(1)), origin, rays)


def surfaces_of(triangles: Triangles, found: Iterable[Hits], origin: Tensor, rays: Tensor) -> GBuffer:
    """The surfaces that rays `[3, height, width]` meet. origin: `[3]` m, or `[3, height * width]`, one a ray."""
    n, directions, origins = rays[0].numel(), rays.flatten(1), origin.view(3, -1)
    position, normal, albedo = torch.zeros(3, n), torch.zeros(3, n), torch.zeros(n)
    object_id, material = torch.full((n,), -1, dtype=torch.int32), torch.zeros(n, dtype=torch.int64)
    part = torch.zeros(n, dtype=torch.int32) if any(placed.body.parts for placed in triangles.placed) else None
    numbers = {LAMBERTIAN: 0}  # of the materials in sight
    for hits in found:
        placed, pixels = hits.placed, hits.pixels
        points = (origins if origins.shape[1] == 1 else origins[:, pixels]) + directions[:, pixels] * hits.depth
        position[:, pixels] = points.float()
        normals = _normals(placed.corner_normals.index_select(0, hits.faces), hits.barycentric.float())
        normal[:, pixels] = torch.where(hits.front, normals, -normals) if placed.body.two_sided else normals
        if part is not None and placed.body.part_of_face is not None:
            part[pixels] = placed.body.part_of_face[hits.faces].int()
        albedo[pixels], material[pixels] = reflection(placed, points, numbers, None if part is None else part[pixels])
        object_id[pixels] = placed.object_id
    shape = rays.shape[1:]
    finish = Finish(tuple(numbers), material.view(shape), origin) if len(numbers) > 1 else None
    seen_part = None if part is None else part.view(shape)
    return GBuffer(position.view(3, *shape), normal.view(3, *shape), albedo.view(shape), object_id.view(shape), finish, seen_part)


def reflection(placed: Instance, points: Tensor, numbers: dict[Material, int], part: Tensor | None) -> tuple[Tensor, Tensor]:
    """Albedo `[M]` float32 and number of the material `[M]` int64 at points `[3, M]` of a body, world, on its parts `[M]`.

    New materials are numbered on.
    """
    body, texture = placed.body, placed.body.texture
    if body.parts and part is not None:
        known = torch.tensor([numbers.setdefault(MATERIALS[each.material], len(numbers)) for each in body.parts])
        return torch.tensor([each.albedo for each in body.parts])[part.long()], known[part.long()]
    if texture is None:
        number = numbers.setdefault(body.material, len(numbers))
        return torch.tensor(body.albedo).expand(points.shape[1]), torch.tensor(number).expand(points.shape[1])
    x, y, _ = transform(inverse(placed.T_world_body).to(points), points)
    known = torch.tensor([numbers.setdefault(each, len(numbers)) for each in texture.materials])
    return texture.at(x, y), known[texture.material_at(x, y)] if len(known) > 1 else known.expand(len(x))


def _normals(corner_normals: Tensor, barycentric: Tensor) -> Tensor:
    """Unit normals `[3, M]` from those at the corners `[M, 3 corners, 3]` and barycentric coordinates `[3 corners, M]`."""
    weight = barycentric.clamp(min=0.0)
    mean = torch.stack([weight[i] * corner_normals[:, i].T for i in range(3)]).sum(0)
    return unit(mean)


def flat_road(view: View, albedo: float, dtype: torch.dtype = torch.float32, material: Material = LAMBERTIAN) -> GBuffer:
    """G-buffer `[3, H, W]` of the plane z = 0 with one albedo (0..1) and material; object id -1 above the horizon."""
    rays, origin = view.rays(), view.origin[:, None, None]
    down = rays[2] < -1e-9
    distance = torch.where(down, -origin[2] / rays[2].where(down, -1.0), 0.0)
    position = rays.mul_(distance).add_(origin).mul_(down).to(dtype)
    normal = torch.zeros_like(position)
    normal[2] = down
    object_id = torch.where(down, 0, -1).to(torch.int32)
    finish = None if material.lambertian else Finish((LAMBERTIAN, material), down.to(torch.int64), view.origin)
    return GBuffer(position, normal, albedo * down.to(dtype), object_id, finish)
