"""Surfaces of a view: face ids by OpenGL if available, else by rays; exact for static worlds, quick for moving ones."""

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import torch
from torch import Tensor

from luxloop.world.caches import Part
from luxloop.world.frames import View
from luxloop.world.materials.brdf import LAMBERTIAN, Material
from luxloop.world.rendering.deferred import DeferredRenderer
from luxloop.world.rendering.gbuffer import Finish, GBuffer, gbuffer, reflection
from luxloop.world.rendering.rasterise import NoOpenGL, Rasteriser
from luxloop.world.rendering.raycast import RayCaster
from luxloop.world.scene.triangles import Instance, Triangles


class FaceSource(Protocol):
    """Finds the triangle at each pixel of a view. name: of the method."""

    @property
    def name(self) -> str: ...

    def face_ids(self, triangles: Triangles, view: View, part: Part | None = None) -> Tensor:
        """Id of the nearest face through each pixel's centre, `[height, width]` int64, -1 where there is none.

        part: rows and columns, equal to that part of the whole view; None for all.
        """
        ...


class FirstFound:
    """OpenGL if available, else rays; decided on first use, as an OpenGL context takes half a second to make."""

    @cached_property
    def found(self) -> FaceSource:
        """The chosen face source. Warns if OpenGL is not available."""
        return face_source("auto")

    @property
    def name(self) -> str:
        return self.found.name

    def face_ids(self, triangles: Triangles, view: View, part: Part | None = None) -> Tensor:
        """As of the chosen face source."""
        return self.found.face_ids(triangles, view, part)


def face_source(name: Literal["auto", "opengl", "raycast"] = "auto") -> FaceSource:
    """The face source of that name; "auto" takes OpenGL and falls back to rays with a warning. Raises NoOpenGL for "opengl"."""
    if name == "raycast":
        return RayCaster()
    try:
        return Rasteriser()
    except NoOpenGL as error:
        if name == "opengl":
            raise
        warnings.warn(f"rendering by ray casting, which is slower: {error}", stacklevel=2)
        return RayCaster()


@dataclass(frozen=True)
class ExactSurfaces:
    """Every ray is intersected with its face in float64."""

    source: FaceSource

    def gbuffer(self, triangles: Triangles, view: View, part: Part | None = None) -> GBuffer:
        face_ids = self.source.face_ids(triangles, view, part)
        return gbuffer(triangles, view if part is None else view.within(*part), face_ids)


@dataclass(frozen=True)
class QuickSurfaces:
    """Depths and normals as OpenGL interpolates them, in float32. Parts of one object must share its pose and texture."""

    renderer: DeferredRenderer

    def gbuffer(self, triangles: Triangles, view: View, part: Part | None = None) -> GBuffer:
        seen = self.renderer.fragments(triangles, view, part)
        view = view if part is None else view.within(*part)
        object_id, shape = seen.object_id.flatten(), seen.object_id.shape
        T_world_view = view.T_world_view.float()
        position = view.rays().float().flatten(1).mul_(seen.depth.flatten())
        position.addcmul_(T_world_view[:3, 3:], (object_id >= 0).float())
        normal = T_world_view[:3, :3] @ seen.normal.flatten(1)
        albedo, material = torch.zeros(object_id.shape), torch.zeros(object_id.shape, dtype=torch.int64)
        parts = seen.part.flatten() if any(placed.body.parts for placed in triangles.placed) else None
        numbers: dict[Material, int] = {LAMBERTIAN: 0}
        for placed in _one_an_object(triangles):
            pixels = torch.nonzero(object_id == placed.object_id)[:, 0]
            if len(pixels):
                on_part = None if parts is None else parts[pixels]
                albedo[pixels], made_of = reflection(placed, position.index_select(1, pixels), numbers, on_part)
                if len(numbers) > 1:  # else it is the first, and its number 0
                    material[pixels] = made_of
        finish = Finish(tuple(numbers), material.view(shape), view.origin) if len(numbers) > 1 else None
        seen_part = None if parts is None else parts.view(shape)
        return GBuffer(position.view(3, *shape), normal.view(3, *shape), albedo.view(shape), object_id.view(shape), finish, seen_part)


SurfaceSource = ExactSurfaces | QuickSurfaces


def _one_an_object(triangles: Triangles) -> tuple[Instance, ...]:
    return tuple({placed.object_id: placed for placed in triangles.placed}.values())


def surface_source(source: FaceSource, moving: bool) -> SurfaceSource:
    """Quick surfaces if the world moves and faces come from OpenGL, else exact ones."""
    source = source.found if isinstance(source, FirstFound) else source
    return QuickSurfaces(DeferredRenderer()) if moving and isinstance(source, Rasteriser) else ExactSurfaces(source)
