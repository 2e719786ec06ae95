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

from luxloop.controllers.pixels.jpo_part import PixelGoal
from luxloop.controllers.pixels.jpo_solvers import least_squares
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import inverse, transform
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr, multiply
from luxloop.world.texels import TexelGrid, bilinear

ITERATIONS = 150
KEPT = 0.1  # weight of cells without a target, which keep their light; 1 with a target
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
class PlaneLight:
    """Result. u: utilisation `[n_p]` of each module. chosen: `[n_p]` bool of each module, the fitted pixels. lx: `[cells]`, illuminance."""

    u: tuple[Tensor, ...]
    chosen: tuple[Tensor, ...]
    lx: Tensor


def fit_plane(
    lamps: Sequence[tuple[Headlight, Tensor, Tensor]], raster: Raster, wanted_lx: Tensor, where: Tensor, iterations: int = ITERATIONS
) -> PlaneLight:
    """Utilisations with the least squared error of the illuminance of the cells, in 255 steps.

    lamps: each module with its pose `[4, 4]` in the frame of the plane and its present utilisation `[n_p]`; pixels that light no cell with
    a target keep it. wanted_lx: target `[cells]` in lx. where: `[cells]` bool, cells with a target. Raises LuxloopError if no pixel lights
    these cells.
    """
    matrices, chosen = [], []
    for light, T_plane_headlight, _ in lamps:
        on_plane = _on_plane(light, T_plane_headlight, raster)
        A = light.matrix.to_scipy()
        matrices.append(on_plane @ A)
        there = (on_plane[where.numpy()] > 0).astype(np.float32).sum(0) > 0
        reach = A[np.flatnonzero(there)].max(0).toarray()[0] if there.any() else np.zeros(light.n_pixels)
        most = A.max(0).toarray()[0]
        chosen.append(torch.from_numpy((reach >= OWN * most) & (most > 0)))
    free = torch.cat(chosen)
    if not free.any():
        raise LuxloopError("wish: no pixel lights the place where light is wanted; paint it within the field of a lamp")
    joint = Csr.from_scipy(sp.hstack(matrices, "csr"))
    now = torch.cat([u.float().cpu() for _, _, u in lamps])
    target = torch.where(where, wanted_lx, multiply(joint, now)).float()
    weight = torch.where(where, 1.0, KEPT)
    u = least_squares(joint, PixelGoal(target, weight, now, free), iterations)
    u = torch.where(free, (255 * u).round() / 255, now)
    sizes = [light.n_pixels for light, _, _ in lamps]
    return PlaneLight(u.split(sizes), tuple(chosen), multiply(joint, u))


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


def _on_plane(grid: TexelGrid, T_plane_headlight: Tensor, raster: Raster) -> sp.csr_matrix:
    """Mean illuminance of the cells by the texels, `[cells, texels]` in lx per cd."""
    T = T_plane_headlight.double().cpu()
    y, z = grid.tangents(torch.float64, torch.device("cpu"))
    z, y = (each.flatten() for each in torch.meshgrid(z, y, indexing="ij"))
    ray = T[:3, :3] @ torch.stack([torch.ones_like(y), y, z])  # [3, texels]
    height, long = T[2, 3], ray.norm(dim=0)
    way = height / -ray[2]  # ray lengths to the plane
    cell = torch.where((ray[2] < 0) & (height > 0), raster.cells(T[0, 3] + way * ray[0], T[1, 3] + way * ray[1]), -1)
    n_cells = raster.rows * raster.cols
    area = (grid.left - grid.right) * (grid.top - grid.bottom) / grid.n_texels * way**3 / height  # of texels on the plane, m^2
    inside, cell_area = cell >= 0, (raster.x_max - raster.x_min) * (raster.y_max - raster.y_min) / n_cells
    number, covered = (torch.bincount(cell[inside], each, minlength=n_cells) for each in (None, area[inside]))
    few = (number < FEW) | (covered < WHOLE * cell_area)
    hit = torch.nonzero(inside & ~few[cell])[:, 0]
    distance = (way * long)[hit]
    factor = height / distance**3  # cos / d^2
    share = area[hit] / covered[cell[hit]]
    points = raster.points(POINTS)[:, :, few]  # [3, POINTS^2, few cells]
    local = transform(inverse(T), points.flatten(1))
    texel, weight = bilinear(grid, *grid.texel_of(local[1] / local[0], local[2] / local[0]))
    away = (points.flatten(1) - T[:3, 3:]).norm(dim=0)
    weight = weight * (local[0] > 0) * max(float(height), 0.0) / away.clamp(min=NEAREST_M) ** 3 / POINTS**2
    rows = torch.cat([cell[hit], torch.nonzero(few)[:, 0].repeat(4 * POINTS**2)])
    values = torch.cat([share * factor, weight.flatten()])
    columns = torch.cat([hit, texel.flatten()])
    return sp.csr_matrix((values.numpy(), (rows.numpy(), columns.numpy())), (n_cells, grid.n_texels))
