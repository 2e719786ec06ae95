"""Closed surfaces of which figures consist: tubes, limbs, ellipsoids, plates; each is a piece of a named part."""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import trimesh

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Piece:
    """vertices: `[V, 3]` m. faces: `[F, 3]` of vertices, counter-clockwise from outside. part: name of its part."""

    part: str
    vertices: Floats
    faces: NDArray[np.int64]


def xyz(x: float, y: float, z: float) -> Floats:
    """A point or a way `[3]`."""
    return np.array([x, y, z], float)


def tube(part: str, centres: ArrayLike, radii: ArrayLike, across: ArrayLike, sides: int = 10, power: float = 2.0) -> Piece:
    """Rings around centres `[n, 3]`, closed by flat ends.

    radii: `[n, 2]` m, along `across` `[3]` and square to it. power: of the rings' superellipses, 2 = ellipses, more is more like a box.
    """
    centres, radii = np.asarray(centres, float), np.asarray(radii, float)
    n = len(centres)
    along = np.gradient(centres, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.asarray(across, float) - along * (along @ np.asarray(across, float))[:, None]
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    cos, sin = _ring(sides, power)
    up = along[:, [1, 2, 0]] * side[:, [2, 0, 1]] - along[:, [2, 0, 1]] * side[:, [1, 2, 0]]  # in a tenth of the time of np.cross
    rings = centres[:, None] + (radii[:, :1] * cos)[..., None] * side[:, None] + (radii[:, 1:] * sin)[..., None] * up[:, None]
    return Piece(part, np.concatenate([rings.reshape(-1, 3), centres[[0, -1]]]), _tube_faces(n, sides))


@cache
def _ring(sides: int, power: float) -> tuple[Floats, Floats]:
    """Points on a superellipse of radius 1."""
    angle = np.arange(sides) * 2 * np.pi / sides
    cos, sin = (np.sign(v) * np.abs(v) ** (2 / power) for v in (np.cos(angle), np.sin(angle)))
    return cos, sin


@cache
def _tube_faces(n: int, sides: int) -> NDArray[np.int64]:
    j = np.arange(sides)
    k = (j + 1) % sides
    first = (np.arange(n - 1) * sides)[:, None]
    a, b, c, d = ((first + each).ravel() for each in (j, k, sides + k, sides + j))
    last = (n - 1) * sides
    ends = [np.stack([np.full(sides, n * sides), k, j], 1), np.stack([np.full(sides, n * sides + 1), last + j, last + k], 1)]
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1), *ends])


def limb(part: str, start: ArrayLike, stop: ArrayLike, r_start: float, r_stop: float, sides: int = 7) -> Piece:
    """A tapering limb with rounded ends about two joints `[3]`."""
    start, stop = np.asarray(start, float), np.asarray(stop, float)
    way = stop - start
    length = float(np.linalg.norm(way))
    along = way / length
    at = np.array([-r_start, -0.7 * r_start, 0.0, length, length + 0.7 * r_stop, length + r_stop])
    r = np.array([0.02 * r_start, 0.7 * r_start, r_start, r_stop, 0.7 * r_stop, 0.02 * r_stop])
    across = (0, 1, 0) if abs(along[1]) < 0.9 else (1, 0, 0)
    return tube(part, start + at[:, None] * along, np.stack([r, r], 1), across, sides)


def ellipsoid(part: str, centre: ArrayLike, radii: ArrayLike, sides: int = 12, rings: int = 8) -> Piece:
    """radii: `[3]` m, along x, y and z."""
    a, b, c = np.asarray(radii, float)
    angle = np.linspace(0.02, np.pi - 0.02, rings)
    centres = np.asarray(centre, float) - c * np.cos(angle)[:, None] * (0, 0, 1)
    return tube(part, centres, np.sin(angle)[:, None] * np.array([b, a]), (0, 1, 0), sides)


def torus(part: str, centre: ArrayLike, radius: float, section: float, sides: int, around: int) -> Piece:
    """A tyre in a plane of constant y. radius: of its tread in m; section: of its round cross-section in m, a polygon of `around` sides."""
    vertices, faces = _torus(radius, section, sides, around)
    return Piece(part, vertices + np.asarray(centre, float), faces)


@cache
def _torus(radius: float, section: float, sides: int, around: int) -> tuple[Floats, NDArray[np.int64]]:
    """Vertices about the hub and faces; a trimesh torus takes longer than the rest of a cyclist."""
    import trimesh

    ring = trimesh.creation.torus(radius - section, section, major_sections=sides, minor_sections=around)
    ring.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    return np.array(ring.vertices), np.array(ring.faces, dtype=np.int64)


def block(part: str, centre: ArrayLike, size: ArrayLike) -> Piece:
    """A box along the axes, with corners of its own for each face, so that smooth normals leave its edges sharp."""
    corners = _cube() * np.asarray(size, float) + np.asarray(centre, float)
    return Piece(part, corners, np.arange(len(corners)).reshape(-1, 3))


@cache
def _cube() -> Floats:
    """Corners `[36, 3]` of the faces of a cube of side 1, one after the other."""
    import trimesh

    return np.array(trimesh.creation.box().triangles).reshape(-1, 3)


def plate(part: str, corners: ArrayLike) -> Piece:
    """A flat convex polygon `[n, 3]`, seen from where its corners run counter-clockwise."""
    corners = np.asarray(corners, float)
    i = np.arange(1, len(corners) - 1)
    return Piece(part, corners, np.stack([np.zeros_like(i), i, i + 1], 1))


def polygon(centre: ArrayLike, normal_x: float, radius: float, corners: int, turn: float = 0.0) -> Floats:
    """Corners `[n, 3]` of a regular polygon in a plane of constant x, counter-clockwise seen from where `normal_x` (1 or -1) points."""
    angle = turn + np.arange(corners) * 2 * np.pi / corners * normal_x
    return np.asarray(centre, float) + radius * np.stack([np.zeros(corners), np.cos(angle), np.sin(angle)], 1)


def blob(part: str, centre: ArrayLike, radii: ArrayLike, rng: np.random.Generator, roughness: float = 0.15) -> Piece:
    """A ball of 320 faces whose corners are moved in and out at random, as crowns of trees are."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2)
    away = ball.vertices * (1 + roughness * rng.standard_normal((len(ball.vertices), 1)).clip(-2, 2))
    return Piece(part, away * np.asarray(radii, float) + np.asarray(centre, float), np.asarray(ball.faces, dtype=np.int64))


def join(pieces: list[Piece]) -> tuple["trimesh.Trimesh", tuple[str, ...], NDArray[np.int64]]:
    """One mesh, the names of its parts in order, and the part index `[F]` of each face."""
    import trimesh

    names = tuple(dict.fromkeys(piece.part for piece in pieces))
    firsts = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    faces = np.concatenate([piece.faces + first for piece, first in zip(pieces, firsts[:-1], strict=True)])
    of_face = np.concatenate([np.full(len(piece.faces), names.index(piece.part)) for piece in pieces])
    return trimesh.Trimesh(np.concatenate([piece.vertices for piece in pieces]), faces, process=False), names, of_face
