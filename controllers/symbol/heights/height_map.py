"""The road as the camera sees it: heights over the assumed plane z = 0, by where lines of sight meet that plane."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop.perception.birdseye import Region

LAYERS = 33  # heights between which the way of light is interpolated
ROUNDS = 10  # in which the line of sight to a place of the road is found
LEAST_DROP_M = 0.05  # from the eye to a point that it sees


@dataclass(frozen=True)
class HeightMap:
    """What an eye at `[3]` m sees behind the cells of a region of the plane; row 0 is far, column 0 is left.

    heights: `[rows, cols]` m. brightness: `[rows, cols]`, luminance as a multiple of what the plane would show of the same light. A cell
    is where a line of sight meets the plane, not the surface, so nothing is hidden from the eye. Beyond the region its border goes on.
    """

    region: Region
    eye: Tensor
    heights: Tensor
    brightness: Tensor

    def at(self, values: Tensor, x: Tensor, y: Tensor, beyond: str = "border") -> Tensor:
        """Values of the cells `[rows, cols]` behind points `[h, w]` of the plane, bilinear; beyond: what they are out of the region."""
        r = self.region
        u = 2 * (r.y_left_m - y) / (r.y_left_m - r.y_right_m) - 1
        v = 2 * (r.x_far_m - x) / (r.x_far_m - r.x_near_m) - 1  # -1..1 from border to border
        return grid_sample(values[None, None], torch.stack([u, v], -1)[None], padding_mode=beyond, align_corners=False)[0, 0]

    def points(self, x: Tensor, y: Tensor) -> Tensor:
        """The road's points `[3, ...]` m behind points of the plane."""
        x, y = torch.broadcast_tensors(x, y)
        h, eye = self.at(self.heights, x.reshape(1, -1), y.reshape(1, -1)).view_as(x), self.eye.to(x)  # h [...] m
        place = torch.stack([x, y, torch.zeros_like(x)])
        return place + (eye.view(3, *(1,) * x.dim()) - place) * (h / eye[2])  # where lines of sight are at height h

    def under(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Height `[h, w]` m of the road at x and y `[h, w]` themselves, and the points `[2, h, w]` of the plane behind which it is."""
        eye, place = self.eye.to(x), torch.stack([x, y])
        heights = torch.zeros_like(x)
        for _ in range(ROUNDS):  # by halves, or what falls off would swing
            # Where lines of sight to height h over the places meet z = 0, [2, h, w].
            behind = eye[:2, None, None] + (place - eye[:2, None, None]) * (eye[2] / (eye[2] - heights))
            heights = (heights + self.at(self.heights, *behind)) / 2
        return heights, behind

    def seen_from(self, lamp: Tensor, points: Tensor, normal: Tensor, deepest_m: float) -> tuple[Tensor, Tensor]:
        """Where on the plane the eye sees the light that a lamp at `[3]` m sends towards points `[3, h, w]` m of a patch: x, y, `[h, w]`.

        normal: `[3]`, unit, of the patch. The light is followed from deepest_m above the patch to as far below it, to the first point under
        the road's surface.
        """
        lamp, eye = lamp.to(points), self.eye.to(points)
        over_patch = ((lamp[:, None, None] - points) * normal[:, None, None]).sum(0)  # [h, w] m, the same everywhere
        h = self._reached(torch.linspace(deepest_m, -deepest_m, LAYERS, dtype=points.dtype, device=points.device), lamp, over_patch, points)
        x, y, z = (point + (lamp[axis] - point) * (h / over_patch) for axis, point in enumerate(points))  # [layers, h, w]
        rise = z / (eye[2] - z).clamp(min=LEAST_DROP_M)  # the eye sees p at p + (p - e) z / (e_z - z) on the plane
        ways = [x + (x - eye[0]) * rise, y + (y - eye[1]) * rise]
        # Height of the road over the light, [layers, h, w] m.
        above = self.at(self.heights, *(way.flatten(0, 1) for way in ways)).view_as(ways[0]) - z
        above[-1].clamp_(min=0)  # what comes so far down ends there
        under = (above >= 0).to(torch.uint8).argmax(0, keepdim=True)  # first layer, [1, h, w]
        over = (under - 1).clamp(min=0)
        d_over, d_under = above.gather(0, over), above.gather(0, under)
        share = torch.where(under > 0, d_under / (d_under - d_over).clamp(min=1e-9), 0.0)  # of the layer over it: linear between both
        x_seen, y_seen = (torch.lerp(way.gather(0, under), way.gather(0, over), share)[0] for way in ways)
        return x_seen, y_seen

    def _reached(self, h: Tensor, lamp: Tensor, over_patch: Tensor, points: Tensor) -> Tensor:
        """Of layers `[layers]` those `[n, 1, 1]` that the road may cross, with the next one above and below it."""
        ends = torch.stack(points[2].aminmax())  # lowest and highest point of the patch, [2] m
        z = ends + (lamp[2] - ends) * (h[:, None] / over_patch[0, 0])  # of each layer, [layers, 2] m
        least, most = self.heights.aminmax()
        over, under = torch.stack([z[:, 0] > most, z[:, 1] < least]).sum(1).tolist()  # layers wholly above and below the road
        return h[max(over - 1, 0) : len(h) - max(under - 1, 0), None, None]
