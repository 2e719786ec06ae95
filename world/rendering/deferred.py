"""Depths and normals straight from OpenGL for moving worlds: less exact than ray intersections, but several times as fast."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.world.caches import Part
from luxloop.world.frames import View, inverse
from luxloop.world.rendering.rasterise import Rasteriser
from luxloop.world.scene.triangles import Instance, Triangles

PART_BITS = 6  # body and part numbers share a float's 24 bits
MOST_PARTS = 2**PART_BITS
MARGIN_PX = 1  # margin drawn around a part
KEPT = 8  # views with a cached image of static bodies


@dataclass(frozen=True)
class Fragments:
    """OpenGL's result at each pixel's centre; all zero without a surface.

    depth: `[height, width]` m along the optical axis. normal: `[3, height, width]`, unit, in the view's frame.
    object_id: `[height, width]` int32, -1 = none. part: `[height, width]` int32, which of its body's parts.
    """

    depth: Tensor
    normal: Tensor
    object_id: Tensor
    part: Tensor


class DeferredRenderer:
    """Draws depths and normals of placed bodies.

    Bodies that have not moved since a view's last image are not drawn again for it.
    """

    def __init__(self) -> None:
        """Raises NoOpenGL."""
        self._rasteriser = Rasteriser()
        self._still: dict[tuple[float, ...], tuple[tuple[Instance, ...], Tensor | None]] = {}  # key: parameters of the view and its part

    def fragments(self, triangles: Triangles, view: View, part: Part | None = None) -> Fragments:
        """Draw the triangles as `view` sees them; a part equals that part of the whole to the bit."""
        part = part or view.whole
        depth, number, x, y = self._image(triangles.placed, view, part).permute(2, 0, 1).contiguous()
        code = number.int().abs_()
        object_id = (code >> PART_BITS).sub_(1)
        z = (object_id >= 0).float().sub_(x * x).sub_(y * y).clamp_(min=0).sqrt_().copysign_(-number)
        return Fragments(depth, torch.stack([x, y, z]), object_id, code.bitwise_and_(MOST_PARTS - 1))

    def _image(self, placed: tuple[Instance, ...], view: View, part: Part) -> Tensor:
        """`[height, width, 4]` of the part, depth first, zero where there is nothing."""
        placed, edges = _in_sight(placed, view, part), (end for each in part for end in (each.start, each.stop))
        numbers = (view.width, view.height, view.fx, view.fy, view.cx, view.cy, *edges, *view.T_world_view.flatten().tolist())
        last, image = self._still.pop(numbers, ((), None))
        still = tuple(each for each in last if each in placed)
        if still and (image is None or len(still) < len(last)):
            image = self._draw(still, view, part)
        moved = tuple(each for each in placed if each not in still)
        if len(self._still) == KEPT:
            del self._still[next(iter(self._still))]  # the least recently used
        self._still[numbers] = (still, image) if still else (placed, None)
        if image is None or not still:
            return self._draw(placed, view, part)
        over = self._draw(moved, view, part)
        depth, behind = over[..., :1], image[..., :1]
        return torch.where((depth > 0) & ((behind == 0) | (depth < behind)), over, image)

    def _draw(self, bodies: Sequence[Instance], view: View, part: Part) -> Tensor:
        return self._rasteriser.draw("surfaces", ((placed, MOST_PARTS * (placed.object_id + 1)) for placed in bodies), view, part)


def _in_sight(placed: tuple[Instance, ...], view: View, part: Part) -> tuple[Instance, ...]:
    """Bodies in the frustum of a part of a view: those whose bounding boxes do not lie wholly beyond one edge or behind the view."""
    if not placed:
        return placed
    corners = torch.stack([each.box for each in placed])  # [n, 8, 3]
    T = inverse(view.T_world_view)
    x, y, z = (corners @ T[:3, :3].T + T[:3, 3]).unbind(-1)
    (top, bottom), (left, right) = ((each.start - MARGIN_PX, each.stop + MARGIN_PX) for each in part)
    u, v = view.fx * x + view.cx * z, view.fy * y + view.cy * z  # px times depth
    beyond = torch.stack([u < left * z, u > right * z, v < top * z, v > bottom * z, z < 0]).all(-1).any(0)
    return tuple(each for each, hidden in zip(placed, beyond.tolist(), strict=True) if not hidden)
