"""The assumed road: the plane z = 0 as a G-buffer, in closed form."""

import torch

from luxloop.world.materials.brdf import LAMBERTIAN, Material
from luxloop.world.rendering.gbuffer import Finish, GBuffer
from luxloop.world.view import View


def flat_road(view: View, albedo: float, dtype: torch.dtype = torch.float32, material: Material = LAMBERTIAN) -> GBuffer:
    """G-buffer `[3, H, W]` of the plane z = 0 with one albedo (0..1) and material; what looks above the horizon has object id -1."""
    rays, origin = view.rays(), view.origin[:, None, None]
    down = rays[2] < -1e-9
    distance = torch.where(down, -origin[2] / rays[2].where(down, -1.0), 0.0)
    position = rays.mul_(distance).add_(origin).mul_(down).to(dtype)
    normal = torch.zeros_like(position)
    normal[2] = down
    object_id = torch.where(down, 0, -1).to(torch.int32)
    finish = None if material.lambertian else Finish((LAMBERTIAN, material), down.to(torch.int64), view.origin)
    return GBuffer(position, normal, albedo * down.to(dtype), object_id, finish)
