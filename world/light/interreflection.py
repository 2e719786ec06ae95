"""Light that surfaces reflect onto each other once more: rays gather it at coarse points, between which it is interpolated.

After Ward, Rubinstein and Clear, "A Ray Tracing Solution for Diffuse Interreflection" (1988), with fixed points.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import torch
from torch import Tensor

from luxloop.world.frames import View, inverse, pose, transform, unit
from luxloop.world.materials.brdf import Material
from luxloop.world.rendering.gbuffer import GBuffer, surfaces_of
from luxloop.world.rendering.raycast import surfaces_met
from luxloop.world.scene.triangles import Instance, Triangles
from luxloop.world.texels import resample

CELL_M: Final = 1.0  # distance of points
RAYS: Final = 256  # of a point
OFF_M: Final = 0.01  # of points before their surface
ALONG, ACROSS = 16, 6  # rays of a point and a lamp
STEEP: Final = 0.3  # of a height, up to which glitter is sought below an eye or lamp
REACH: Final = 2.0  # of a body's light on the road, in roots of its largest side's area; there it fills about 1 % of the road's sky
FAR_M: Final = 60.0  # from the eye, up to which the road has points
ABOVE_M: Final = 1000.0  # from where heights of the road are sounded
GOLDEN: Final = math.pi * (3 - math.sqrt(5))
R3: Final = (0.8191725134, 0.6710436067, 0.5497004779)  # turns by place, so that errors of neighbours differ (Roberts' sequence)


@dataclass(frozen=True, eq=False)
class Grid:
    """Points before the road or a side of a body's bounding box, in the middles of cells.

    T_world_grid: `[4, 4]` float64; x and y lie along the side, z points out of it. cell_m: length along x and y. height_m: `[n_x, n_y]`
    along z. used, blind: `[n_x, n_y]` bool; light is gathered at points in use; blind ones are ignored; the others get none.
    """

    object_id: int
    T_world_grid: Tensor
    cell_m: tuple[float, float]
    height_m: Tensor
    used: Tensor
    blind: Tensor

    @property
    def points(self) -> Tensor:
        """All points, `[3, n_x * n_y]` float64 m in the world."""
        n_x, n_y = self.height_m.shape
        x, y = ((torch.arange(n).double() + 0.5) * cell for n, cell in zip((n_x, n_y), self.cell_m, strict=True))
        places = torch.stack([x.repeat_interleave(n_y), y.repeat(n_x), self.height_m.flatten() + OFF_M])
        return transform(self.T_world_grid, places)

    def sample(self, values: Tensor, x: Tensor, y: Tensor) -> Tensor:
        """Values `[..., n_x, n_y]` of the cells at places `[M]` m on the grid, bilinear, `[..., M]`."""
        down, across = (2 / (n * cell) * at - 1 for at, n, cell in zip((x, y), self.used.shape, self.cell_m, strict=True))
        found = resample(values.flatten(0, -3)[None] if values.dim() > 2 else values[None, None], across[None], down[None], "border")[0]
        return found.view(*values.shape[:-2], len(x))


@dataclass(frozen=True, eq=False)
class Gathering:
    """What rays from points meet. surfaces: `[1, H]`. point: `[H]` int64, whose ray it is. weight: `[H]` sr, its solid angle times the
    cosine at the point.
    """

    surfaces: GBuffer
    point: Tensor
    weight: Tensor

    def illuminance(self, luminance: Tensor, n_points: int) -> Tensor:
        """Illuminance `[..., n_points]` in lx of the points by surfaces of luminance `[..., H]` in cd/m^2."""
        total = luminance.new_zeros(*luminance.shape[:-1], n_points)
        return total.index_add_(-1, self.point.to(total.device), luminance * self.weight.to(luminance))


def gather(triangles: Triangles, points: Tensor, normals: Tensor) -> Gathering:
    """The matt light that arrives at points `[3, N]` m within the hemispheres around their normals `[3, N]`, float64."""
    number = torch.arange(RAYS, dtype=torch.float64)
    height, angle = (number + 0.5) / RAYS, GOLDEN * number  # even in solid angle, as walls and bodies light from low
    radius = (1 - height.square()).sqrt()
    steep = (normals[2].abs() > 0.9).double()
    x = unit(torch.linalg.cross(torch.stack([steep, 0 * steep, 1 - steep]), normals, dim=0))
    frame = torch.stack([x, torch.linalg.cross(normals, x, dim=0), normals], 1)  # [3, 3 axes, N]
    turned = angle + 2 * math.pi * (points.new_tensor(R3) @ points)[:, None]  # [N, RAYS]
    local = torch.stack([radius * turned.cos(), radius * turned.sin(), height.expand_as(turned)])
    directions = torch.einsum("ian,ank->ink", frame, local)
    return _met(triangles, points, directions, (2 * math.pi / RAYS * height).expand_as(turned), lobes=False)


def _met(triangles: Triangles, points: Tensor, directions: Tensor, weight: Tensor, lobes: bool) -> Gathering:
    """What rays `[3, N, K]` from points `[3, N]` meet. weight: `[N, K]`."""
    k = weight.shape[1]
    origins, directions = points.repeat_interleave(k, 1), directions.flatten(1)
    met = surfaces_of(triangles, surfaces_met(triangles, origins, directions), origins, directions[:, None])
    index = torch.nonzero(met.object_id[0] >= 0)[:, 0]
    surfaces = met.at(index)
    behind = (surfaces.normal * directions[:, None, index].to(surfaces.normal)).sum(0) > 0
    if (finish := surfaces.finish) is not None:  # lamps of others are no light of the own
        dark = tuple(replace(each, luminance_cd_m2=0.0) for each in finish.materials)
        finish = replace(finish, materials=dark, eye=origins[:, index], lobes=lobes)
    surfaces = replace(surfaces, normal=surfaces.normal.where(~behind, -surfaces.normal), finish=finish)
    return Gathering(surfaces, index // k, weight.flatten()[index].float())


def glitter(triangles: Triangles, points: Tensor, normals: Tensor, ground_m: Tensor, lamp_m: Tensor, roughness: float) -> Gathering:
    """The gloss of a road between points `[3, N]` m and a lamp at `[3]` m, towards the points.

    The mirror image of a lamp in a rough film is a strip along the line between both, as wide as facets of a slope of its roughness reach;
    rays are denser towards its ends. normals: `[3, N]`. ground_m: `[N]`, heights of the road below the points. All float64.
    """
    way = lamp_m[:2, None] - points[:2]
    length = way.norm(dim=0).clamp(min=1e-3)[:, None]  # [N, 1]
    own, lamp = ((z - ground_m).clamp(min=0.1)[:, None] for z in (points[2], lamp_m[2]))
    low, high = (torch.logit((STEEP * height / length).clamp(max=0.4)) for height in (own, lamp))
    step = (torch.arange(ALONG).double() + 0.5) / ALONG
    share = torch.sigmoid(low + step * (-high - low))[..., None]  # [N, ALONG, 1] of the way, from the point
    angle = math.pi * ((torch.arange(ACROSS).double() + 0.5) / ACROSS - 0.5)
    width = roughness * torch.lerp(own[..., None], lamp[..., None], share)
    along, aside = length[..., None] * share + 0 * angle, width * angle.tan()
    area = length[..., None] * share * (1 - share) * ((-high - low) / ALONG)[..., None] * width / angle.cos().square() * (math.pi / ACROSS)
    ahead = way / length.T
    x, y = (ahead[k][:, None, None] * along + sign * ahead[1 - k][:, None, None] * aside for k, sign in ((0, -1), (1, 1)))
    rays = torch.stack([x, y, -own[..., None].expand_as(x)]).flatten(2)  # [3, N, ALONG * ACROSS]
    distance = rays.norm(dim=0)
    weight = area.flatten(1) * own / distance**3 * ((normals[..., None] * rays).sum(0) / distance).clamp(min=0)
    met = _met(triangles, points, rays, weight, lobes=True)
    return replace(met, surfaces=replace(met.surfaces, albedo=torch.zeros_like(met.surfaces.albedo)))


@dataclass(eq=False)
class Interreflection:
    """Light that the bodies of a scene and the road reflect onto each other, where an eye may see it. lamps_m: `[n, 3]` float64."""

    triangles: Triangles
    eye: View
    lamps_m: Tensor

    @cached_property
    def grids(self) -> tuple[Grid, ...]:
        """Points on the sides of bodies, then on the road near them."""
        bodies, roads = self.triangles.off_road.placed, tuple(each for each in self.triangles.groups if each.placed[0].body.ground)
        grids = [side for body in bodies for side in _sides(body)]
        grids += [_road(Triangles(roads), bodies, self.eye.origin)] if bodies and roads else []
        seen = ((each, self._sees(each)) for each in grids)
        return tuple(replace(each, used=each.used & there, blind=each.blind | ~there) for each, there in seen if bool(there.any()))

    def _sees(self, grid: Grid) -> Tensor:
        """Points that the eye may see, or their neighbours, `[n_x, n_y]` bool."""
        view, points = self.eye, grid.points
        x, y, z = transform(inverse(view.T_world_view), points)
        seen = (z > 0) & (grid.T_world_grid[:3, 2] @ (view.origin[:, None] - points) > 0)
        for at, n, f, c in ((x, view.width, view.fx, view.cx), (y, view.height, view.fy, view.cy)):
            seen &= (at > -c / f * z - CELL_M) & (at < (n - c) / f * z + CELL_M)
        return seen.view(grid.used.shape)

    @cached_property
    def points(self) -> tuple[Tensor, Tensor]:
        """Points in use in m and their normals, both `[3, N]`."""
        points = [each.points[:, each.used.flatten()] for each in self.grids]
        normals = [each.T_world_grid[:3, 2:3].expand_as(some) for each, some in zip(self.grids, points, strict=True)]
        none = torch.zeros(3, 0, dtype=torch.float64)
        return torch.cat([none, *points], 1), torch.cat([none, *normals], 1)

    @cached_property
    def gatherings(self) -> tuple[Gathering, ...]:
        """Matt light at all points by all lamps; then by each of them gloss of a wet road at the points on bodies."""
        points, normals = self.points
        ground = {each.object_id: float(each.box[:, 2].min()) for each in self.triangles.off_road.placed}
        below = torch.tensor([ground.get(each.object_id, math.nan) for each in self.grids for _ in range(int(each.used.sum()))]).double()
        films = [each for each in _road_materials(self.triangles) if each.interface > 0]
        found = [gather(self.triangles, points, normals)]
        for lamp_m in self.lamps_m if films else ():
            some = torch.nonzero(~below.isnan() & ((lamp_m[:, None] - points) * normals).sum(0).gt(0))[:, 0]
            shine = glitter(self.triangles, points[:, some], normals[:, some], below[some], lamp_m, films[0].roughness)
            found.append(replace(shine, point=some[shine.point]))
        return tuple(found)

    def onto(self, gbuffer: GBuffer) -> "Interpolation":
        """Interpolation of the points' illuminance onto the surfaces of a G-buffer."""
        position, normal, ids = gbuffer.position.flatten(1), gbuffer.normal.flatten(1), gbuffer.object_id.flatten()
        total, found = torch.zeros_like(normal[0]), list[tuple[Tensor, Tensor, Tensor, Tensor]]()
        for grid in self.grids:
            pixel = torch.nonzero(ids == grid.object_id)[:, 0]
            x, y, _ = transform(inverse(grid.T_world_grid).to(position), position.index_select(1, pixel))
            facing = (grid.T_world_grid[:3, 2].to(normal) @ normal.index_select(1, pixel)).clamp(min=0).square()
            total.index_add_(0, pixel, facing * grid.sample((~grid.blind).to(facing), x, y))
            lit = torch.nonzero(facing * grid.sample(grid.used.to(facing), x, y))[:, 0]
            found.append((pixel[lit], facing[lit], x[lit], y[lit]))
        return Interpolation(self.grids, tuple((pixel, facing / total[pixel], x, y) for pixel, facing, x, y in found), gbuffer.albedo.shape)


