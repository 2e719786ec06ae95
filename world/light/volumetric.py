"""Beams in haze, fog and rain: light that the air scatters once, from a module towards the eye."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop.world.frames import View, inverse
from luxloop.world.headlight import Headlight
from luxloop.world.light.emitters import Source
from luxloop.world.rendering.raycast import depths
from luxloop.world.rendering.surfaces import FaceSource
from luxloop.world.scene.air import Medium
from luxloop.world.scene.triangles import Triangles
from luxloop.world.spmv import Csr


@dataclass(frozen=True, eq=False)
class ShadowMap:
    """depth: `[height, width]` float32 m along the lamp's optical axis at the texels' centres, infinite where nothing is hit."""

    view: View
    depth: Tensor


def shadow_map(triangles: Triangles, view: View, source: FaceSource) -> ShadowMap:
    """The shadow map of a lamp that looks through `view`, whose width and height are the map's resolution."""
    face_ids = source.face_ids(triangles, view)
    depth = depths(triangles, face_ids.flatten(), view.origin, view.rays().flatten(1))
    return ShadowMap(view, depth.float().view(view.height, view.width))


def visible(shadow: ShadowMap, points: Tensor) -> Tensor:
    """Whether world points `[..., 3, N]` in m see the lamp, `[..., N]` bool, to one texel; points outside the map get no light and count as
    visible.
    """
    image, depth = shadow.view.project(points)
    column, row = image[..., 0, :], image[..., 1, :]
    inside = (depth > 0) & (column >= 0) & (column < shadow.view.width) & (row >= 0) & (row < shadow.view.height)
    farthest = shadow.depth[torch.where(inside, row, 0).long(), torch.where(inside, column, 0).long()]
    return ~inside | (depth <= farthest)


CHUNK: Final = 1 << 18  # samples that are in memory at a time
NEAREST_M: Final = 0.02  # a ray through a module itself would see an infinitely bright point
FARTHEST_M: Final = 400.0  # length of a ray through fog that hits nothing


def phase(cosine: Tensor, asymmetry: float) -> Tensor:
    """Share of scattered light that goes into a unit of solid angle, 1/sr, by the cosine of deflection (Henyey and Greenstein)."""
    g = asymmetry
    return (1 - g * g) / (4 * math.pi) * (1 + g * g - 2 * g * cosine).rsqrt().pow(3)


def airlight(
    source: Source,
    origin: Tensor,
    directions: Tensor,
    far_m: Tensor,
    medium: Medium,
    samples: int = 64,
    shadow: ShadowMap | None = None,
) -> Tensor:
    """Luminance `[..., N]` in cd/m^2 of the air between an eye and the surfaces that it sees; leading dimensions are the texture's.

    origin: `[3]` m, directions: `[3, N]` unit, of the world; far_m: `[N]`, length of the rays. The integral along a ray `sigma_s p(theta) I
    / d^2 exp(-sigma_t (d + s)) V ds` is taken over the angle at the source, in which 1/d^2 ds is uniform and texels are equally large, and
    only where the ray is in the beam: `samples` midpoints each.
    """
    grid, batch = source.headlight, source.texture.shape[:-2]
    light = directions.new_zeros(*batch, directions.shape[1])
    texture = source.texture.to(directions).flatten(0, -3)[None] if batch else source.texture.to(directions)[None, None]
    for part, points, weight in _midpoints(grid, source.T_world_source, origin, directions, far_m, medium, samples):
        x, y, z = points
        if shadow is not None:
            T = source.T_world_source.to(points)
            weight = weight * visible(shadow, T[:3, :3] @ points.flatten(1) + T[:3, 3:]).unflatten(0, weight.shape)
        at = torch.stack(
            [
                (2 * (y / x) - grid.left - grid.right) / (grid.right - grid.left),
                (2 * (z / x) - grid.top - grid.bottom) / (grid.bottom - grid.top),
            ],
            -1,
        )
        intensity = grid_sample(texture, at[None], padding_mode="border", align_corners=False)[0]  # [B, M, samples]
        found = (intensity * weight).sum(-1)
        light[..., part] = found.unflatten(0, batch) if batch else found[0]
    return light


def airlight_matrix(
    headlight: Headlight,
    T_world_headlight: Tensor,
    origin: Tensor,
    directions: Tensor,
    far_m: Tensor,
    medium: Medium,
    samples: int,
) -> Csr:
    """The operator of `airlight`, `[N, n_texels]`, from a light texture in cd, whose nearest texels it samples, to cd/m^2; no shadows."""
    rows, columns, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0, np.float32)]
    for part, (x, y, z), weight in _midpoints(headlight, T_world_headlight, origin, directions, far_m, medium, samples):
        places = zip(headlight.texel_of(y / x, z / x), (headlight.rows, headlight.cols), strict=True)
        row, column = (at.long().clamp_(0, n - 1) for at, n in places)
        rows.append(part[:, None].expand_as(row).flatten().numpy())
        columns.append((row * headlight.cols + column).flatten().numpy())
        values.append(weight.flatten().numpy())
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return Csr.from_scipy(sp.coo_matrix(entries, shape=(directions.shape[1], headlight.n_texels)))


def _midpoints(
    light: Headlight, T_world_headlight: Tensor, origin: Tensor, directions: Tensor, far_m: Tensor, medium: Medium, samples: int
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Chunks of the rays that cross the beam: their numbers `[M]`, points `[3, M, samples]` m in the headlight frame, and the luminance in
    cd/m^2 `[M, samples]` that 1 cd towards each point adds.
    """
    T = inverse(T_world_headlight).to(directions)
    eye, rays = T[:3, :3] @ origin.to(directions) + T[:3, 3], T[:3, :3] @ directions
    near, far = _inside(light, eye, rays, far_m)
    for part in torch.nonzero(far > near)[:, 0].split(max(CHUNK // samples, 1)):
        closest = -(eye @ rays[:, part])
        height = (eye[:, None] + closest * rays[:, part]).norm(dim=0).clamp(min=NEAREST_M)
        first, last = ((end[part] - closest).div(height).atan() for end in (near, far))
        step = (last - first) / samples
        angle = first[:, None] + step[:, None] * (torch.arange(samples).to(rays) + 0.5)  # [M, samples]
        along = closest[:, None] + height[:, None] * angle.tan()  # m from the eye
        # The light flies from the source to the point, then from there back along the ray: its deflection's cosine is that of both.
        passed = torch.exp(-medium.extinction_per_m * (height[:, None] / angle.cos() + along))
        weight = phase(-angle.sin(), medium.asymmetry) * passed
        scattering = medium.scattering_at(along) * step[:, None] / height[:, None]
        yield part, eye[:, None, None] + rays[:, part, None] * along, weight * scattering


def _inside(grid: Headlight, eye: Tensor, rays: Tensor, far_m: Tensor) -> tuple[Tensor, Tensor]:
    """Begin and end `[N]` in m of the parts of rays of lengths `[N]` m within the pyramid of the light texture."""
    planes = rays.new_tensor([[-grid.right, 1, 0], [grid.left, -1, 0], [-grid.bottom, 0, 1], [grid.top, 0, -1], [1, 0, 0]])
    at_eye, slope = (planes @ eye)[:, None], planes @ rays
    crossing = -at_eye / slope
    entering = torch.where(slope > 0, crossing, -torch.inf).amax(0).clamp(min=0)
    leaving = torch.minimum(torch.where(slope < 0, crossing, torch.inf).amin(0), far_m)
    outside = ((slope == 0) & (at_eye < 0)).any(0)
    return entering, torch.where(outside, -torch.inf, leaving)
