"""Which points a lamp's light gets to, in float64 by Möller and Trumbore's test of every face that is near a ray: slow, no library's."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.world.frames import View
from luxloop.world.scene.triangles import Instance, Triangles

Floats = NDArray[np.float64]
CHUNK = 64  # rays that are held against the same faces
ON_EDGE = 1e-12  # rays through an edge meet a face


def hidden(triangles: Triangles, lamp: View, points: Tensor, tolerance_m: float) -> Tensor:
    """Which points `[3, N]` in m of a lamp's view have a face nearer to it by more than the tolerance along the ray, `[N]` bool."""
    T = lamp.T_world_view.numpy()
    rays = (points.double().T.numpy() - T[:3, 3]) @ T[:3, :3]
    image, hit = rays[:, :2] / rays[:, 2:], np.zeros(len(rays), bool)
    limit = 1 - tolerance_m / np.linalg.norm(rays, axis=1)
    order = np.argsort(image[:, 0])
    for placed in triangles.placed:
        faces = (placed.corners.numpy() - T[:3, 3]) @ T[:3, :3]
        faces = faces[(faces[..., 2] > 1e-3).all(-1)]
        corners = faces[..., :2] / faces[..., 2:]
        low, high = corners.min(1), corners.max(1)  # [faces, 2]
        for chunk in np.split(order, range(CHUNK, len(order), CHUNK)):
            at = image[chunk][:, None]  # [rays, 1, 2]
            near = np.flatnonzero((low[:, 0] <= at[-1, 0, 0]) & (high[:, 0] >= at[0, 0, 0]))
            pair = np.nonzero(((at >= low[near]) & (at <= high[near])).all(-1))
            mine = chunk[pair[0]]
            hit[mine[_nearer(placed, rays[mine], faces[near[pair[1]]], limit[mine])]] = True
    return torch.from_numpy(hit)


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
