"""Objects for scenarios: boxes, meshes from files, and random objects."""

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import torch
from pydantic import Field, model_validator

from luxloop.world.errors import LuxloopError
from luxloop.world.materials.library import MATERIALS, MaterialName
from luxloop.world.scene.body import Body, Part
from luxloop.world.traffic.animal import AnimalParams
from luxloop.world.traffic.car import CarParams
from luxloop.world.traffic.people import CyclistParams, PedestrianParams
from luxloop.world.traffic.roadside import ClutterParams, TrafficSignParams
from luxloop.world.traffic.tracked import SurfaceParams, TrackedParams, check_parts

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
AXES = np.eye(3)
FARTHEST_M = 10_000
Side = Annotated[float, Field(gt=0, le=1000)]


class SolidParams(TrackedParams):
    """An object of one surface."""

    albedo: float = Field(0.2, ge=0, le=1, description="diffuse albedo, when dry")
    material: MaterialName | None = Field(None, description="material by name; left out: matt")

    def part(self, name: str, given: SurfaceParams | None = None) -> Part:
        """A part of it; given: what it looks like in place of the whole."""
        given = given or SurfaceParams()
        material = given.material or self.material or "matt"
        albedo = torch.tensor(self.albedo if given.albedo is None else given.albedo, dtype=torch.float64)
        return Part(name, float(MATERIALS[material].darken(albedo)), material)


class BoxParams(SolidParams):
    """A box; its origin is the centre of its bottom face."""

    kind: Literal["box"] = "box"
    size_m: tuple[Side, Side, Side] = Field(examples=[[0.4, 0.4, 0.3]], description="length (x), width (y), height (z)")

    def build(self) -> Body:
        import trimesh

        box = trimesh.creation.box(self.size_m)
        box.apply_translation((0, 0, self.size_m[2] / 2))
        return Body(self.name, box, track=self.pose_track(), parts=(self.part("surface"),))


class MeshParams(SolidParams):
    """A mesh from a file, whose origin it keeps."""

    kind: Literal["mesh"] = "mesh"
    file: Path = Field(examples=["rock.obj"], description="mesh file: .obj, .ply, .stl, .off, .glb or .gltf")
    scale: float = Field(1.0, gt=0, le=1e6, description="metres per unit of the file")
    forward: Axis = Field("x", description="axis of the file that points forward")
    up: Axis = Field("z", description="axis of the file that points up; y in .glb and most .obj files")
    smooth: bool = Field(False, description="interpolate normals over faces, for rounded bodies")
    parts: dict[str, SurfaceParams] = Field(
        {},
        description="albedo and material of parts, by the file's node names, NODE_MATERIAL where a node has several materials, or material "
        "names if it has no nodes",
    )

    @model_validator(mode="after")
    def _square(self) -> Self:
        if self.forward[-1] == self.up[-1]:
            raise ValueError(f"forward ({self.forward}) and up ({self.up}) lie along one axis of the file; name two")
        return self

    def build(self) -> Body:
        """Read the file. Raises LuxloopError where it is missing, unreadable or has no triangles, or has no such part."""
        from luxloop.world.traffic.meshes import join_meshes, read_nodes

        nodes = read_nodes(self.file)
        check_parts(self.name, self.parts, list(nodes))
        mesh = join_meshes(nodes.values())
        ahead, up = (AXES["xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1) for axis in (self.forward, self.up))
        turn = np.eye(4)
        turn[:3, :3] = [ahead, np.cross(up, ahead), up]
        mesh.apply_scale(self.scale).apply_transform(turn)
        if (reach := np.abs(mesh.vertices).max()) > FARTHEST_M:
            raise LuxloopError(f"{self.file}: reaches {reach:.3g} m from its origin; set the object's scale, the metres a unit of the file")
        of_face = torch.arange(len(nodes)).repeat_interleave(torch.tensor([len(node.faces) for node in nodes.values()]))
        return Body(
            self.name,
            mesh,
            smooth=self.smooth,
            two_sided=not mesh.is_watertight,
            track=self.pose_track(),
            parts=tuple(self.part(name, self.parts.get(name)) for name in nodes),
            part_of_face=of_face,
        )


ObjectParams = Annotated[
    BoxParams | MeshParams | PedestrianParams | CyclistParams | CarParams | AnimalParams | TrafficSignParams | ClutterParams,
    Field(discriminator="kind"),
]
