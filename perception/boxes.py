"""Boxes in the image and on the road: positions, hidden parts, and vehicles located by their lamps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.world.frames import View
from luxloop.world.traffic.tracked import Category

FARTHEST_M = 150.0  # distance assumed for objects on the horizon
LOWEST_M = 0.05  # least height of a camera, to tell feet from the horizon
LENGTH_M: Mapping[Category, float] = {"pedestrian": 0.5, "cyclist": 1.0, "animal": 1.0, "motorcycle": 1.5, "car": 4.0, "truck": 8.0}
OTHER_LENGTH_M = 0.2


@dataclass(frozen=True, eq=False)
class RoadBoxes:
    """Boxes on the road. T_world_box: `[n, 4, 4]`, origin at the centre of the foot, x away from the camera. size_m: `[n, 3]`, length,
    width, height.
    """

    T_world_box: Tensor
    size_m: Tensor


def place_boxes(boxes: Tensor, categories: tuple[Category, ...], view: View) -> RoadBoxes:
    """Upright boxes on the road whose near side fills the image boxes `[n, 4]` px, with the length of their class.

    An error of one pixel at the foot displaces a box by `d^2 / (f h)` along the line of sight: 1.6 m at 50 m for f = 1194 px and a camera
    height h = 1.3 m.
    """
    T = view.T_world_view
    left, top, right, bottom = boxes.to(T).unbind(-1)
    middle = (left + right) / 2
    foot, head = (_direction(view, middle, v) for v in (bottom, top))
    depth = 1 / nearness(view, middle, bottom)
    near = view.origin[:2] + depth[:, None] * foot[:, :2]
    forward = torch.nn.functional.normalize(foot[:, :2], dim=-1)
    high = _height(view) + depth * foot[:, :2].norm(dim=-1) * head[:, 2] / head[:, :2].norm(dim=-1)
    length = torch.tensor([LENGTH_M.get(each, OTHER_LENGTH_M) for each in categories]).to(T)
    size = torch.stack([length, (right - left) / view.fx * depth, high.clamp(min=0.01)], -1)
    T_world_box = torch.eye(4).to(T).repeat(len(boxes), 1, 1)
    T_world_box[:, :2, 0] = forward
    T_world_box[:, :2, 1] = torch.stack([-forward[:, 1], forward[:, 0]], -1)
    T_world_box[:, :2, 3] = near + length[:, None] / 2 * forward
    return RoadBoxes(T_world_box, size)


def nearness(view: View, u: Tensor, v: Tensor) -> Tensor:
    """Inverse depth in 1/m of the road z = 0 at image points `[...]` px, at least that of `FARTHEST_M`."""
    return (-_direction(view, u, v)[..., 2] / _height(view)).clamp(min=1 / FARTHEST_M)


def range_rate(view: View, foot: Tensor) -> Tensor:
    """Relative rate `[...]` in 1/s of the range of feet `[..., 2, 2]`, u and v in px and their rates a second, on the road."""
    at, rate = foot.unbind(-1)
    change = (_direction(view, *(at + rate).unbind(-1)) - _direction(view, *at.unbind(-1)))[..., 2] / _height(view)
    return change / nearness(view, *at.unbind(-1))


def road_rows(view: View, u: Tensor) -> tuple[Tensor, float]:
    """Row of the horizon in columns `[...]` px, and by how many px per m the scale on the road grows from one row to the next."""
    _, down, ahead = view.T_world_view[2, :3].unbind()
    across = view.T_world_view[2, 0] * (u - view.cx) / view.fx
    return view.cy - view.fy * (across + ahead) / down, float(-down * view.fx / view.fy / _height(view))


def _height(view: View) -> float:
    return max(float(view.origin[2]), LOWEST_M)


def _direction(view: View, u: Tensor, v: Tensor) -> Tensor:
    """Directions `[..., 3]` in the world through image points, of depth 1."""
    return torch.stack([(u - view.cx) / view.fx, (v - view.cy) / view.fy, torch.ones_like(u)], -1) @ view.T_world_view[:3, :3].T


HEIGHTS_M: Mapping[Category, tuple[float, float]] = {  # of the lowest and of the highest on the road
    "pedestrian": (1.0, 2.05),
    "cyclist": (1.4, 2.1),
    "motorcycle": (1.2, 2.0),
    "animal": (0.5, 2.2),
    "car": (1.2, 2.2),
    "truck": (2.0, 4.2),
}
WIDTHS_M: Mapping[Category, tuple[float, float]] = {"pedestrian": (0.3, 1.3), "cyclist": (0.4, 2.1), "motorcycle": (0.5, 2.4)}
USUAL_HEIGHTS_M: Mapping[Category, float] = {"pedestrian": 1.7, "cyclist": 1.75}
USUAL_WIDTHS_M: Mapping[Category, float] = {"motorcycle": 0.8, "car": 1.8, "truck": 2.5}
LEAST_EVIDENCE = -3.0  # logarithm of a likelihood ratio: one in twenty objects is of no usual size
WHOLE = 0.85  # of the expected width or height: a smaller box is a part
MEASURED = (0.05, 0.08)  # standard deviation of the foot of a detected box, across and down, in the root of its area
MISSING = 0.5  # standard deviation of a part, as a share of its missing width or height
EDGE_PX = 3.0  # a box that ends nearer to the left or right border is cut off
LEANS = 0.2  # share by which a completed part moves from its least displacement to its own middle and foot
INSIDE = 0.9  # least share of a box inside a track's box for it to be a part of that object
NEARER = 0.05  # height by which a box may end above the foot of the object that it occludes, in heights of the object
ALIKE: tuple[frozenset[Category], ...] = (frozenset({"pedestrian", "cyclist", "motorcycle"}), frozenset({"car", "truck"}))  # by their parts
SOLID: frozenset[Category] = frozenset({"car", "truck"})  # classes with opaque boxes


def limits_m(classes: tuple[Category, ...]) -> Tensor:
    """`[C, 2, 2]`: least and greatest, of width and height of each class."""
    anything = (0.0, torch.inf)
    sizes = [[WIDTHS_M.get(each, anything), HEIGHTS_M.get(each, anything)] for each in classes]
    return torch.tensor(sizes, dtype=torch.float64).view(-1, 2, 2).transpose(1, 2)


def standing(boxes: Tensor, categories: tuple[Category, ...], view: View) -> Tensor:
    """Boxes `[n, 4]` px extended to the height of their classes: upwards by a dark top, downwards by a foot that is hidden or below the
    image.

    The row of the foot gives the scale in px per m on the road. A box higher than the limit of its class stands nearer on a hidden foot; it
    grows by at most its own height, since roads have hills. For a box that ends at the lowest row of the image the usual height or width of
    the class gives the foot.
    """
    if not len(boxes):
        return boxes
    left, top, right, bottom = boxes.unbind(-1)
    horizon, scale = road_rows(view, (left + right) / 2)

    def foot(height_m: Tensor) -> Tensor:
        """Row of the foot of an object with its head at the top of the box; the bottom of the box for objects lower than the camera or of
        unknown height.
        """
        taller = height_m * scale
        return torch.where((taller > 1) & taller.isfinite(), (taller * horizon - top) / (taller - 1).clamp(min=1e-9), bottom)

    low, high = limits_m(categories)[..., 1].to(boxes).unbind(-1)
    nothing = torch.full_like(bottom, torch.nan)
    height, width = (nothing.new_tensor([sizes.get(each, torch.nan) for each in categories]) for sizes in (USUAL_HEIGHTS_M, USUAL_WIDTHS_M))
    usual = torch.where(height.isfinite(), foot(height), horizon + (right - left) / (width * scale)).nan_to_num()
    cut = bottom >= view.height - 1
    lowest = torch.where(cut, usual, torch.where(bottom - top > high * scale * (bottom - horizon), foot(high), bottom))
    bottom = torch.minimum(torch.maximum(bottom, lowest), bottom + (bottom - top))
    return torch.stack([left, torch.minimum(top, bottom - low * scale * (bottom - horizon)), right, bottom], -1)


def plausible(scores: Tensor, boxes: Tensor, categories: Sequence[Category], view: View) -> Tensor:
    """Scores `[n, C]` of boxes `[n, 4]` px by Bayes' rule with the height on the road at the foot; categories: of the best scores.

    The logarithm of an object's height is normal, with the limits of its class at two standard deviations, beside the error of the foot.
    Only boxes that are too high lose: low ones may be parts, and the height of one that the image cuts off is unknown.
    """
    left, top, right, bottom = boxes.unbind(-1)
    near = nearness(view, (left + right) / 2, bottom)
    limits = torch.tensor([HEIGHTS_M.get(each, (0.1, 10.0)) for each in categories]).to(boxes).view(-1, 2).log()
    size_px = ((right - left) * (bottom - top)).clamp(min=1).sqrt()
    spread = torch.hypot((limits[:, 1] - limits[:, 0]) / 4, MEASURED[1] * size_px / (near * _height(view) * view.fx))
    z = (((bottom - top).clamp(min=1) / (near * view.fx)).log() - limits.mean(-1)) / spread
    cut = (left <= EDGE_PX) | (right >= view.width - EDGE_PX) | (bottom >= view.height - 1)
    evidence = torch.where(cut, 0.0, (1 - z.clamp(min=0) ** 2 / 2).clamp(LEAST_EVIDENCE, 0.0))
    return torch.special.expit(torch.logit(scores) + evidence[:, None])


def complete(boxes: Tensor, expected: Tensor) -> Tensor:
    """Boxes `[..., 4]` px, extended to the expected width or height if they are parts of the expected boxes `[..., 4]`.

    The extended box is the expected box, moved as little as needed to contain the part, and by LEANS towards the part's middle and foot.
    """
    low, high = torch.broadcast_tensors(boxes[..., :2], expected[..., :2])[0], torch.broadcast_tensors(boxes[..., 2:], expected[..., 2:])[0]
    before, behind = low - expected[..., :2], high - expected[..., 2:]
    needed = before.clamp(max=0) + behind.clamp(min=0)
    own = torch.stack([(before + behind)[..., 0] / 2, behind[..., 1]], -1)
    moved = needed + LEANS * (own - needed)
    smaller = are_parts(boxes, expected)
    return torch.cat([torch.where(smaller, expected[..., :2] + moved, low), torch.where(smaller, expected[..., 2:] + moved, high)], -1)


def are_parts(boxes: Tensor, expected: Tensor) -> Tensor:
    """Whether boxes `[..., 4]` are much narrower and whether much lower than expected `[..., 4]`, `[..., 2]` bool."""
    return boxes[..., 2:] - boxes[..., :2] < WHOLE * (expected[..., 2:] - expected[..., :2])


def extend_cut(boxes: Tensor, expected: Tensor, width: int) -> Tensor:
    """Boxes `[..., 4]` px, with the width of the expected boxes `[..., 4]` where the left or right border of an image cuts them off; width:
    of the image.

    Boxes cut by both borders are unchanged.
    """
    left, top, right, bottom = torch.broadcast_tensors(boxes, expected)[0].unbind(-1)
    wide = expected[..., 2] - expected[..., 0]
    cut_left, cut_right = left <= EDGE_PX, right >= width - EDGE_PX
    low = torch.where(cut_left & ~cut_right, torch.minimum(left, right - wide), left)
    high = torch.where(cut_right & ~cut_left, torch.maximum(right, left + wide), right)
    return torch.stack([low, top, high, bottom], -1)


def spread_of(boxes: Tensor, expected: Tensor) -> Tensor:
    """`[..., 2]` px^2: variances of the foot of boxes `[..., 4]`, larger for parts of the expected boxes `[..., 4]`."""
    whole = (expected[..., 2:] - expected[..., :2]).clamp(min=1)
    missing = (whole - (boxes[..., 2:] - boxes[..., :2])).clamp(min=0)
    return torch.tensor(MEASURED).to(whole) ** 2 * whole.prod(-1, keepdim=True) + (MISSING * missing) ** 2


def parts_of(boxes: Tensor, expected: Tensor, whole: Tensor) -> Tensor:
    """Which boxes `[m, 4]` may be parts of the expected boxes `[n, 4]`: `[n, m]` bool, true for boxes inside.

    whole: `[n]` bool, objects seen whole; a box inside such an object that ends as low or lower is an object in front.
    """
    ours, theirs = expected[:, None], boxes[None]
    inside = _common(ours, theirs) > INSIDE * _area(theirs)
    before = theirs[..., 3] > ours[..., 3] - NEARER * (ours[..., 3] - ours[..., 1])
    return inside & ~(whole[:, None] & before)


def occluders_of(boxes: Tensor, expected: Tensor, whole: Tensor) -> Tensor:
    """Which boxes `[m, 4]` would occlude expected boxes `[n, 4]` that are seen whole: `[n, m]` bool. whole: `[n]` bool.

    Example: the box, far too large, that a detector draws around the lamps of a car in the dark.
    """
    ours, theirs = expected[:, None], boxes[None]
    return whole[:, None] & (_common(ours, theirs) > INSIDE * _area(ours)) & (theirs[..., 3] > ours[..., 3])


def _common(some: Tensor, others: Tensor) -> Tensor:
    return (torch.minimum(some[..., 2:], others[..., 2:]) - torch.maximum(some[..., :2], others[..., :2])).clamp(min=0).prod(-1)


def _area(boxes: Tensor) -> Tensor:
    return (boxes[..., 2:] - boxes[..., :2]).prod(-1)


def similar_classes(classes: tuple[Category, ...]) -> Tensor:
    """Which classes have similar parts, `[C, C]` bool."""
    groups = torch.tensor([next((k for k, each in enumerate(ALIKE) if name in each), -1 - n) for n, name in enumerate(classes)])
    return groups[:, None] == groups[None]


SHINE: frozenset[Category] = frozenset({"car", "truck"})
BRIGHT = 0.95  # of the largest digital number: threshold of light sources
ABOVE_M = 0.6  # height of a lamp's middle
APART = 0.5  # least distance of two lamps, in widths of the box
BETWEEN = 0.1  # half the dark gap between two lamps, in widths of the box; without a gap the spots are one light
AROUND = 0.25  # search range for lamps beyond the sides, in widths of the box


def by_lamps(frame: Tensor, boxes: Tensor, pixels_a_metre: Tensor, others: Tensor) -> Tensor:
    """Boxes `[n, 4]` px located by two bright spots, headlamps or rear lamps; NaN without such spots.

    The centre of a box moves to the centre of its outermost spots, and the foot to ABOVE_M below their mean row. frame: `[height, width]`,
    shares of the largest digital number. pixels_a_metre: `[n]`, px per m at the boxes. others: boxes `[m, 4]` px whose bright spots are
    ignored.
    """
    v, u = (each.double().cpu() + 0.5 for each in (frame >= BRIGHT).nonzero().unbind(-1))
    u, v = (each[~_inside(u, v, others).any(0)] for each in (u, v))
    if not len(u):
        return torch.full_like(boxes, torch.nan)
    width = boxes[:, 2] - boxes[:, 0]
    near = _inside(u, v, boxes + width[:, None] * torch.tensor([-AROUND, 0.0, AROUND, 0.0]).double())
    first, last = torch.where(near, u, torch.inf).amin(1), torch.where(near, u, -torch.inf).amax(1)
    middle = (first + last) / 2
    two = (last - first >= APART * width) & ~(near & ((u - middle[:, None]).abs() < BETWEEN * width[:, None])).any(1)
    across = middle - (boxes[:, 0] + boxes[:, 2]) / 2
    down = (near * v).sum(1) / near.sum(1) + ABOVE_M * pixels_a_metre - boxes[:, 3]
    moved = boxes + torch.stack([across, down, across, down], -1)
    return torch.where(two[:, None], moved, torch.nan)


def _inside(u: Tensor, v: Tensor, boxes: Tensor) -> Tensor:
    """Whether points `[m]` lie in boxes `[n, 4]`: `[n, m]` bool."""
    left, top, right, bottom = boxes[..., None].unbind(1)
    return (u > left) & (u < right) & (v > top) & (v < bottom)