@dataclass(frozen=True, eq=False)
class Interpolation:
    """From the points of grids to pixels. parts: for each grid pixels, weights, x and y in m, all `[M]`. shape: of the image."""

    grids: tuple[Grid, ...]
    parts: tuple[tuple[Tensor, ...], ...]
    shape: torch.Size

    def __call__(self, values: Tensor) -> Tensor:
        """Values `[..., height, width]` of pixels from those `[..., N]` of all points in use."""
        image = values.new_zeros(*values.shape[:-1], self.shape.numel())
        each = values.split([int(grid.used.sum()) for grid in self.grids], -1)
        for grid, some, (pixel, weight, x, y) in zip(self.grids, each, self.parts, strict=True):
            cells = values.new_zeros(*values.shape[:-1], *grid.used.shape)
            cells[..., grid.used] = some
            image.index_add_(-1, pixel, grid.sample(cells, x, y) * weight)
        return image.unflatten(-1, self.shape)


def _road_materials(triangles: Triangles) -> list[Material]:
    bodies = (each.body for each in triangles.placed if each.body.ground)
    return [material for body in bodies for material in (body.texture.materials if body.texture else (body.material,))]


def _sides(placed: Instance) -> Iterator[Grid]:
    """The sides of a body's bounding box."""
    low, high = placed.body.bounds
    for axis in range(3):
        across = [(axis + 1) % 3, (axis + 2) % 3]
        size = (high - low)[across]
        n = [max(math.ceil(each / CELL_M), 1) for each in size.tolist()]
        used = torch.ones(n, dtype=torch.bool)
        for sign, end in ((-1.0, low), (1.0, high)):
            corner, R = low.clone(), torch.eye(3, dtype=torch.float64)[:, [*across, axis]]
            corner[axis] = end[axis]
            R[:, 2] *= sign
            T, cell_m = placed.T_world_body @ pose(corner, R), (size / torch.tensor(n)).clamp(min=OFF_M).tolist()
            yield Grid(placed.object_id, T, (cell_m[0], cell_m[1]), torch.zeros(n).double(), used, ~used)


