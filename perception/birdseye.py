"""The road seen from above: rectified views of a camera image, of the plane z = 0 or of the road itself."""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, pad

from luxloop.perception.appearance import Axes
from luxloop.world.frames import View
from luxloop.world.texels import resample

NOWHERE_PX = -1e6


@dataclass(frozen=True)
class Region:
    """A rectangle of the assumed road plane in m, and the edge of its cells."""

    x_near_m: float
    x_far_m: float
    y_left_m: float
    y_right_m: float
    cell_m: float = 0.04


def region_around(x_m: float, y_m: float, length_m: float, width_m: float, cell_m: float = 0.04) -> Region:
    """Region in which a symbol of a size with its target at (x, y) may appear; larger beyond the target, since light grazes the road."""
    return Region(max(x_m - 2 * length_m, 1.0), x_m + 3.5 * length_m, y_m + 2.5 * width_m, y_m - 2.5 * width_m, cell_m)


@dataclass(frozen=True)
class BirdsEye:
    """A rectified view; row 0 is far, column 0 is left.

    map_u, map_v: `[rows, cols]` px, image coordinates of each cell's centre. columns: width of a cell in the middle of the region in image
    columns, odd. axes: metres, u to the right (-y) and v towards the car (-x), so that the errors keep their signs.
    """

    map_u: Tensor
    map_v: Tensor
    columns: int
    axes: Axes

    def to(self, device: torch.device) -> "BirdsEye":
        """The view on another device."""
        axes = Axes(self.axes.u.to(device), self.axes.v.to(device))
        return BirdsEye(self.map_u.to(device), self.map_v.to(device), self.columns, axes)

    def within(self, rows: slice, cols: slice) -> "BirdsEye":
        """A part of the view."""
        return BirdsEye(self.map_u[rows, cols], self.map_v[rows, cols], self.columns, Axes(self.axes.u[cols], self.axes.v[rows]))

    def cells_of(self, v: slice, u: slice) -> tuple[slice, slice]:
        """Rows and columns of the view with all cells that `rectify` samples from rows v and columns u of the image."""
        low, high = self._v_of_rows
        rows = span((high > v.start - 0.5) & (low < v.stop + 0.5))  # a pixel is interpolated to half a pixel beyond its border
        across, half = self.map_u[rows], self.columns // 2 + 0.5
        return rows, span(((across > u.start - half) & (across < u.stop + half)).any(0))

    @cached_property
    def _v_of_rows(self) -> tuple[Tensor, Tensor]:
        """Least and largest v of each row of cells `[rows]`, without hidden cells."""
        hidden = self.map_u == NOWHERE_PX
        return self.map_v.masked_fill(hidden, torch.inf).amin(1), self.map_v.masked_fill(hidden, -torch.inf).amax(1)


def span(chosen: Tensor) -> slice:
    """Slice from the first to the last True of `[n]` bool; empty without any."""
    found = chosen.nonzero()
    return slice(int(found[0]), int(found[-1]) + 1) if len(found) else slice(0, 0)


def hull(one: slice, other: slice) -> slice:
    """The smallest slice that contains two slices, either of which may be empty."""
    there = [each for each in (one, other) if each.stop > each.start]
    return slice(min(each.start for each in there), max(each.stop for each in there)) if there else slice(0, 0)


def cells(region: Region) -> Tensor:
    """Centres of a region's cells on the plane z = 0, `[3, rows, cols]` m, float64; row 0 is far, column 0 is left."""
    rows = round((region.x_far_m - region.x_near_m) / region.cell_m)
    cols = round((region.y_left_m - region.y_right_m) / region.cell_m)
    x = region.x_far_m - (torch.arange(rows, dtype=torch.float64) + 0.5) * region.cell_m
    y = region.y_left_m - (torch.arange(cols, dtype=torch.float64) + 0.5) * region.cell_m
    return torch.stack([x[:, None].expand(rows, cols), y.expand(rows, cols), torch.zeros(rows, cols, dtype=torch.float64)])


def birds_eye(region: Region, view: View, road: Tensor | None = None, dtype: torch.dtype = torch.float32) -> BirdsEye:
    """The rectified view of a region in a camera's view.

    road: `[3, rows, cols]` m, points of the road under the cells, by default the cells themselves. Points that nearer cells of the same
    column hide have no image coordinates.
    """
    ground = cells(region)
    uv, depth = view.project((ground if road is None else road).flatten(1))
    u, v = torch.where(depth > 0, uv, NOWHERE_PX).unflatten(1, ground.shape[1:])
    if road is not None:
        nearer = v.flip(0).cummin(0).values.flip(0)
        u = torch.where(v > nearer, NOWHERE_PX, u)
    columns = region.cell_m * view.fx / depth[len(depth) // 2].clamp(min=1.0)
    axes = Axes(-ground[1, 0].to(dtype), -ground[0, :, 0].to(dtype))
    return BirdsEye(u.to(dtype), v.to(dtype), 2 * int(columns / 2) + 1, axes)


def rectify(view: BirdsEye, image: Tensor, u_start: int = 0, v_start: int = 0) -> Tensor:
    """Sample camera images `[..., height, width]` onto the plane: `[..., rows, cols]`, zero outside of them.

    image: the whole image, or a crop of it that starts at (u_start, v_start) px. A cell takes the mean of the image columns that it covers,
    so that edges move continuously over the cells.
    """
    half = view.columns // 2
    flat = avg_pool2d(pad(image.reshape(-1, 1, *image.shape[-2:]), (2 * half, 2 * half)), (1, view.columns), 1)
    height, width = flat.shape[-2:]
    u = (2 * (view.map_u.to(image) - u_start + half) / width - 1)[None].expand(flat.shape[0], -1, -1)
    v = (2 * (view.map_v.to(image) - v_start) / height - 1)[None].expand(flat.shape[0], -1, -1)
    plane = resample(flat, u, v)
    return plane.reshape(*image.shape[:-2], *plane.shape[-2:])
