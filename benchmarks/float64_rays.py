"""Which points a lamp's light gets to, in float64 by Möller and Trumbore's test of every face that is near a ray: slow, no library's."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.world.frames import View
from luxloop.world.scene.triangles import Instance, Triangles

Floats = NDArray[np.float64]
COLUMNS = 2048  # that rays and faces are sorted into
ON_EDGE = 1e-12  # rays through an edge meet a face


def hidden(triangles: Triangles, lamp: View, points: Tensor, tolerance_m: float) -> Tensor:
    """Which points `[3, N]` in m of a lamp's view have a face nearer to it by more than the tolerance along the ray, `[N]` bool."""
    rays = _seen(lamp, points.double().T.numpy())
    hit = np.zeros(len(rays), bool)
    limit = 1 - tolerance_m / np.linalg.norm(rays, axis=1)
    for placed in triangles.placed:
        faces = _seen(lamp, placed.corners.numpy())
        faces = faces[(faces[..., 2] > 1e-3).all(-1)]
        for mine, near in _sorted_together(lamp, rays, faces):
            hit[mine[_nearer(placed, rays[mine], faces[near], limit[mine])]] = True
    return torch.from_numpy(hit)


def _seen(lamp: View, points: Floats) -> Floats:
    T = lamp.T_world_view.numpy()
    return np.asarray((points - T[:3, 3]) @ T[:3, :3])


def _sorted_together(lamp: View, rays: Floats, faces: Floats):  # type: ignore[no-untyped-def]
    """Pairs of rays and faces whose images overlap, column by column of the lamp's view."""
    along, across = ((each[..., axis] / each[..., 2] for each in (rays, faces)) for axis in (0, 1))
    (ray_u, face_u), (ray_v, face_v) = along, across
    edges = np.linspace(ray_u.min(), ray_u.max() + 1e-9, COLUMNS + 1)
    column = np.digitize(ray_u, edges) - 1
    low, high = face_u.min(-1), face_u.max(-1)
    top, bottom = face_v.min(-1), face_v.max(-1)
    first, last = np.digitize(low, edges) - 1, np.digitize(high, edges) - 1
    first, last = first.clip(0), last.clip(max=COLUMNS - 1)
    count = np.maximum(last - first + 1, 0)
    face = np.repeat(np.arange(len(faces)), count)
    bucket = first[face] + np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    face = face[np.argsort(bucket, kind="stable")]
    starts = np.searchsorted(np.sort(bucket), np.arange(COLUMNS + 1))
    order = np.argsort(column, kind="stable")
    bounds = np.searchsorted(column[order], np.arange(COLUMNS + 1))
    for k in range(COLUMNS):
        mine, near = order[bounds[k] : bounds[k + 1]], face[starts[k] : starts[k + 1]]
        if len(mine) and len(near):
            u, v = ray_u[mine, None], ray_v[mine, None]
            pair = np.nonzero((u >= low[near]) & (u <= high[near]) & (v >= top[near]) & (v <= bottom[near]))
            yield mine[pair[0]], near[pair[1]]


def _nearer(placed: Instance, rays: Floats, corners: Floats, limit: Floats) -> NDArray[np.bool_]:
    """Which rays `[M, 3]` from the origin meet their face `[M, 3 corners, 3]` within `limit` `[M]` of their length."""
    a, b, c = corners.transpose(1, 0, 2)
    ab, ac = b - a, c - a
    across = np.cross(rays, ac)
    slope = (ab * across).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = -(a * across).sum(-1) / slope
        turned = np.cross(-a, ab)
        v = (rays * turned).sum(-1) / slope
        t = (ac * turned).sum(-1) / slope
    facing = np.abs(slope) > 0 if placed.body.two_sided else slope > 0
    return facing & (u >= -ON_EDGE) & (v >= -ON_EDGE) & (u + v <= 1 + ON_EDGE) & (t > 0) & (t < limit)