def _road(road: Triangles, bodies: tuple[Instance, ...], eye: Tensor) -> Grid:
    """The road around bodies, dark farther away; blind where a body stands."""
    boxes = torch.stack([torch.stack(each.box[:, :2].aminmax(dim=0)) for each in bodies])  # [B, 2 ends, 2]
    sides = torch.stack([(each.body.bounds[1] - each.body.bounds[0]).sort().values for each in bodies])
    reach = REACH * (sides[:, 1] * sides[:, 2]).sqrt()[:, None]
    low = torch.maximum((boxes[:, 0] - reach).amin(0), eye[:2] - FAR_M).div(CELL_M).floor() - 1
    high = torch.minimum((boxes[:, 1] + reach).amax(0), eye[:2] + FAR_M).div(CELL_M).ceil() + 1
    n = (high - low).clamp(min=3).int().tolist()
    T, none = pose(torch.cat([low * CELL_M, low.new_zeros(1)]), torch.eye(3).double()), torch.zeros(n, dtype=torch.bool)
    points = Grid(road.placed[0].object_id, T, (CELL_M, CELL_M), none.double(), none, none).points
    down, above = torch.zeros_like(points), points + points.new_tensor([[0.0], [0.0], [ABOVE_M]])
    down[2] = -1.0
    depth = torch.full_like(points[0], torch.nan)
    for hits in surfaces_met(road, above, down):
        depth[hits.pixels] = hits.depth
    points[2] = ABOVE_M - depth
    near, blind = torch.zeros_like(depth, dtype=torch.bool), depth.isnan()
    for body, (start, stop), far in zip(bodies, boxes, reach, strict=True):
        away = torch.maximum(start[:, None] - points[:2], points[:2] - stop[:, None]).clamp(min=0).norm(dim=0)
        within = torch.nonzero(away == 0)[:, 0]
        place, ends = transform(body.T_body_world, points[:, within]), body.body.bounds[..., None]
        blind[within[((place >= ends[0]) & (place <= ends[1])).all(0)]] = True
        near |= away < far
    inner = torch.nn.functional.pad(torch.ones(n[0] - 2, n[1] - 2, dtype=torch.bool), (1, 1, 1, 1)).flatten()
    used = near & inner & ~blind
    return Grid(road.placed[0].object_id, T, (CELL_M, CELL_M), *(each.view(*n) for each in (points[2].nan_to_num(), used, blind)))
