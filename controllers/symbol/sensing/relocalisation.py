"""Relocalisation: the road's height, slopes and curvature from the place of the lamps' pattern in the whole image.

All light of a lamp leaves one point, so a road's shape gives the image point of each ray's light. The image is sampled there and compared
with the pattern in the lamp's coordinates by normalised cross-correlation, which is independent of the symbol's brightness and size. Many
shapes are tried, and the best are refined.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, pad

from luxloop.controllers.symbol.sensing.projector import DrawingModule
from luxloop.controllers.symbol.sensing.road_shape import ray_lengths
from luxloop.world.frames import View
from luxloop.world.texels import TexelGrid, resample

GRID = (28, 16)  # rays of a pattern, along and across
MARGIN = 0.5  # of the pattern's extent, dark surroundings that are compared as well
DIM = 0.1  # of the brightest light: threshold of the pattern
DISTANCES_M = (6.0, 70.0)  # ahead of the lamp, range of the pattern's middle
ROWS = 2.0  # image rows between two tried distances
HIGHEST_M, STEEPEST, CURVED = 1.2, 0.2, 1 / 100  # largest height at x0, slope, and curvature in 1/m
SLOPES = ((-0.13, -0.08, -0.05, -0.03, -0.015, 0.0, 0.015, 0.03, 0.05, 0.08, 0.13), (-0.05, -0.02, 0.0, 0.02, 0.05))  # tried: along, across
STEPS = (0.04, 0.008, 0.015, 0.004)  # of the parameters in refinement
KEPT = 4  # candidates that are refined
ROUNDS = 6  # rounds of refinement, each with half the steps of the previous one
BLUR, BLURRED_OVER = (1.0, 2.5), (7, 15)  # rows and columns of the image
USUAL, WORTH = (0.5, 0.03, 0.03, 1 / 300), 0.005  # usual parameters, and the cost in correlation of larger ones
NEAREST_M, FARTHEST_M, NOWHERE_PX = 0.1, 1e3, -1e6
LEAST_MATCH = 0.5  # least correlation of a found pattern
FAINT_PX = 20.0  # least lit pixels of a pattern


@dataclass(frozen=True)
class Relocalisation:
    """Result of a search. shape: `[4]` of the road. match: its correlation, at most 1. flat: correlation of a flat road."""

    shape: Tensor
    match: float
    flat: float

    @property
    def found(self) -> bool:
        """Whether the pattern is found, and its shape explains at least half of the flat road's mismatch."""
        return self.match > max(LEAST_MATCH, (self.flat + 1) / 2)


@dataclass(frozen=True)
class Pattern:
    """The light pattern of a module along a grid of rays.

    values: `[rows, cols]`, mean intensity around each ray over the maximum. lit: `[rows, cols]`, lit share around each ray. origin: `[3]`
    m. rays: `[3, rows, cols]`, directions.
    """

    values: Tensor
    lit: Tensor
    origin: Tensor
    rays: Tensor

    @classmethod
    def of(cls, texture: Tensor, grid: TexelGrid, T_ground_headlight: Tensor) -> Self | None:
        """The pattern of the lit part of a light texture `[rows, cols]` cd with a dark margin; None for a dark texture."""
        lit = texture > DIM * texture.max()
        if not bool(lit.any()):
            return None
        (top, bottom), (left, right) = (_extent(lit.any(dim)) for dim in (1, 0))
        n, m = GRID
        usual = texture[texture > 0].mean()  # robust against single bright texels
        images = torch.stack([texture / texture.max(), (texture > DIM * usual).to(texture)])
        window = pad(images, (-left, right - grid.cols, -top, bottom - grid.rows))  # dark beyond the texture
        values, share = adaptive_avg_pool2d(window, GRID)
        row = top + (bottom - top) * (torch.arange(n).to(texture) + 0.5) / n
        col = left + (right - left) * (torch.arange(m).to(texture) + 0.5) / m
        y = grid.left + (grid.right - grid.left) * col / grid.cols
        z = grid.top + (grid.bottom - grid.top) * row / grid.rows
        T = T_ground_headlight.to(texture)
        rays = torch.stack([torch.ones(n, m).to(texture), y.expand(n, m), z[:, None].expand(n, m)])
        return cls(values, share, T[:3, 3], (T[:3, :3] @ rays.flatten(1)).view_as(rays))


def _extent(lit: Tensor) -> tuple[int, int]:
    """First lit index and the index after the last, with the margin."""
    places = lit.nonzero()[:, 0].tolist()
    margin = math.ceil(MARGIN * (places[-1] + 1 - places[0]))
    return places[0] - margin, places[-1] + 1 + margin


