"""Triangles of a scene at one time, and the intersection of rays with their planes."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from types import EllipsisType
from typing import Final

import numpy as np
import torch
from torch import Tensor

from luxloop.world.frames import inverse, transform
from luxloop.world.scene.body import Body
from luxloop.world.scene.embree import EmbreeMesh

CHUNK: Final = 2**15  # rays at a time, whose numbers stay in the processor's cache


@dataclass(frozen=True, eq=False)
class Instance:
    """A body at a pose. object_id: index of the body in its scene. T_world_body: `[4, 4]` float64."""

    object_id: int
    body: Body
    T_world_body: Tensor

    @cached_property
    def T_body_world(self) -> Tensor:
        """Inverse of `T_world_body`."""
        return inverse(self.T_world_body)

    @property
    def corners(self) -> Tensor:
        """Corners of the faces in the world, `[F, 3 corners, 3]` float64 m."""
        return self.corners_of(...)

    def corners_of(self, faces: np.ndarray | EllipsisType) -> Tensor:
        """`corners` of some faces."""
        return self.body.corners_of(faces) @ self.T_world_body[:3, :3].T + self.T_world_body[:3, 3]

    @cached_property
    def corner_normals(self) -> Tensor:
        """Unit normals at the corners in the world, `[F, 3 corners, 3]` float32."""
        return (self.body.corner_normals @ self.T_world_body[:3, :3].T).float()

    @cached_property
    def box(self) -> Tensor:
        """Corners of the body's bounding box in the world, `[8, 3]` float64 m."""
        return torch.cartesian_prod(*self.body.bounds.T) @ self.T_world_body[:3, :3].T + self.T_world_body[:3, 3]

    @property
    def n_faces(self) -> int:
        return len(self.body.mesh.faces)


@dataclass(frozen=True, eq=False)
class Group:
    """Placed bodies with one embree scene, such as all static ones; the group caches that scene."""

    placed: tuple[Instance, ...]

    @cached_property
    def off_road(self) -> "Group":
        """The group without the road."""
        bodies = tuple(each for each in self.placed if not each.body.ground)
        return self if len(bodies) == len(self.placed) else Group(bodies)

    @cached_property
    def road(self) -> tuple[Tensor, Tensor]:
        """Corners `[F, 3 corners, 3]` m of the road's faces in the world, and these faces' planes `[4, F]`, both float64.

        A plane's product with (x, y, z, 1) is the height in m above it.
        """
        a, b, c = torch.cat([torch.empty(0, 3, 3).double(), *(each.corners for each in self.placed if each.body.ground)]).unbind(1)
        normal = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=-1)
        return torch.stack([a, b, c], 1), torch.cat([normal, -(normal * a).sum(-1, keepdim=True)], 1).T.contiguous()

    @cached_property
    def embree(self) -> tuple[EmbreeMesh, Tensor]:
        """Embree's copy, and `[4, 4]` float64 from the world to its frame: that of the body, or one in the middle of several."""
        if len(self.placed) == 1:
            return self.placed[0].body.embree, self.placed[0].T_body_world
        meshes = [each.body.mesh for each in self.placed]
        vertices = [transform(each.T_world_body, torch.from_numpy(np.array(each.body.mesh.vertices)).T).T for each in self.placed]
        firsts = np.cumsum([0, *map(len, vertices)])
        faces = torch.from_numpy(np.concatenate([mesh.faces + first for mesh, first in zip(meshes, firsts, strict=False)]))
        corners = torch.cat(vertices)
        T_group_world = torch.eye(4, dtype=torch.float64)
        T_group_world[:3, 3] = -corners.mean(0)
        two_sided = torch.tensor([each.body.two_sided for each in self.placed])
        counts = torch.tensor([each.n_faces for each in self.placed])
        return EmbreeMesh(corners + T_group_world[:3, 3], faces, two_sided.repeat_interleave(counts)), T_group_world


@dataclass(frozen=True, eq=False)
class Triangles:
    """All triangles of a scene at one time; face ids count through the placed bodies in their order."""

    groups: tuple[Group, ...]

    @classmethod
    def of(cls, *placed: Instance) -> "Triangles":
        """Placed bodies as one group."""
        return cls((Group(placed),))

    @cached_property
    def placed(self) -> tuple[Instance, ...]:
        """All placed bodies."""
        return tuple(each for group in self.groups for each in group.placed)

    @cached_property
    def off_road(self) -> "Triangles":
        """All but the road."""
        return Triangles(tuple(group.off_road for group in self.groups if group.off_road.placed))

    def parts(self) -> Iterator[tuple[int, Instance]]:
        """Each placed body with its first face id."""
        first = 0
        for placed in self.placed:
            yield first, placed
            first += placed.n_faces


