"""The headlight matrix of a digitised lamp: intensities, shapes and positions of its pixels on a light texture."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
import torch
from scipy.ndimage import map_coordinates

from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.shapes import REACH, PixelMeasurements, borders
from luxloop.loop.rig.calibration.structured_light import Chart
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.lamps import mount
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp
from luxloop.world.spmv import Csr
from luxloop.world.texels import TexelGrid

LEAST = 3e-3  # light below this share of a pixel's peak is left out
MARGIN = math.ceil(REACH - 0.5)  # reach in pixels of light beyond the outermost pixels
NEAR = 0.25  # additional reach in pixels of a shifted pixel's shape
AT_ONCE = 64  # rows of texels computed together


def grid_over(y: Array, z: Array, texels: tuple[int, int]) -> TexelGrid:
    """Grid of a light texture over pixel tangents y and z `[rows, cols]`, extended by the reach of the outermost pixels' blurred light."""
    rows, cols = y.shape
    margin_y, margin_z = ((0.5 + MARGIN) * float(np.ptp(each)) / max(n - 1, 1) for each, n in ((y, cols), (z, rows)))
    return TexelGrid(
        rows=texels[0] * (rows + 2 * MARGIN),
        cols=texels[1] * (cols + 2 * MARGIN),
        left=float(y.max()) + margin_y,
        right=float(y.min()) - margin_y,
        bottom=float(z.min()) - margin_z,
        top=float(z.max()) + margin_z,
    )


def headlight(name: str, grid: TexelGrid, measured: PixelMeasurements, lamp_of: Chart) -> Headlight:
    """Headlight matrix of a digitised module in cd. lamp_of: from tangents (y, z) to lamp coordinates (row, column)."""
    rows, cols = measured.intensity.shape
    block_of = [np.searchsorted(borders(n), np.arange(n), "right") - 1 for n in (rows, cols)]
    y, z = (each.numpy() for each in grid.tangents(torch.float64, torch.device("cpu")))
    lit = np.nan_to_num(measured.intensity).clip(min=0)
    least = LEAST * measured.shapes.max((2, 3))
    reach = int(np.ceil(REACH))
    parts = []
    for start in range(0, grid.rows, AT_ONCE):
        zz, yy = np.meshgrid(z[start : start + AT_ONCE], y, indexing="ij")
        row, col = (each.ravel() for each in lamp_of(yy, zz))
        texel = np.arange(row.size)
        entries: list[tuple[Array, Array, Array]] = []
        for i, j in itertools.product(range(-reach, reach + 1), repeat=2):
            r, c = np.floor(row).astype(int) + i, np.floor(col).astype(int) + j
            inside = (r >= 0) & (r < rows) & (c >= 0) & (c < cols)
            inside &= (np.abs(row - r - 0.5) < REACH + NEAR) & (np.abs(col - c - 0.5) < REACH + NEAR)
            r, c, at = r[inside], c[inside], texel[inside]
            dr, dc = row[at] - r - 0.5 - measured.shift_row[r, c], col[at] - c - 0.5 - measured.shift_col[r, c]
            block = block_of[0][r], block_of[1][c]
            place = [(each + REACH) * (n / (2 * REACH)) - 0.5 for each, n in zip((dr, dc), measured.shapes.shape[2:], strict=True)]
            share = map_coordinates(measured.shapes, (*block, *place), order=1, mode="grid-constant")  # zero outside of a shape
            keep = share > least[block]
            entries.append((at[keep], (r * cols + c)[keep], (share * lit[r, c])[keep]))
        at, pixel, value = (np.concatenate(each) for each in zip(*entries, strict=True))
        parts.append(sp.csr_array((value.astype(np.float32), (at, pixel)), shape=(row.size, rows * cols)))
    matrix = Csr.from_scipy(sp.vstack(parts, format="csr"))
    return Headlight(name=name, matrix=matrix, pixel_rows=rows, pixel_cols=cols, **vars(grid))


def refuse_both_sides(scenario: Scenario) -> None:
    """Raise LuxloopError if both sides are lit, since a lamp file has one lamp."""
    if len(scenario.headlight.lamps) > 1:
        raise LuxloopError("a lamp file holds one lamp; digitise each by itself, with --set 'headlight.lamps=[\"left\"]'")


def lamp_of(scenario: Scenario, lights: Sequence[Headlight], name: str, notes: str) -> Lamp:
    """The scenario's lamp with digitised modules, one per lit module, as the left lamp that lamp files describe."""
    mounts = mount(scenario.headlight)
    lamp = mounts[0].lamp
    modules = list(lamp.modules)
    for each, light in zip(mounts, lights, strict=True):
        modules[each.number] = replace(modules[each.number], headlight=light)
    lamp = Lamp(name, tuple(modules), notes=notes)
    return lamp if mounts[0].side == "left" else replace(lamp, modules=tuple(each.mirror() for each in modules))
