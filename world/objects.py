"""Objects that a scenario file may put into the scene: boxes, meshes from files, and what is made from a seed."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import torch
import trimesh
from pydantic import Field, model_validator

from world.body import Body
from world.brdf import LAMBERTIAN
from world.errors import LuxloopError
from world.materials import MATERIALS, MaterialName
from world.tracked import TrackedParams
from world.traffic.animal import AnimalParams
from world.traffic.car import CarParams
from world.traffic.road_users import CyclistParams, PedestrianParams
from world.traffic.roadside import ClutterParams, TrafficSignParams

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
AXES = np.eye(3)


class SolidParams(TrackedParams):
    """An object of one surface."""

    albedo: float = Field(0.2, ge=0, le=1, description="Share of light reflected, diffusely; of what gets wet when it is dry")
    material: MaterialName | None = Field(None, description="What it reflects besides, by name; left out: nothing, it is matt")

    def surface(self) -> dict[str, Any]:
        """A body's albedo, as it is seen, and material."""
        material = MATERIALS[self.material] if self.material else LAMBERTIAN
        return {"albedo": float(material.darkened(torch.tensor(self.albedo, dtype=torch.float64))), "material": material}


class BoxParams(SolidParams):
    """A box; its origin is the centre of its bottom face."""

    kind: Literal["box"] = "box"
    size_m: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = Field(
        description="Length (x), width (y), height (z)"
    )

    def build(self) -> Body:
        box = trimesh.creation.box(self.size_m)
        box.apply_translation((0, 0, self.size_m[2] / 2))
        return Body(self.name, box, **self.surface(), track=self.pose_track())


class MeshParams(SolidParams):
    """A mesh from a file, whose origin it keeps."""

    kind: Literal["mesh"] = "mesh"
    file: Path = Field(description="Mesh file: .obj, .ply, .stl, .glb or what else trimesh reads")
    scale: float = Field(1.0, gt=0, description="Metres a unit of the file")
    forward: Axis = Field("x", description="The file's axis that points ahead")
    up: Axis = Field("z", description="The file's axis that points up; y in .glb and in most .obj files")
    smooth: bool = Field(False, description="Interpolate normals over the faces, for rounded bodies")

    @model_validator(mode="after")
    def _square(self) -> Self:
        if self.forward[-1] == self.up[-1]:
            raise ValueError(f"forward ({self.forward}) and up ({self.up}) lie along one axis of the file; name two")
        return self

    def build(self) -> Body:
        """Read the file. Raises LuxloopError where it is missing, unreadable or has no triangles."""
        mesh = _read_mesh(self.file, self.scale)
        ahead, up = (AXES["xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1) for axis in (self.forward, self.up))
        turn = np.eye(4)
        turn[:3, :3] = [ahead, np.cross(up, ahead), up]
        mesh.apply_transform(turn)
        return Body(self.name, mesh, **self.surface(), smooth=self.smooth, two_sided=not mesh.is_watertight, track=self.pose_track())


ObjectParams = Annotated[
    BoxParams | MeshParams | PedestrianParams | CyclistParams | CarParams | AnimalParams | TrafficSignParams | ClutterParams,
    Field(discriminator="kind"),
]


def _read_mesh(file: Path, scale: float) -> trimesh.Trimesh:
    if not file.is_file():
        raise LuxloopError(f"{file}: there is no such mesh file; correct the object's key 'file'")
    try:
        mesh = trimesh.load_mesh(file)
    except Exception as error:  # trimesh's readers raise whatever their formats provoke
        raise LuxloopError(f"{file}: not readable as a mesh ({error}); export it again as .obj, .ply, .stl or .glb") from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise LuxloopError(f"{file}: holds no triangles; export it with its faces")
    if not np.isfinite(mesh.vertices).all() or mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise LuxloopError(f"{file}: has corners that are not numbers or not there; export it again")
    mesh.apply_scale(scale)
    return mesh
