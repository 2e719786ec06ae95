"""Road map: estimated heights that stay on the road while the vehicle drives over it."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from luxloop.controllers.symbol.heights.height_map import HeightMap
from luxloop.controllers.symbol.heights.registration import Heights
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.road_shape import HERE
from luxloop.perception.birdseye import Region
from luxloop.world.frames import inverse, transform
from luxloop.world.texels import neighbours

LEAST_SPREAD_M2 = 0.1  # of the known heights along the road, below which their slope counts less
PATIENCE = 3  # steps without a lower residual after which a standing vehicle keeps the best candidate: more would fit noise
LEAST_DROP = 0.005  # of the residual, above the noise of its measurement
CHANGED = 0.05  # rise of the kept candidate's residual by which the road has changed


@dataclass(frozen=True)
class Candidate:
    """A road map, and the projection for it; the residual of its observation rates them."""

    projection: ProjectionCommand
    road_map: "RoadMap"


@dataclass(frozen=True)
class BestCandidate:
    """The candidate with the lowest residual, and the number of steps since in which others waited for their observation."""

    best: Candidate
    residual: float
    steps: int = 0

    @property
    def done(self) -> bool:
        """Whether the residual has stopped falling."""
        return self.steps >= PATIENCE


@dataclass(frozen=True)
class RoadMap:
    """Heights and brightness `[n]` at the nodes, on the lines of sight of an eye at `[3]` m through a region of a plane.

    grid: rows and columns of the nodes. T_ground_plane: `[4, 4]` float64, reference plane of the heights; region and eye are in its frame.
    shape: `[4]` of the relocalised or guessed road. searched: number of searches of the whole image. settled: whether no further search is
    needed, since two agree or heights explain the image better. drawn: newest candidate of a standing vehicle. kept: the best candidate.
    """

    heights: Heights
    brightness: Tensor
    region: Region
    grid: tuple[int, int]
    eye: Tensor
    T_ground_plane: Tensor = HERE
    shape: Tensor | None = None
    searched: int = 0
    settled: bool = False
    drawn: Candidate | None = None
    kept: BestCandidate | None = None

    def relief(self) -> HeightMap:
        """The height map for the eye."""
        return HeightMap(self.region, self.eye, self.heights.mean.view(self.grid), self.brightness.view(self.grid))

    def bare(self) -> "RoadMap":
        """The map without the state of searches and candidates; equal maps have the same tensor objects."""
        return RoadMap(self.heights, self.brightness, self.region, self.grid, self.eye, self.T_ground_plane)

    def showing(self, projection: ProjectionCommand) -> "RoadMap":
        """The map with a candidate for its heights."""
        if self.drawn is not None and self.drawn.projection.shows(projection):
            return self
        return replace(self, drawn=Candidate(projection, replace(self, drawn=None, kept=None)))

    def rate(self, residual: float, steps: int) -> "RoadMap":
        """The map after an observation of the newest candidate; the best candidate is kept until the road changes.

        residual: of the candidate; infinite if its heights explain less than a flat road. steps: from its command to this observation.
        """
        drawn, kept = self.drawn, self.kept
        assert drawn is not None
        if kept is None:
            return self if math.isinf(residual) else replace(self, kept=BestCandidate(drawn, residual))
        if kept.best.projection.shows(drawn.projection):
            changed = kept.done and residual > kept.residual + CHANGED
            return replace(self, kept=BestCandidate(drawn, residual)) if changed else self
        if math.isinf(residual):
            return self
        best = BestCandidate(drawn, residual) if residual < kept.residual else kept
        return replace(self, kept=replace(best, steps=0 if residual < kept.residual - LEAST_DROP else kept.steps + steps))

    def choice(self) -> "RoadMap | None":
        """The map of the best candidate once the search has ended, else None."""
        kept = self.kept
        return replace(kept.best.road_map, drawn=self.drawn, kept=kept) if kept is not None and kept.done else None

    def move(self, T_before_now: Tensor, eye: Tensor) -> "RoadMap":
        """The map in another ground frame of pose `[4, 4]` in the present one, for an eye at `[3]` m in the new frame.

        Nodes that the map does not cover get the height at its border, brightness 1 and no information. `over` sets the base for the new
        frame.
        """
        T = T_before_now.to(eye)
        if self._is_seen_so(T, eye):
            return self
        mean, brightness = self._seen_by(T, eye)
        information = self._carry(self._seen_anew(self.nodes(), self.heights.mean, self.eye, inverse(T), eye))
        return replace(
            self,
            heights=Heights(mean, information, self.heights.base, torch.zeros_like(mean)),
            brightness=brightness,
            eye=eye,
            drawn=None,
            kept=None,
        )

    def over(self, base: Tensor) -> "RoadMap":
        """The map with another base `[n]` m, raised and sloped along the road to fit the known heights, so that it continues them.

        Heights without information become the base.
        """
        if not self.heights.any_information:
            return replace(self, heights=replace(self.heights, mean=base, base=base))
        x, rest, share = self.nodes()[0], self.heights.mean - base, self.heights.information / self.heights.information.sum()
        away = x - share @ x
        slope = (share * away) @ rest / ((share * away) @ away).clamp(min=LEAST_SPREAD_M2)
        return replace(self, heights=replace(self.heights, base=base + share @ rest + slope * away))

    def relief_from(self, T_before_now: Tensor, eye: Tensor) -> HeightMap:
        """`move(...).relief()` without carrying the information."""
        T = T_before_now.to(eye)
        if self._is_seen_so(T, eye):
            return self.relief()
        heights, brightness = self._seen_by(T, eye)
        return HeightMap(self.region, eye, heights.view(self.grid), brightness.view(self.grid))

    def tracks(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Road height in m at ground coordinates x, y `[2, k]`, and its information in 1/m^2, 0 outside the region."""
        relief = self.relief()
        heights, places = relief.under(x, y)  # [2, k] m, [2 (x, y), 2, k] m
        r = self.region
        inside = (places[0] > r.x_near_m) & (places[0] < r.x_far_m) & (places[1] < r.y_left_m) & (places[1] > r.y_right_m)
        return heights, relief.at(self.heights.information.view(self.grid), *places) * inside

    def tilt(self, pitch_rad: float, pivot_x_m: float) -> "RoadMap":
        """The map for a body pitch that is larger by pitch_rad."""
        heights = self.heights.mean - pitch_rad * (self.nodes()[0] - pivot_x_m)  # [n]
        return replace(self, heights=replace(self.heights, mean=heights))

    def loosen(self, pitch_rad: float, pivot_x_m: float) -> "RoadMap":
        """The map with a pitch uncertainty: all heights share an error proportional to the distance from the pivot (Woodbury)."""
        arm = self.nodes()[0] - pivot_x_m  # a [n] m
        pull = self.heights.information * arm
        shared = pull / (1 / pitch_rad**2 + arm @ pull).sqrt()  # L - L a a' L / (1 / sigma^2 + a' L a)
        return replace(self, heights=replace(self.heights, shared=shared))

    def pitch_between(self, before: "RoadMap", pivot_x_m: float) -> float | None:
        """Pitch error in rad of the body, from the height difference to an earlier map; None if the maps share no information."""
        known, seen = (each.heights.information for each in (before, self))
        arm = self.nodes()[0] - pivot_x_m
        weight = arm * known * seen / (known + seen).clamp(min=1.0)  # a / (1 / k + 1 / s), [n]
        lever = float(weight @ arm)
        return float(weight @ (self.heights.mean - before.heights.mean)) / lever if lever > 0 else None  # weighted least squares

    def nodes(self) -> Tensor:
        """Positions `[3, n]` m of the nodes on the plane."""
        r, (rows, cols) = self.region, self.grid
        x = r.x_far_m - (torch.arange(rows).to(self.eye) + 0.5) * ((r.x_far_m - r.x_near_m) / rows)
        y = r.y_left_m - (torch.arange(cols).to(self.eye) + 0.5) * ((r.y_left_m - r.y_right_m) / cols)
        return torch.stack([x[:, None].expand(rows, cols), y.expand(rows, cols), torch.zeros_like(x)[:, None].expand(rows, cols)]).flatten(
            1
        )

    def _is_seen_so(self, T: Tensor, eye: Tensor) -> bool:
        return eye.equal(self.eye) and T.equal(torch.eye(4).to(T))

    def _seen_by(self, T: Tensor, eye: Tensor) -> tuple[Tensor, Tensor]:
        """Heights and brightness `[n]` at the nodes for an eye in a ground frame of pose T `[4, 4]` in the present one."""
        relief, nodes = self.relief(), self.nodes()
        heights = -transform(T, nodes)[2]  # of the old plane
        for _ in range(3):  # iterate, as the end of a line of sight depends on its height
            x, y, z = self._seen_anew(nodes, heights, eye, T, self.eye)  # [1, n] each
            heights = heights + (relief.at(relief.heights, x, y) - z).flatten()
        return heights, 1 + relief.at(relief.brightness - 1, x, y, beyond="zeros").flatten()

    def _seen_anew(self, nodes: Tensor, heights: Tensor, eye: Tensor, T: Tensor, other: Tensor) -> Tensor:
        """Where another eye sees the road points at heights `[n]` m on an eye's lines of sight through nodes `[3, n]`.

        T: ground frame of eye and nodes, in the ground frame of the other eye. Returns x, y on the plane and the height of the points, in
        the other eye's frame, `[3, 1, n]`.
        """
        road = transform(T, nodes + (eye[:, None] - nodes) * (heights / eye[2]))  # p = T (q + (e - q) h / e_z), [3, n] m
        x, y, _ = other[:, None] + (road - other[:, None]) * (other[2] / (other[2] - road[2]))  # where lines of sight meet z = 0, [n] each
        return torch.stack([x, y, road[2]])[:, None]

    def _carry(self, places: Tensor) -> Tensor:
        """Information `[n]` at the nodes, shared out from positions between the nodes; that outside the region is dropped."""
        r, (rows, cols) = self.region, self.grid
        row = (r.x_far_m - places[0].flatten()) / (r.x_far_m - r.x_near_m) * rows
        col = (r.y_left_m - places[1].flatten()) / (r.y_left_m - r.y_right_m) * cols
        to, weight = neighbours(row, col, rows, cols)
        weight = weight * ((row > 0) & (row < rows) & (col > 0) & (col < cols))  # of V, [4, n]
        information = self.heights.information
        return torch.zeros_like(information).index_add_(0, to.flatten(), (weight * information).flatten())
