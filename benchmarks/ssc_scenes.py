"""What is timed: lamps with the pixels and rays of the thesis' tables B.1 to B.4, a symbol, many primitives, and SSC in plain torch."""

import itertools
import math

import torch
from spmv_lamps import overlapping
from torch import Tensor

from luxloop.controllers.pixels.primitives import Primitives, concatenate, rectangle, road_symbol
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr
from luxloop.world.texels import TexelGrid

T_WORLD_LAMP = pose_from_degrees((0.0, 0.6, 0.75))
HALF_WIDTH_DEG, HALF_HEIGHT_DEG = 10.0, 5.0
OVERLAP = 1.25  # of a pixel's pitch
BOARDS = (4, 9)
COVER = 0.925  # of a board's share of the field along each axis, for 77 % in all


def lamp(rows: int, cols: int, texel_rows: int, texel_cols: int) -> Headlight:
    """rows x cols overlapping pixels on +-5 x +-10 deg."""
    grid = TexelGrid.from_degrees(texel_rows, texel_cols, HALF_WIDTH_DEG, -HALF_WIDTH_DEG, -HALF_HEIGHT_DEG, HALF_HEIGHT_DEG)
    made = overlapping("", rows, cols, grid, HALF_HEIGHT_DEG, HALF_WIDTH_DEG, OVERLAP)
    matrix = Csr.from_scipy(made.matrix)
    return Headlight(name=f"{rows} x {cols}", matrix=matrix, pixel_rows=rows, pixel_cols=cols, **vars(grid))


def symbol(width_m: float = 2.15) -> Primitives:
    """A symbol of 256 x 128 grey values on the road."""
    image = torch.rand(256, 128, generator=torch.Generator().manual_seed(1))
    return road_symbol(torch.tensor([14.0, 0.6, 0.0, 0.0]), 0.0, width_m, 4.9, image, 1.0, "u_abs")


def many() -> Primitives:
    """36 boards at several distances all over the field: lit, asked for lx and cd, masked, with images, forced and not."""
    image = torch.rand(256, 128, generator=torch.Generator().manual_seed(2))
    tall = 2 * math.tan(math.radians(HALF_HEIGHT_DEG)) / BOARDS[0]
    wide = 2 * math.tan(math.radians(HALF_WIDTH_DEG)) / BOARDS[1]
    toward = torch.tensor([-1.0, 0.0, 0.0])
    boards = []
    for k, (row, col) in enumerate(itertools.product(*map(range, BOARDS))):
        x = 20.0 + k % 7
        y, z = x * wide * (col - (BOARDS[1] - 1) / 2), x * tall * (row - (BOARDS[0] - 1) / 2)
        w, h = 0.9 * COVER * wide * x, COVER * tall * x
        quantity, value, weight = [("u_abs", 1.0, 1.0), ("E_v", 2.0, 1.0), ("u_abs", 0.0, math.inf), ("I_v", 800.0, 2.0)][k % 4]
        origin = T_WORLD_LAMP[:3, 3].float() + torch.tensor([x, y + w / 2, z + h / 2])
        edges = torch.tensor([0.0, -w, 0.0]), torch.tensor([0.0, 0.0, -h])
        drawn = image if k % 9 == 3 else None
        boards.append(
            rectangle(origin, *edges, value, quantity, normal=toward, weight=weight, symbol=drawn, forced=k % 5 == 0, priority=k % 3)
        )
    return concatenate(*boards)


def covered(scene: Primitives, light: Headlight) -> float:
    """Share of the texture that primitives cover."""
    from luxloop.controllers.pixels.rthc import trace

    return trace(scene, light, T_WORLD_LAMP).hit.double().mean().item()


class Plain:
    """SSC of one symbol as it is first written in torch: stored rays, a solver a ray, and every entry of the matrix one by one."""

    def __init__(self, light: Headlight) -> None:
        entries = light.matrix
        self.texel = torch.repeat_interleave(torch.arange(light.n_texels), (entries.indptr[1:] - entries.indptr[:-1]).long())
        self.pixel, self.I_m, self.light = entries.indices.long(), entries.values, light
        y, z = light.tangents(torch.float32, torch.device("cpu"))
        z, y = torch.meshgrid(z, y, indexing="ij")
        rays = torch.stack([torch.ones_like(y), y, z], -1).reshape(-1, 3)
        self.rays = rays / rays.norm(dim=1, keepdim=True) @ T_WORLD_LAMP[:3, :3].T.float()

    def __call__(self, primitive: Primitives) -> Tensor:
        """Utilisation `[n_p]`."""
        origin, d1, d2, normal = (v[0] for v in (primitive.origin, primitive.d1, primitive.d2, primitive.normal))
        system = torch.stack([self.rays, (-d1).expand_as(self.rays), (-d2).expand_as(self.rays)], -1)
        length, u, v = torch.linalg.solve(system, (origin - T_WORLD_LAMP[:3, 3].float()).expand_as(self.rays)).unbind(-1)
        hit = (length > 0) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1) & (self.rays @ normal < 0)
        place = torch.stack([2 * u - 1, 2 * v - 1], -1)[None, None]
        image = primitive.symbols[0][None, None]
        seen = torch.nn.functional.grid_sample(image, place, padding_mode="border", align_corners=False)[0, 0, 0]
        setpoint = torch.where(hit, seen * primitive.value[0], 0.0)
        I_s = (self.I_m * setpoint[self.texel]).clamp(min=0).minimum(self.I_m)
        zero = torch.zeros(self.light.n_pixels)
        total = zero.index_add(0, self.pixel, self.I_m)
        return (zero.index_add(0, self.pixel, self.I_m * (I_s / self.I_m)) / total).nan_to_num().clamp(0, 1)
