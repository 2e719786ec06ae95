"""Target illuminance on a plane, and the utilisations of all modules that together come closest to it (T 4.2.2).

The plane is z = 0 of its own frame, whose z axis points to the side of the lamps: the road, or a wall. A cell's illuminance is the mean of
the texels whose rays hit it, weighted by area, or of 3 x 3 points if few rays hit it or cover only a part.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.frames import inverse, transform
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr, multiply, solve
from luxloop.world.texels import TexelGrid, bilinear

ITERATIONS = 150
BLOCK = 0.003  # size, in tangents, of the blocks of directions without a target, each of which keeps its light
BESIDE_M = 25.0  # distance at which directions beside the raster count, facing the lamp
MUCH = 0.5  # least share of the brightest pixel's intensity towards a point for a pixel to be listed
FEW = 64  # texels of a cell below which 3 x 3 points are used
WHOLE = 0.8  # share of a cell's area covered by texels below which 3 x 3 points are used, as at the border of the field
POINTS = 3  # sample points along x and y of a cell with few texels
NEAREST_M = 0.01  # least distance of cells to a lamp
THERE = 0.3  # least share of a pixel's own peak intensity towards a point for it to be listed
OWN = 0.1  # least share of a pixel's own peak intensity in cells with a target for it to be chosen


@dataclass(frozen=True)
class Raster:
    """rows x cols cells of the plane z = 0: rows along x, columns along y, from the box's x_min and y_min on."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float
    rows: int
    cols: int

    @property
    def cell_area(self) -> float:
        """Area of a cell in m^2."""
        return (self.x_max - self.x_min) * (self.y_max - self.y_min) / (self.rows * self.cols)

    def points(self, n: int = 1) -> Tensor:
        """n x n points of each cell, `[3, n^2, rows * cols]`: its centre for 1."""
        shares = (torch.arange(n, dtype=torch.float64) + 0.5) / n
        x = self.x_min + (torch.arange(self.rows) + shares[:, None]) * (self.x_max - self.x_min) / self.rows  # [n, rows]
        y = self.y_min + (torch.arange(self.cols) + shares[:, None]) * (self.y_max - self.y_min) / self.cols
        x, y = torch.broadcast_tensors(x[:, None, :, None], y[None, :, None, :])
        return torch.stack([x, y, torch.zeros_like(x)]).reshape(3, n * n, self.rows * self.cols)

    def cells(self, x: Tensor, y: Tensor) -> Tensor:
        """Cell indices of points x, y in m; -1 outside."""
        row = ((x - self.x_min) / (self.x_max - self.x_min) * self.rows).floor()
        col = ((y - self.y_min) / (self.y_max - self.y_min) * self.cols).floor()
        inside = (row >= 0) & (row < self.rows) & (col >= 0) & (col < self.cols)
        return torch.where(inside, row * self.cols + col, -1.0).long()


@dataclass(frozen=True, eq=False)
class PlaneModule:
    """A module with its pose `[4, 4]` in the frame of the plane, and its present and largest utilisation, `[n_p]` each."""

    headlight: Headlight
    T_plane_headlight: Tensor
    u: Tensor
    limit: Tensor


@dataclass(frozen=True, eq=False)
class PlaneLight:
    """Result. u: utilisation `[n_p]` of each module. chosen: `[n_p]` bool of each module, the fitted pixels. lx: `[cells]`, illuminance.

    error_lx: deviation of the field, cells and blocks of directions, from target or present light. weight: by area, 0 where no fitted pixel
    shines and in cells without a target.
    """

    u: tuple[Tensor, ...]
    chosen: tuple[Tensor, ...]
    lx: Tensor
    error_lx: Tensor
    weight: Tensor

    @property
    def rmse_lx(self) -> float:
        """Root of the mean squared error over the area of the field."""
        return float((self.weight * self.error_lx.square()).sum().div(self.weight.sum()).sqrt())

    @property
    def worst_lx(self) -> float:
        """Largest error of the field."""
        return float((self.error_lx.abs() * (self.weight > 0)).max())


