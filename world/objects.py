"""Objects that a scenario file may put into the scene: boxes and meshes from files."""

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import torch
import trimesh
from pydantic import Field, model_validator

from world.body import Body, PoseTrack
from world.brdf import LAMBERTIAN
from world.errors import LuxloopError
from world.frames import pose_from_degrees
from world.materials import MATERIALS, MaterialName
from world.params import Params

Category = Literal["car", "truck", "motorcycle", "cyclist", "pedestrian", "animal", "sign", "other"]


class KeyframeParams(Params):
    """Where an object is at one time."""

    time_s: float = Field(0.0, description="Time since the scenario's start")
    position_m: tuple[float, float, float] = Field(description="Object's origin in the world (x forward, y left, z up)")
    roll_deg: float = Field(0.0, ge=-180, le=180, description="About the x axis, positive: right side down")
    pitch_deg: float = Field(0.0, ge=-90, le=90, description="About the y axis, positive: nose down")
    yaw_deg: float = Field(0.0, ge=-180, le=180, description="About the z axis, positive: to the left")


class TrackedParams(Params):
    """What all objects have: a name, a surface, and a pose over time."""

    name: str = Field(min_length=1, description="Name, for reports")
    category: Category | None = Field(None, description="What a tracker reports it as to lighting functions; left out: nothing is told")
    albedo: float = Field(0.2, ge=0, le=1, description="Share of light reflected, diffusely; of what gets wet when it is dry")
    material: MaterialName | None = Field(None, description="What it reflects besides, by name; left out: nothing, it is matt")
    track: tuple[KeyframeParams, ...] = Field(min_length=1, description="Poses in ascending time; one keyframe: the object stands still")
    appears_s: float | None = Field(None, description="Time of appearing; left out: there from the start")
    vanishes_s: float | None = Field(None, description="Time of vanishing; left out: there to the end")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        times = [keyframe.time_s for keyframe in self.track]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError(f"track: time_s must ascend from keyframe to keyframe, here {times}")
        if self.appears_s is not None and self.vanishes_s is not None and self.vanishes_s <= self.appears_s:
            raise ValueError(f"vanishes_s ({self.vanishes_s}) must be later than appears_s ({self.appears_s})")
        return self

    def surface(self) -> dict[str, Any]:
        """A body's albedo, as it is seen, and material."""
        material = MATERIALS[self.material] if self.material else LAMBERTIAN
        return {"albedo": float(material.darkened(torch.tensor(self.albedo, dtype=torch.float64))), "material": material}

    def pose_track(self) -> PoseTrack:
        poses = [pose_from_degrees(k.position_m, k.roll_deg, k.pitch_deg, k.yaw_deg) for k in self.track]
        return PoseTrack(
            tuple(k.time_s for k in self.track),
            torch.stack(poses),
            -float("inf") if self.appears_s is None else self.appears_s,
            float("inf") if self.vanishes_s is None else self.vanishes_s,
        )


class BoxParams(TrackedParams):
    """A box; its origin is the centre of its bottom face."""

    kind: Literal["box"] = "box"
    size_m: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = Field(
        description="Length (x), width (y), height (z)"
    )

    def build(self) -> Body:
        box = trimesh.creation.box(self.size_m)
        box.apply_translation((0, 0, self.size_m[2] / 2))
        return Body(self.name, box, **self.surface(), track=self.pose_track())


class MeshParams(TrackedParams):
    """A mesh from a file; its origin and axes are the file's (x forward, y left, z up)."""

    kind: Literal["mesh"] = "mesh"
    file: Path = Field(description="Mesh file: .obj, .ply, .stl, .glb or what else trimesh reads")
    scale: float = Field(1.0, gt=0, description="Metres a unit of the file")
    smooth: bool = Field(False, description="Interpolate normals over the faces, for rounded bodies")

    def build(self) -> Body:
        """Read the file. Raises LuxloopError where it is missing, unreadable or has no triangles."""
        mesh = _read_mesh(self.file, self.scale)
        return Body(self.name, mesh, **self.surface(), smooth=self.smooth, two_sided=not mesh.is_watertight, track=self.pose_track())


ObjectParams = Annotated[BoxParams | MeshParams, Field(discriminator="kind")]


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
