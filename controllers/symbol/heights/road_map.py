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

PATIENCE = 5  # observations in a row without a lower residual, after which a standing vehicle keeps its best heights: more would fit noise
CHANGED = 4.0  # ratio of an observation's residual to that of the kept heights, above which the road has changed


@dataclass(frozen=True)
class Candidate:
    """Heights and brightness `[n]`, and the symbol drawn for them, whose observation rates them."""

    projection: ProjectionCommand
    heights: Heights
    brightness: Tensor


@dataclass(frozen=True)
class BestCandidate:
    """The heights with the lowest residual in an observation of their own projection, and the number of such observations since."""

    best: Candidate
    residual: float
    observations: int = 0

    @property
    def done(self) -> bool:
        """Whether further observations no longer lower the residual."""
        return self.observations >= PATIENCE


@dataclass(frozen=True)
class RoadMap:
    """Heights and brightness `[n]` at the nodes `[rows, cols]` of a region, by lines of sight of an eye at `[3]` m, in a ground frame.

    T_ground_plane: `[4, 4]` float64, reference plane of heights; region and eye are in its frame. shape: `[4]` of the road, if acquired.
    searched: number of searches. settled: no further search is needed, since two agree or heights explain the road better. drawn: newest
    projections of a standing vehicle with their heights, for late observations. kept: the best of them.
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
    drawn: tuple[Candidate, ...] = ()
    kept: BestCandidate | None = None

    def relief(self) -> HeightMap:
        """The height map for the eye."""
        return HeightMap(self.region, self.eye, self.heights.mean.view(self.grid), self.brightness.view(self.grid))

    def bare(self) -> "RoadMap":
        """The road alone, without the state of searches; equal to another if all tensors are the same objects."""
        return RoadMap(self.heights, self.brightness, self.region, self.grid, self.eye, self.T_ground_plane)

    def showing(self, projection: ProjectionCommand, most: int) -> "RoadMap":
        """The map with a projection for its heights. most: number of projections that may still be observed."""
        if self.drawn and self.drawn[-1].projection.shows(projection):
            return self
        return replace(self, drawn=(*self.drawn, Candidate(projection, self.heights, self.brightness))[-most:])

    def candidate_of(self, projection: ProjectionCommand) -> Candidate | None:
        """The candidate of a projection, if known."""
        return next((each for each in reversed(self.drawn) if each.projection.shows(projection)), None)

    def rate(self, drawn: Candidate, residual: float) -> "RoadMap":
        """The map after an observation of a projection; the best heights are kept until the road changes.

        residual: of its heights; infinite if they explain less than a flat road, which counts only for the kept heights.
        """
        kept = self.kept
        if kept is not None and kept.done:
            if not kept.best.projection.shows(drawn.projection):
                return self
            anew = residual > CHANGED * kept.residual
        elif math.isinf(residual):
            return self
        else:
            anew = kept is None or residual < kept.residual
        return replace(
            self, kept=BestCandidate(drawn, residual) if anew or kept is None else replace(kept, observations=kept.observations + 1)
        )

    def move(self, T_before_now: Tensor, eye: Tensor) -> "RoadMap":
        """The map in a moved ground frame of pose `[4, 4]` in this one, for an eye at `[3]` m there.

        New parts of the region get the height of the border, the assumed road's brightness, and no information. The base stays; `over`
        replaces it for the new ground frame.
        """
        T = T_before_now.to(eye)
        if self._is_seen_so(T, eye):
            return self
        mean, brightness = self._seen_by(T, eye)
        information = self._carry(self._seen_anew(self.nodes(), self.heights.mean, self.eye, inverse(T), eye))
        return replace(
            self, heights=Heights(mean, information, self.heights.base, spread=True), brightness=brightness, eye=eye, drawn=(), kept=None
        )

    def over(self, base: Tensor) -> "RoadMap":
        """The map with another base `[n]` m, the heights without information."""
        mean = self.heights.mean if self.heights.any_information else base
        return replace(self, heights=replace(self.heights, mean=mean, base=base))

    def relief_from(self, T_before_now: Tensor, eye: Tensor) -> HeightMap:
        """`move(...).relief()`, without information."""
        T = T_before_now.to(eye)
        if self._is_seen_so(T, eye):
            return self.relief()
        heights, brightness = self._seen_by(T, eye)
        return HeightMap(self.region, eye, heights.view(self.grid), brightness.view(self.grid))

    def tracks(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Height in m of the road at places `[2, k]` of the ground, and its information in 1/m^2: 0 outside of the region."""
        relief = self.relief()
        heights, places = relief.under(x, y)  # [2, k] m, [2 (x, y), 2, k] m
        r = self.region
        inside = (places[0] > r.x_near_m) & (places[0] < r.x_far_m) & (places[1] < r.y_left_m) & (places[1] > r.y_right_m)
        return heights, relief.at(self.heights.information.diagonal().view(self.grid), *places) * inside

    def tilt(self, pitch_rad: float, pivot_x_m: float) -> "RoadMap":
        """The map if the observing body had pitched by this many rad more."""
        heights = self.heights.mean - pitch_rad * (self.nodes()[0] - pivot_x_m)  # [n]
        return replace(self, heights=replace(self.heights, mean=heights))

    def loosen(self, pitch_rad: float, pivot_x_m: float) -> "RoadMap":
        """The map with a pitch uncertainty in rad: all heights share an error proportional to distance (Woodbury)."""
        L, arm = self.heights.information, self.nodes()[0] - pivot_x_m  # [n, n], a [n] m
        pull = L @ arm
        information = L - pull[:, None] * pull / (1 / pitch_rad**2 + arm @ pull)  # L - L a a' L / (1 / sigma^2 + a' L a)
        return replace(self, heights=replace(self.heights, information=information, spread=True))

    def pitch_between(self, before: "RoadMap", pivot_x_m: float) -> float | None:
        """Pitch error in rad of the body if the road equals the earlier map; None: unknown."""
        known, seen = (each.heights.information.diagonal() for each in (before, self))
        arm = self.nodes()[0] - pivot_x_m
        weight = arm * known * seen / (known + seen).clamp(min=1.0)  # a / (1 / k + 1 / s), [n]
        lever = float(weight @ arm)
        return float(weight @ (self.heights.mean - before.heights.mean)) / lever if lever > 0 else None  # weighted least squares

    def nodes(self) -> Tensor:
        """Places `[3, n]` of the nodes on the plane."""
        r, (rows, cols) = self.region, self.grid
        x = r.x_far_m - (torch.arange(rows).to(self.eye) + 0.5) * ((r.x_far_m - r.x_near_m) / rows)
        y = r.y_left_m - (torch.arange(cols).to(self.eye) + 0.5) * ((r.y_left_m - r.y_right_m) / cols)
        return torch.stack([x[:, None].expand(rows, cols), y.expand(rows, cols), torch.zeros_like(x)[:, None].expand(rows, cols)]).flatten(
            1
        )

    def _is_seen_so(self, T: Tensor, eye: Tensor) -> bool:
        return eye.equal(self.eye) and T.equal(torch.eye(4).to(T))

    def _seen_by(self, T: Tensor, eye: Tensor) -> tuple[Tensor, Tensor]:
        """Heights and brightness `[n]` at the nodes for an eye in the ground frame of pose T `[4, 4]` in this one."""
        relief, nodes = self.relief(), self.nodes()
        heights = -transform(T, nodes)[2]  # of the old plane
        for _ in range(3):  # iterate, as the end of a line of sight depends on its height
            x, y, z = self._seen_anew(nodes, heights, eye, T, self.eye)  # [1, n] each
            heights = heights + (relief.at(relief.heights, x, y) - z).flatten()
        return heights, 1 + relief.at(relief.brightness - 1, x, y, beyond="zeros").flatten()

    def _seen_anew(self, nodes: Tensor, heights: Tensor, eye: Tensor, T: Tensor, other: Tensor) -> Tensor:
        """Places on its plane where another eye sees road points of height `[n]` m on an eye's lines of sight through nodes `[3, n]`.

        T: the ground frame of eye and nodes in that of the other. Returns x, y there and the road's height in that frame, `[3, 1, n]`.
        """
        road = transform(T, nodes + (eye[:, None] - nodes) * (heights / eye[2]))  # p = T (q + (e - q) h / e_z), [3, n] m
        x, y, _ = other[:, None] + (road - other[:, None]) * (other[2] / (other[2] - road[2]))  # where lines of sight meet z = 0, [n] each
        return torch.stack([x, y, road[2]])[:, None]

    def _carry(self, places: Tensor) -> Tensor:
        """Information `[n, n]` at the nodes, from heights that moved to places between them.

        With `old = V new` the old `old^T L old` is `new^T V^T L V new`. Heights outside the region are dropped.
        """
        r, (rows, cols) = self.region, self.grid
        down = (r.x_far_m - places[0].flatten()) / (r.x_far_m - r.x_near_m) * rows - 0.5
        right = (r.y_left_m - places[1].flatten()) / (r.y_left_m - r.y_right_m) * cols - 0.5
        stays = (down > -0.5) & (down < rows - 0.5) & (right > -0.5) & (right < cols - 0.5)
        down, right = down.clamp(0, rows - 1), right.clamp(0, cols - 1)
        r0, c0 = down.floor().clamp(max=rows - 2), right.floor().clamp(max=cols - 2)
        a, b, first = down - r0, right - c0, (r0 * cols + c0).long()
        to = torch.stack([first, first + 1, first + cols, first + cols + 1])
        weight = torch.stack([(1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b]) * stays  # of V, [4, n]
        information = self.heights.information
        for _ in range(2):  # V' L, transposed, and V' of that: V' L V, since L is symmetric
            shares = (weight[:, :, None] * information).flatten(0, 1)  # [4 * n, n]
            information = torch.zeros_like(information).index_add_(0, to.flatten(), shares).T.contiguous()
        return information
