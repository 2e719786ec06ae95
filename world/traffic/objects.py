"""Objects for scenarios: boxes, meshes from files, signs, clutter that detectors should not report, and all random objects."""

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import torch
from pydantic import Field, model_validator

from luxloop.world.errors import LuxloopError
from luxloop.world.materials.library import MATERIALS, MaterialName
from luxloop.world.params import Positive, Share
from luxloop.world.scene.body import Body, Part
from luxloop.world.traffic.animal import AnimalParams
from luxloop.world.traffic.car import CarParams
from luxloop.world.traffic.models import ModelParams
from luxloop.world.traffic.motorcycle import MotorcycleParams
from luxloop.world.traffic.people import CyclistParams, PedestrianParams
from luxloop.world.traffic.shapes import Piece, blob, block, limb, plate, polygon, tube, xyz
from luxloop.world.traffic.tracked import Looks, RandomParams, Reported, SurfaceParams, TrackedParams, check_parts

SignShape = Literal["round", "triangle", "square", "octagon"]
CORNERS: dict[SignShape, tuple[int, float]] = {
    "round": (24, 0.0),
    "triangle": (3, np.pi / 2),
    "square": (4, np.pi / 4),
    "octagon": (8, np.pi / 8),
}
Clutter = Literal["tree", "bush", "post", "bin", "delineator"]


class TrafficSignParams(RandomParams):
    """A traffic sign of retroreflective sheeting on a post; it faces along its x axis; its origin is the post's foot."""

    kind: Literal["traffic_sign"] = "traffic_sign"
    category: Reported = "sign"
    shape: SignShape | None = Field(None, description="shape of the sign; left out: from the seed")
    height_m: float = Field(2.0, ge=0, le=8, description="height of its lower edge")
    size_m: float = Field(0.6, gt=0.1, le=3, description="diameter, or that of the circle through its corners")

    def build(self) -> Body:
        """Raises LuxloopError where `parts` names an unknown part."""
        rng = self.random()
        shape = self.shape or tuple(CORNERS)[int(rng.integers(len(CORNERS)))]
        corners, turn = CORNERS[shape]
        radius = self.size_m / 2
        middle = np.array([0.05, 0, self.height_m + radius * (0.5 if shape == "triangle" else np.cos(np.pi / corners))])
        dark = shape in ("octagon", "square")
        looks: Looks = {
            "border": ("retroreflective_sign", 0.45 if dark else 0.1),
            "face": ("retroreflective_sign", rng.uniform(0.05, 0.15) if dark else 0.5),
            "picture": ("retroreflective_sign", 0.45) if dark else ("cloth", 0.04),
            "back": ("metal", 0.3),
            "post": ("metal", 0.3),
        }
        pieces = [limb("post", (0, 0, 0), (0, 0, middle[2]), 0.03, 0.03)]
        pieces.append(plate("back", polygon(middle, -1, radius, corners, turn)))
        for k, (part, share) in enumerate((("border", 1.0), ("face", 0.8), ("picture", 0.3))):
            pieces.append(plate(part, polygon(middle + xyz(0.003 * (k + 1), 0, 0), 1, share * radius, corners, turn)))
        return self.body(pieces, looks, self.pose_track())


class ClutterParams(RandomParams):
    """A tree, bush, post, bin or delineator; the origin is its foot."""

    kind: Literal["clutter"] = "clutter"
    shape: Clutter = Field("tree", description="kind of object")

    def build(self) -> Body:
        """Raises LuxloopError where `parts` names an unknown part."""
        rng = self.random()
        looks: Looks = {
            "trunk": ("bark", rng.uniform(0.08, 0.25)),
            "leaves": ("leaves", rng.uniform(0.04, 0.16)),
            "shell": ("metal" if self.shape == "post" else "car_paint", rng.uniform(0.05, 0.6)),
            "lid": ("rubber", 0.05),
            "pole": ("car_paint", 0.6),
            "stripe": ("retroreflective_sign", 0.4),
        }
        return self.body(_clutter(self.shape, rng), looks, self.pose_track())


def _clutter(shape: Clutter, rng: np.random.Generator) -> list[Piece]:
    if shape == "tree":
        height, crown = rng.uniform(4, 9), rng.uniform(0.22, 0.34)
        top = np.array([0.1 * rng.standard_normal(), 0.1 * rng.standard_normal(), 0.62 * height])
        around = [top + height * crown * rng.uniform(-0.5, 0.5, 3) + xyz(0, 0, 0.12 * height) for _ in range(3)]
        trunk = limb("trunk", (0, 0, 0), top, 0.028 * height, 0.016 * height, sides=10)
        return [trunk, *(blob("leaves", each, height * crown * rng.uniform(0.6, 0.9, 3), rng) for each in around)]
    if shape == "bush":
        size = rng.uniform(0.5, 1.1)
        around = [size * rng.uniform(-0.5, 0.5, 3) + xyz(0, 0, 0.6 * size) for _ in range(3)]
        return [blob("leaves", each, size * rng.uniform(0.45, 0.75, 3), rng, 0.2) for each in around]
    if shape == "post":
        height, radius = rng.uniform(0.9, 6), rng.uniform(0.04, 0.09)
        return [tube("shell", [(0, 0, 0), (0, 0, height)], [(radius, radius)] * 2, (0, 1, 0), 12)]
    if shape == "bin":
        x, y, z = rng.uniform((0.4, 0.4, 0.8), (0.8, 1.1, 1.3))
        return [block("shell", (0, 0, 0.47 * z), (x, y, 0.94 * z)), block("lid", (0, 0, 0.97 * z), (1.06 * x, 1.06 * y, 0.06 * z))]
    pole = tube("pole", [(0, 0, 0), (0, 0, 0.95), (0, 0, 1.0)], [(0.06, 0.04), (0.06, 0.04), (0.04, 0.03)], (0, 1, 0), 8)
    return [pole, block("stripe", (0, 0, 0.78), (0.09, 0.13, 0.18))]


Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
AXES = np.eye(3)
FARTHEST_M = 10_000
Side = Annotated[float, Field(gt=0, le=1000)]


class SolidParams(TrackedParams):
    """An object of one surface."""

    albedo: Share = Field(0.2, description="diffuse albedo, when dry")
    material: MaterialName | None = Field(None, description="material by name; left out: matt")

    def part(self, name: str, given: SurfaceParams | None = None) -> Part:
        """A part of it. given: surface that replaces the object's own."""
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
    scale: Positive = Field(1.0, description="metres per unit of the file")
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
    BoxParams
    | MeshParams
    | PedestrianParams
    | CyclistParams
    | MotorcycleParams
    | CarParams
    | AnimalParams
    | TrafficSignParams
    | ClutterParams
    | ModelParams,
    Field(discriminator="kind"),
]