def fit_plane(lamps: Sequence[PlaneModule], raster: Raster, wanted_lx: Tensor, where: Tensor, iterations: int = ITERATIONS) -> PlaneLight:
    """Utilisations with the least squared error of the whole field below the limits, in 255 steps.

    Pixels at their limits are then fitted without them, for times with other limits; the resulting light is that below the limits.

    wanted_lx: target `[cells]` in lx. where: `[cells]` bool, cells with a target; the rest of the field keeps its light. Pixels that light
    no cell with a target keep their utilisation. Raises LuxloopError if no pixel lights these cells.
    """
    planes, beside, weights, chosen = [], [], [where.float()], []
    for each in lamps:
        on_plane, rays = _on_plane(each.headlight, each.T_plane_headlight, raster)
        A = each.headlight.matrix.to_scipy()
        there = (on_plane[where.numpy()] > 0).astype(np.float32).sum(0) > 0
        reach = A[np.flatnonzero(there)].max(0).toarray()[0] if there.any() else np.zeros(each.headlight.n_pixels)
        most = A.max(0).toarray()[0]
        chosen.append(torch.from_numpy((reach >= OWN * most) & (most > 0)))
        elsewhere, area = rays.blocks(each.headlight, where)
        planes.append(on_plane @ A)
        beside.append(elsewhere @ A)
        weights.append(area / raster.cell_area)
    free = torch.cat(chosen)
    if not free.any():
        raise LuxloopError("wish: no pixel lights the place where light is wanted; paint it within the field of a lamp")
    joint = sp.vstack([sp.hstack(planes), sp.block_diag(beside)], "csr")
    now, limit = (torch.cat([getattr(each, name).float().cpu() for each in lamps]) for name in ("u", "limit"))
    A, weight, limit = Csr.from_scipy(joint), torch.cat(weights).float(), (255 * limit).floor() / 255
    target = multiply(A, now)
    target[: len(where)] = torch.where(where, wanted_lx, target[: len(where)]).float()

    def fit(u: Tensor, pixels: Tensor, upper: Tensor) -> Tensor:
        part, rest = Csr.from_scipy(joint[:, pixels.numpy()].tocsr()), target - multiply(A, torch.where(pixels, 0.0, u))
        found = solve(part, rest, weight=weight.sqrt(), upper=upper[pixels], start=u.minimum(upper)[pixels], iterations=iterations)
        return u.masked_scatter(pixels, (255 * found).round() / 255)

    shown = fit(now, free, limit)
    u = fit(shown, free & (shown >= limit), torch.ones_like(limit)).maximum(shown)
    field, lit = multiply(A, shown), multiply(A, free.float()) > 0
    return PlaneLight(
        u.split([each.headlight.n_pixels for each in lamps]), tuple(chosen), field[: len(where)], field - target, weight * lit
    )


def lighting(headlight: Headlight, T_world_headlight: Tensor, point: Tensor) -> tuple[Tensor, Tensor]:
    """The pixels that light a point `[3]`, and their luminous intensities in cd towards it.

    Each pixel gives at least MUCH of the brightest pixel's intensity at the point, and at least THERE of its own peak.
    """
    x, y, z = transform(inverse(T_world_headlight.double().cpu()), point.double()[:, None])
    texel, weight = bilinear(headlight, *headlight.texel_of(y / x, z / x))
    towards = sp.csr_matrix(((weight * (x > 0))[:, 0].numpy(), (np.zeros(4, int), texel[:, 0].numpy())), (1, headlight.n_texels))
    found = (towards @ headlight.matrix.to_scipy()).tocsr()
    pixels, cd = torch.from_numpy(found.indices.astype(np.int64)), torch.from_numpy(found.data).float()
    if not bool((cd > 0).any()):
        return pixels[:0], cd[:0]
    much = cd >= MUCH * cd.max()
    pixels, cd = pixels[much], cd[much]
    columns = headlight.matrix.transpose
    most = torch.stack([columns.values[columns.indptr[k] : columns.indptr[k + 1]].max() for k in pixels.tolist()]).cpu()
    own = cd >= THERE * most
    return pixels[own], cd[own]


