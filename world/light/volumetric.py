"""Beams in haze, fog and rain: light that the air scatters once, from a module towards the eye."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop.world.frames import View, inverse
from luxloop.world.light.emitters import Source
from luxloop.world.rendering.raycast import depths
from luxloop.world.rendering.surfaces import FaceSource
from luxloop.world.scene.triangles import Triangles


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


CHUNK = 1 << 18  # samples that are in memory at a time
NEAREST_M = 0.02  # a ray through a module itself would see an infinitely bright point
CONTRAST = 0.05  # that a black object keeps at the meteorological optical range


@dataclass(frozen=True)
class Medium:
    """Homogeneous air with droplets; asymmetry: mean cosine of the angle by which it scatters, -1 < g < 1, forward positive."""

    scattering_per_m: float
    extinction_per_m: float
    asymmetry: float = 0.8

    @classmethod
    def fog(cls, visibility_m: float) -> "Medium":
        """Droplets that absorb nothing; visibility_m: meteorological optical range, `-ln 0.05 / extinction` (Koschmieder)."""
        extinction = -math.log(CONTRAST) / visibility_m
        return cls(extinction, extinction)


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
    T_source_world = inverse(source.T_world_source).to(directions)
    R = T_source_world[:3, :3]
    eye = R @ origin.to(directions) + T_source_world[:3, 3]
    rays = R @ directions
    near, far = _inside(source, eye, rays, far_m)
    index = torch.nonzero(far > near)[:, 0]
    batch = source.texture.shape[:-2]
    light = directions.new_zeros(*batch, directions.shape[1])
    texture = source.texture.to(directions).flatten(0, -3)[None] if batch else source.texture.to(directions)[None, None]
    for part in index.split(max(CHUNK // samples, 1)):
        found = _march(source, texture, (eye, rays[:, part], near[part], far[part]), medium, samples, shadow)
        light[..., part] = found.unflatten(0, batch) if batch else found[0]
    return light


def _inside(source: Source, eye: Tensor, rays: Tensor, far_m: Tensor) -> tuple[Tensor, Tensor]:
    """Begin and end `[N]` in m of the parts of rays of lengths `[N]` m within the pyramid of the light texture."""
    grid = source.headlight
    planes = rays.new_tensor([[-grid.right, 1, 0], [grid.left, -1, 0], [-grid.bottom, 0, 1], [grid.top, 0, -1], [1, 0, 0]])
    at_eye, slope = (planes @ eye)[:, None], planes @ rays
    crossing = -at_eye / slope
    entering = torch.where(slope > 0, crossing, -torch.inf).amax(0).clamp(min=0)
    leaving = torch.minimum(torch.where(slope < 0, crossing, torch.inf).amin(0), far_m)
    outside = ((slope == 0) & (at_eye < 0)).any(0)
    return entering, torch.where(outside, -torch.inf, leaving)


def _march(
    source: Source, texture: Tensor, lit: tuple[Tensor, Tensor, Tensor, Tensor], medium: Medium, samples: int, shadow: ShadowMap | None
) -> Tensor:
    """Luminance `[B, M]` of M parts of rays. texture: `[1, B, rows, cols]` cd. lit: eye `[3]` m and rays `[3, M]` unit in the headlight
    frame, begin and end `[M]` m.
    """
    grid, (eye, rays, near, far) = source.headlight, lit
    closest = -(eye @ rays)
    height = (eye[:, None] + closest * rays).norm(dim=0).clamp(min=NEAREST_M)
    first, last = ((end - closest).div(height).atan() for end in (near, far))
    step = (last - first) / samples
    angle = first[:, None] + step[:, None] * (torch.arange(samples, device=rays.device, dtype=rays.dtype) + 0.5)  # [M, samples]
    along = closest[:, None] + height[:, None] * angle.tan()  # m from the eye
    x, y, z = (eye[i] + rays[i][:, None] * along for i in range(3))
    at = torch.stack(
        [
            (2 * (y / x) - grid.left - grid.right) / (grid.right - grid.left),
            (2 * (z / x) - grid.top - grid.bottom) / (grid.bottom - grid.top),
        ],
        -1,
    )
    intensity = grid_sample(texture, at[None], padding_mode="border", align_corners=False)[0]  # [B, M, samples]
    # The light flies from the source to the point, then from there back along the ray: its deflection's cosine is that of both.
    distance = height[:, None] / angle.cos()
    weight = phase(-angle.sin(), medium.asymmetry) * torch.exp(-medium.extinction_per_m * (distance + along))
    if shadow is not None:
        T = source.T_world_source.to(rays)
        points = T[:3, :3] @ torch.stack([x, y, z]).flatten(1) + T[:3, 3:]
        weight = weight * visible(shadow, points).unflatten(0, along.shape)
    return (intensity * weight).sum(-1) * (medium.scattering_per_m * step / height)