@dataclass(frozen=True)
class Relocaliser:
    """Searches whole camera images for the light of a projector's modules."""

    modules: tuple[DrawingModule, ...]
    view: View
    x0_m: float

    def find(self, symbol: Tensor, textures: Sequence[Tensor]) -> Relocalisation:
        """The road shape with the best correlation of textures, one a module, with a symbol image `[height, width]`."""
        patterns = self._patterns(textures)
        if not patterns or float(symbol.sum()) < FAINT_PX:
            return Relocalisation(symbol.new_zeros(4), 0.0, 0.0)
        from kornia.filters import gaussian_blur2d

        image = gaussian_blur2d(symbol[None, None], BLURRED_OVER, BLUR)
        shapes = self._trial_shapes(patterns[0])
        matches = self._matches(shapes, image, patterns)
        step = symbol.new_tensor(STEPS)
        around = torch.cartesian_prod(*[symbol.new_tensor([-1.0, 0.0, 1.0])] * 4)
        for _ in range(ROUNDS):
            best = shapes[matches.topk(KEPT).indices]
            shapes = (best[:, None] + around * step).flatten(0, 1)
            matches = self._matches(shapes, image, patterns)
            step = step / 2
        match, best = matches.max(0)
        flat = self._matches(torch.zeros_like(shapes[:1]), image, patterns)
        return Relocalisation(shapes[best], float(match), float(flat))

    def area(self, shape: Tensor, textures: Sequence[Tensor]) -> Tensor:
        """Number `[]` of image pixels lit by textures, one a module, on a road of shape `[4]`."""
        areas = []
        for pattern in self._patterns(textures):
            u, v = self._seen_at(shape[None], pattern)[0].view(2, *pattern.values.shape)
            (u_down, u_right), (v_down, v_right) = (torch.gradient(each) for each in (u, v))
            areas.append(((u_right * v_down - u_down * v_right).abs() * pattern.lit).sum())
        return torch.stack(areas).amax() if areas else shape.new_zeros(())

    def _patterns(self, textures: Sequence[Tensor]) -> list[Pattern]:
        """Patterns of all modules that emit light."""
        found = (
            Pattern.of(texture, module.pixel_controller.headlight, module.T_body_headlight)
            for module, texture in zip(self.modules, textures, strict=True)
        )
        return [pattern for pattern in found if pattern is not None]

    def _matches(self, shapes: Tensor, image: Tensor, patterns: Sequence[Pattern]) -> Tensor:
        """Correlation `[k]` of patterns with an image `[1, 1, height, width]` for road shapes `[k, 4]`, less the cost of unusual shapes."""
        possible = (shapes.abs() <= shapes.new_tensor((HIGHEST_M, STEEPEST, STEEPEST, CURVED))).all(-1)
        unusual = WORTH * (shapes / shapes.new_tensor(USUAL)).square().log1p().sum(-1)
        return torch.where(possible, torch.stack([self._match(shapes, image, each) for each in patterns]).mean(0) - unusual, -1.0)

    def _match(self, shapes: Tensor, image: Tensor, pattern: Pattern) -> Tensor:
        size = image.new_tensor([[image.shape[-1]], [image.shape[-2]]])
        u, v = (2 * self._seen_at(shapes, pattern) / size - 1).unbind(1)
        seen = resample(image, u[None], v[None])[0, 0]
        seen, values = seen - seen.mean(-1, keepdim=True), (pattern.values - pattern.values.mean()).flatten()
        return seen @ values / (seen.norm(dim=-1) * values.norm()).clamp(min=1e-6)

    def _seen_at(self, shapes: Tensor, pattern: Pattern) -> Tensor:
        """Image coordinates `[k, 2, rays]` px where a pattern's rays meet roads of shapes `[k, 4]`; far outside for rays that miss."""
        rays = pattern.rays.flatten(1)
        share = ray_lengths(shapes, self.x0_m, pattern.origin, rays).clamp(max=FARTHEST_M)
        uv, depth = self.view.project((pattern.origin[:, None, None] + rays[:, None] * share).flatten(1))
        return torch.where(depth > NEAREST_M, uv, NOWHERE_PX).view(2, *share.shape).transpose(0, 1)

    def _trial_shapes(self, pattern: Pattern) -> Tensor:
        """Trial shapes `[k, 4]`: all combinations of SLOPES with points of the pattern's middle ray that are ROWS image rows apart."""
        middle = pattern.rays[:, GRID[0] // 2, GRID[1] // 2]
        x = torch.linspace(*DISTANCES_M, 2000).to(middle)
        points = pattern.origin[:, None] + middle[:, None] * ((x - pattern.origin[0]) / middle[0])
        uv, _ = self.view.project(points)
        number = ((uv[1] - uv[1, 0]).abs() / ROWS).floor()
        x, y, z = points[:, torch.cat([number.new_ones(1, dtype=torch.bool), number.diff() > 0])]
        b, c = (middle.new_tensor(tried) for tried in SLOPES)
        x, y, z, b, c = torch.broadcast_tensors(*(v[:, None, None] for v in (x, y, z)), b[:, None], c)
        a = z - b * (x - self.x0_m) - c * y
        return torch.stack([a, b, c, torch.zeros_like(a)], -1).flatten(0, 2)