@dataclass(frozen=True, eq=False)
class _Rays:
    """What the rays of all texels hit. cell: `[texels]`, -1 beside the raster. factor: `[texels]` lx per cd. area: `[texels]` m^2."""

    cell: Tensor
    factor: Tensor
    area: Tensor

    def blocks(self, grid: TexelGrid, where: Tensor) -> tuple[sp.csr_matrix, Tensor]:
        """Mean illuminance of blocks of directions that hit no cell of `where`, `[blocks, texels]` in lx per cd, and their areas in m^2."""
        sizes = ((grid.top - grid.bottom) / grid.rows, (grid.left - grid.right) / grid.cols)
        tall, wide = (max(1, round(BLOCK / each)) for each in sizes)
        texel = torch.nonzero(~(where[self.cell] & (self.cell >= 0)))[:, 0]
        _, block = torch.unique(texel // grid.cols // tall * grid.cols + texel % grid.cols // wide, return_inverse=True)
        area = torch.bincount(block, self.area[texel])
        share = self.area[texel] / area[block] * self.factor[texel]
        return sp.csr_matrix((share.numpy(), (block.numpy(), texel.numpy())), (len(area), grid.n_texels)), area


def _on_plane(grid: TexelGrid, T_plane_headlight: Tensor, raster: Raster) -> tuple[sp.csr_matrix, _Rays]:
    """Mean illuminance of the cells by the texels, `[cells, texels]` in lx per cd, and the texels' rays."""
    T = T_plane_headlight.double().cpu()
    y, z = grid.tangents()
    z, y = (each.flatten() for each in torch.meshgrid(z, y, indexing="ij"))
    ray = T[:3, :3] @ torch.stack([torch.ones_like(y), y, z])  # [3, texels]
    height, long = T[2, 3], ray.norm(dim=0)
    way = height / -ray[2]  # ray lengths to the plane
    cell = torch.where((ray[2] < 0) & (height > 0), raster.cells(T[0, 3] + way * ray[0], T[1, 3] + way * ray[1]), -1)
    inside, tangents = cell >= 0, (grid.left - grid.right) * (grid.top - grid.bottom) / grid.n_texels
    rays = _Rays(
        cell,
        torch.where(inside, height / (way * long) ** 3, (BESIDE_M * long) ** -2.0),  # cos / d^2
        tangents * torch.where(inside, way**3 / height, BESIDE_M**2),
    )
    n_cells = raster.rows * raster.cols
    number, covered = (torch.bincount(cell[inside], each, minlength=n_cells) for each in (None, rays.area[inside]))
    few = (number < FEW) | (covered < WHOLE * raster.cell_area)
    hit = torch.nonzero(inside & ~few[cell])[:, 0]
    share = rays.area[hit] / covered[cell[hit]]
    points = raster.points(POINTS)[:, :, few]  # [3, POINTS^2, few cells]
    local = transform(inverse(T), points.flatten(1))
    texel, weight = bilinear(grid, *grid.texel_of(local[1] / local[0], local[2] / local[0]))
    away = (points.flatten(1) - T[:3, 3:]).norm(dim=0)
    weight = weight * (local[0] > 0) * max(float(height), 0.0) / away.clamp(min=NEAREST_M) ** 3 / POINTS**2
    rows = torch.cat([cell[hit], torch.nonzero(few)[:, 0].repeat(4 * POINTS**2)])
    values = torch.cat([share * rays.factor[hit], weight.flatten()])
    columns = torch.cat([hit, texel.flatten()])
    return sp.csr_matrix((values.numpy(), (rows.numpy(), columns.numpy())), (n_cells, grid.n_texels)), rays
