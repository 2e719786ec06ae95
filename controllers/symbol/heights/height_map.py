"""The height map of the road from the camera's view, and inverse ray tracing of a symbol onto it (T 9.4)."""

from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate

from luxloop.controllers.symbol.sensing.projection import ProjectionCommand, Warp
from luxloop.controllers.symbol.sensing.projector import Projector, SymbolParams
from luxloop.controllers.symbol.sensing.road_shape import (
    HERE,
    LEAST_HEIGHT_M,
    below_lamps,
    bounding_rectangle,
    cells_of_rectangle,
    pose_of_rectangle,
)
from luxloop.perception.birdseye import Region
from luxloop.world.frames import inverse, pose, transform

LAYERS = 33  # layers of height between which light paths are interpolated
ROUNDS = 10  # of bisection for the line of sight to a place of the road
LEAST_DROP_M = 0.05  # least drop from the eye to a visible point


@dataclass(frozen=True)
class HeightMap:
    """Road heights along lines of sight of an eye at `[3]` m through the cells of a region of the plane; row 0 is far, column 0 left.

    heights: `[rows, cols]` m. brightness: `[rows, cols]`, luminance relative to the plane in the same light. The cells lie on the plane,
    not on the road, so that every cell is visible. Beyond the region the values at its border continue.
    """

    region: Region
    eye: Tensor
    heights: Tensor
    brightness: Tensor

    def at(self, values: Tensor, x: Tensor, y: Tensor, beyond: str = "border") -> Tensor:
        """Values `[rows, cols]` of the cells, interpolated at points `[h, w]` of the plane. beyond: padding outside the region."""
        r = self.region
        u = 2 * (r.y_left_m - y) / (r.y_left_m - r.y_right_m) - 1
        v = 2 * (r.x_far_m - x) / (r.x_far_m - r.x_near_m) - 1  # -1..1 from border to border
        return grid_sample(values[None, None], torch.stack([u, v], -1)[None], padding_mode=beyond, align_corners=False)[0, 0]

    def points(self, x: Tensor, y: Tensor) -> Tensor:
        """Points `[3, ...]` m of the road on the lines of sight through points of the plane."""
        x, y = torch.broadcast_tensors(x, y)
        h, eye = self.at(self.heights, x.reshape(1, -1), y.reshape(1, -1)).view_as(x), self.eye.to(x)  # h [...] m
        place = torch.stack([x, y, torch.zeros_like(x)])
        return place + (eye.view(3, *(1,) * x.dim()) - place) * (h / eye[2])  # where lines of sight are at height h

    def under(self, x: Tensor, y: Tensor, observer: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Road height `[h, w]` m at ground coordinates x and y `[h, w]` m, and the plane points `[2, h, w]` on the same lines of sight.

        observer: another eye at `[3]` m, whose lines of sight through x, y on the plane are followed to the road; None: vertical lines.
        """
        eye, foot = self.eye.to(x), torch.stack([x, y])
        other = None if observer is None else observer.to(x)
        heights = torch.zeros_like(x)
        for _ in range(ROUNDS):  # damped by half, or steep drops would oscillate
            place = foot if other is None else foot + (other[:2, None, None] - foot) * (heights / other[2])
            # Where lines of sight to height h over the places meet z = 0, [2, h, w].
            behind = eye[:2, None, None] + (place - eye[:2, None, None]) * (eye[2] / (eye[2] - heights))
            heights = (heights + self.at(self.heights, *behind)) / 2
        return heights, behind

    def seen_from(self, lamp: Tensor, points: Tensor, normal: Tensor, deepest_m: float) -> tuple[Tensor, Tensor]:
        """Plane points x, y `[h, w]` at which the eye sees the light of a lamp at `[3]` m that passes points `[3, h, w]` m of a patch.

        normal: `[3]`, unit normal of the patch. Light paths are followed from deepest_m above the patch to deepest_m below it, up to the
        first point below the road.
        """
        lamp, eye = lamp.to(points), self.eye.to(points)
        over_patch = ((lamp[:, None, None] - points) * normal[:, None, None]).sum(0)  # [h, w] m, the same everywhere
        h = self._layers(torch.linspace(deepest_m, -deepest_m, LAYERS, dtype=points.dtype, device=points.device), lamp, over_patch, points)
        x, y, z = (point + (lamp[axis] - point) * (h / over_patch) for axis, point in enumerate(points))  # [layers, h, w]
        rise = z / (eye[2] - z).clamp(min=LEAST_DROP_M)  # the eye sees p at p + (p - e) z / (e_z - z) on the plane
        ways = [x + (x - eye[0]) * rise, y + (y - eye[1]) * rise]
        # Height of the road over the light, [layers, h, w] m.
        above = self.at(self.heights, *(way.flatten(0, 1) for way in ways)).view_as(ways[0]) - z
        above[-1].clamp_(min=0)  # light paths end at the lowest layer
        under = (above >= 0).to(torch.uint8).argmax(0, keepdim=True)  # first layer, [1, h, w]
        over = (under - 1).clamp(min=0)
        d_over, d_under = above.gather(0, over), above.gather(0, under)
        share = torch.where(under > 0, d_under / (d_under - d_over).clamp(min=1e-9), 0.0)  # of the layer over it: linear between both
        x_seen, y_seen = (torch.lerp(way.gather(0, under), way.gather(0, over), share)[0] for way in ways)
        return x_seen, y_seen

    def _layers(self, h: Tensor, lamp: Tensor, over_patch: Tensor, points: Tensor) -> Tensor:
        """The layers `[n, 1, 1]` between the highest and lowest road height, and one more above and below."""
        ends = torch.stack(points[2].aminmax())  # lowest and highest point of the patch, [2] m
        z = ends + (lamp[2] - ends) * (h[:, None] / over_patch[0, 0])  # of each layer, [layers, 2] m
        least, most = self.heights.aminmax()
        over, under = torch.stack([z[:, 0] > most, z[:, 1] < least]).sum(1).tolist()  # layers wholly above and below the road
        return h[max(over - 1, 0) : len(h) - max(under - 1, 0), None, None]


CELLS = (256, 256)  # along and across: finer than the texels of a lamp
FOLLOWED = 4  # light paths are traced for every fourth cell along and across, and interpolated
SAMPLES = (33, 17)  # samples of the symbol, along and across, whose light the patch must contain
BEYOND = (0.4, 0.15)  # of the symbol's length and width: margin within which light must cross the plane z = 0 for a patch on that plane
HIGHEST_M = 0.2  # height of a road above which the patch is fitted to it
LEAST_DEPTH_M = 0.05  # least search range above and below a fitted patch


@dataclass(frozen=True)
class Sight:
    """The lines of sight of an observer who sees the symbol on the road as on the plane z = 0 of the ground (T 7.2.2).

    eye: `[3]` m in the ground frame. T_ground_plane: `[4, 4]`, frame of the road's points.
    """

    eye: Tensor
    T_ground_plane: Tensor

    def on_ground(self, road: Tensor) -> Tensor:
        """x, y `[2, ...]` m on the ground's plane at which the observer sees points `[3, ...]` m of the road."""
        points, eye = transform(self.T_ground_plane.to(road), road.flatten(1)), self.eye.to(road)[:, None]
        rise = points[2] / (eye[2] - points[2]).clamp(min=LEAST_DROP_M)
        return (points + (points - eye) * rise)[:2].view_as(road[:2])

    def on_road(self, relief: HeightMap, x: Tensor, y: Tensor) -> Tensor:
        """Points `[3, h, w]` m of the road that the observer sees at x, y `[h, w]` m on the ground's plane."""
        T = inverse(self.T_ground_plane).to(x)
        eye = transform(T, self.eye.to(x)[:, None])[:, :, None]
        points = transform(T, torch.stack([x, y, 0 * x]).flatten(1)).view(3, *x.shape)
        foot = eye + (points - eye) * (eye[2] / (eye[2] - points[2]))  # on the plane of the points
        return foot + (eye - foot) * (relief.under(foot[0], foot[1], eye[:, 0, 0])[0] / eye[2])


def draw_on(
    relief: HeightMap, lamps: Tensor, symbol: SymbolParams, T_body_ground: Tensor, in_place: bool = False, sight: Sight | None = None
) -> ProjectionCommand:
    """Inverse ray tracing: the symbol on a rectangle, warped so that the eye sees the same image on the road as on the plane.

    relief: height map in the ground frame. lamps: `[m, 3]` m in the ground frame. T_body_ground: `[4, 4]`, for the command in the body
    frame. A cell of the rectangle takes the symbol's value at the plane point where the eye sees the cell's light; with in_place, at the
    lit road point; with sight, where an observer sees it. Cells that appear brighter than on the plane are dimmed.
    """
    lamps = lamps.to(relief.heights)
    T, size_m, depth_m = _patch(relief, lamps, symbol, in_place, sight)
    rows, cols = (n // FOLLOWED for n in CELLS)
    cells = cells_of_rectangle(size_m, (rows, cols), lamps)  # of blocks of FOLLOWED cells along and across, [3, rows, cols]
    points = transform(T, cells.flatten(1)).view_as(cells)
    # Each lamp's light on the plane, [m, rows, cols] each.
    x_seen, y_seen = torch.stack([torch.stack(relief.seen_from(lamp, points, T[:3, 2], depth_m)) for lamp in lamps]).unbind(1)
    brightness = relief.at(relief.brightness, x_seen.flatten(0, 1), y_seen.flatten(0, 1)).view_as(x_seen)
    if sight is not None:
        x_seen, y_seen = sight.on_ground(relief.points(x_seen, y_seen))
    elif in_place:
        x_seen, y_seen, _ = relief.points(x_seen, y_seen)
    source = [2 * (symbol.y_m - y_seen) / symbol.width_m, 2 * (symbol.x_m - x_seen) / symbol.length_m]  # u, v in -1..1
    coarse = torch.stack([*source, 1 / brightness.clamp(min=1)], 1)  # [m, 3, rows, cols]
    down, right = (_finer(n, coarse.dtype, coarse.device) for n in (rows, cols))
    fine = down @ coarse @ right.T  # [m, 3, *CELLS]
    return ProjectionCommand(*pose_of_rectangle(T_body_ground.to(T) @ T), Warp(fine[:, :2], fine[:, 2], size_m))


def body_over(T_ground_plane: Tensor, T_ground_body: Tensor) -> Tensor:
    """Pose `[4, 4]` of the body in the frame of a plane; both are given in the ground frame."""
    return T_ground_body if T_ground_plane.equal(HERE) else inverse(T_ground_plane) @ T_ground_body


@dataclass(frozen=True)
class Belief:
    """A controller's belief about road and body at an exposure.

    relief: height map over a plane. T_ground_plane, T_ground_body: poses `[4, 4]` of the plane and of the body.
    """

    relief: HeightMap
    T_ground_plane: Tensor
    T_ground_body: Tensor

    def draw(self, projector: Projector) -> ProjectionCommand:
        """The command that shows the symbol on the believed road."""
        symbol, plane = projector.params, self.T_ground_plane
        T_plane_body = body_over(plane, self.T_ground_body)
        lamps = transform(T_plane_body, torch.stack([each.T_body_headlight[:3, 3] for each in projector.modules], 1).to(T_plane_body)).T
        sight = None if projector.observer is None else Sight(projector.observer, plane)
        return draw_on(self.relief, lamps, symbol, inverse(T_plane_body), symbol.target == "place" or not plane.equal(HERE), sight)

    def heights(self, x: Tensor, y: Tensor) -> Tensor:
        """Believed height `[h, w]` m of the road above the plane of the ground at ground coordinates `[h, w]` m."""
        T = self.T_ground_plane.to(x)
        (slope_x, slope_y, rise), middle = T[:3, 2], T[:3, 3]
        z = middle[2] - (slope_x * (x - middle[0]) + slope_y * (y - middle[1])) / rise  # of the plane
        on_plane = transform(inverse(T), torch.stack([x, y, z]).flatten(1)).view(3, *x.shape)
        return z + self.relief.under(*on_plane[:2])[0] / rise


def _patch(
    relief: HeightMap, lamps: Tensor, symbol: SymbolParams, in_place: bool, sight: Sight | None
) -> tuple[Tensor, tuple[float, float], float]:
    """A rectangle that all light of the symbol crosses: on the plane z = 0 if possible, else on the plane that fits the road best.

    Returns pose `[4, 4]`, length and width in m, and the search range above and below the rectangle in m. On z = 0 the cells stay aligned
    with edges along and across the road.
    """
    along, across = (torch.linspace(-0.5, 0.5, n).to(lamps) for n in SAMPLES)
    # The symbol's points, [33, 17] m each.
    x, y = torch.broadcast_tensors((symbol.x_m + symbol.length_m * along)[:, None], symbol.y_m + symbol.width_m * across)
    if sight is not None:
        road = sight.on_road(relief, x, y)
    else:
        road = torch.stack([x, y, relief.under(x, y)[0]]) if in_place else relief.points(x, y)
    road = road.flatten(1)  # [3, k]
    level, size = pose(lamps.new_tensor([symbol.x_m, symbol.y_m, 0.0]), torch.eye(3).to(lamps)), (symbol.length_m, symbol.width_m)
    reach = lamps.new_tensor([length * (0.5 + beyond) for length, beyond in zip(size, BEYOND, strict=True)])
    low, high, depth = _crossings(level, road, lamps)
    if depth < HIGHEST_M and bool((low > -reach).all() & (high < reach).all()):
        return *bounding_rectangle(level, low, high), HIGHEST_M
    T = _fit(road, lamps)
    low, high, depth = _crossings(T, road, lamps)
    return *bounding_rectangle(T, low, high), depth + LEAST_DEPTH_M


def _crossings(T: Tensor, road: Tensor, lamps: Tensor) -> tuple[Tensor, Tensor, float]:
    """Where light paths to road points `[3, k]` m cross a plane at `[4, 4]`: least and greatest x, y `[2]` m in the plane's frame, and the
    largest distance of the points from the plane in m.
    """
    local, origins = transform(inverse(T), road), transform(inverse(T), lamps.T).T  # [3, k], [m, 3]
    fall = (origins[:, 2:] - local[2]).clamp(min=LEAST_HEIGHT_M)
    ways = torch.stack([local[k] + (local[k] - origins[:, k, None]) * (local[2] / fall) for k in (0, 1)]).flatten(1)  # [2, m * k]
    return ways.amin(1), ways.amax(1), float(local[2].abs().max())


def _fit(road: Tensor, lamps: Tensor) -> Tensor:
    """Pose `[4, 4]` on the plane that fits road points `[3, k]` best, made less steep if needed so that lamps light it."""
    centre = road.mean(1, keepdim=True)
    x, y, z = road - centre
    # on a CPU the default driver, gelsy, reads pivots that torch leaves unset
    slope_x, slope_y = torch.linalg.lstsq(torch.stack([x, y], 1), z[:, None], driver="gels").solution[:, 0]  # z = s_x x + s_y y
    return below_lamps(centre[:, 0], slope_x, slope_y, lamps)


@lru_cache(maxsize=4)
def _finer(n: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Matrix `[n * FOLLOWED, n]` of linear interpolation between the centres of blocks of FOLLOWED cells."""
    each = torch.eye(n, dtype=dtype, device=device)[None, None]
    return interpolate(each, scale_factor=(FOLLOWED, 1), mode="bilinear")[0, 0]