NOTHING = Triangles(())


@dataclass(frozen=True)
class Hits:
    """Some rays on one body, M of them. pixels: `[M]`, index of the ray. faces: `[M]`, index of the body's face.

    depth: `[M]`, in lengths of the ray's direction. barycentric: `[3 corners, M]`, within -0.1 and 1.2.
    front: `[M]`, the face is seen from the side where its corners run counter-clockwise.
    """

    placed: Instance
    pixels: Tensor
    faces: Tensor
    depth: Tensor
    barycentric: Tensor
    front: Tensor

    def only(self, some: Tensor) -> "Hits":
        """The hits that a mask `[M]` bool selects."""
        return Hits(self.placed, self.pixels[some], self.faces[some], self.depth[some], self.barycentric[:, some], self.front[some])


def intersect(triangles: Triangles, face_ids: Tensor, origin: Tensor, directions: Tensor) -> Iterator[Hits]:
    """Intersect rays with the planes of faces that they are known to hit, in float64; yields chunks of rays on one body.

    face_ids: `[N]` int64, -1 = none. origin: `[3]` m, common to all rays. directions: `[3, N]`, any length.

    A ray may miss its face by rounding. Then the plane is extended, which suits neighbours of similar slope; beyond a tenth of the face
    (edge-on or tiny) the face's nearest point counts.
    """
    for hits in on_planes(triangles, face_ids, origin, directions):
        beside = torch.nonzero(~(hits.barycentric.amin(0) >= -0.1))[:, 0]
        if len(beside):
            held = hits.barycentric[:, beside].nan_to_num(1.0, 1.0, 0.0).clamp(min=0.0)  # [3 corners, m]
            hits.barycentric[:, beside] = held = held / held.sum(0)
            along = directions[:, hits.pixels[beside]]  # d [3, m]
            corners = hits.placed.corners_of(hits.faces[beside].numpy()) - origin
            points = torch.einsum("im,mij->jm", held, corners)  # p = sum_i w_i corner_i, [3, m]
            hits.depth[beside] = (points * along).sum(0) / (along * along).sum(0)  # of the ray's point nearest to p, [m]
        yield hits


def on_planes(triangles: Triangles, face_ids: Tensor, origin: Tensor, directions: Tensor) -> Iterator[Hits]:
    """Rays on the planes of their faces, which may extend beyond these; parameters as of `intersect`."""
    for first, placed in triangles.parts():
        pixels = torch.nonzero((face_ids >= first) & (face_ids < first + placed.n_faces))[:, 0]
        if not len(pixels):
            continue
        seen = torch.zeros(placed.n_faces, dtype=torch.bool)
        faces = face_ids[pixels] - first
        seen[faces] = True
        # A direction d = sum_i w_i corner_i, corners relative to the origin, has w_i = d . edge_i / volume, edge_i being the cross product
        # of the two other corners: w_i are the barycentric coordinates times 1 / depth.
        a, b, c = (placed.corners_of(seen.numpy()) - origin).unbind(1)  # of the S faces that are seen, [S, 3] each
        edges = torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], 1)  # [S, 3 corners, 3]
        volume = (a * edges[:, 0]).sum(-1)  # triple product a (b x c), [S]
        compact = torch.cumsum(seen, 0) - 1
        for some, on in zip(pixels.split(CHUNK), faces.split(CHUNK), strict=True):
            edge, d = edges.index_select(0, compact[on]), directions[:, some]  # [M, 3 corners, 3], [3, M]
            w = torch.stack([edge[:, i, 0] * d[0] + edge[:, i, 1] * d[1] + edge[:, i, 2] * d[2] for i in range(3)])  # w_i volume, [3, M]
            total = w[0] + w[1] + w[2]  # volume / depth, since barycentric coordinates add up to 1, [M]
            volumes = volume[compact[on]]
            yield Hits(placed, some, on, volumes / total, w / total, volumes < 0)
