"""Heights of the road by registration: the light that was shown, laid over a road of these heights, shall be what the camera sees."""

import math
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from controllers.symbol.heights.forward_model import ForwardModel

BLURS = ((1.0, 4.0, 0.4), (0.6, 2.5, 0.25))  # rows and camera columns, and half the residual of an outlier
HIDDEN = 0.6  # outliers begin so much earlier where light is missing, since it may be hidden
ITERATIONS = 3
PROBE_M = 0.002  # of height, for slopes
LARGEST_STEP_M = 0.03
PIXEL_SIGMA = 0.15  # of the symbol image
SLOPE_M = 0.02  # usual difference of neighbouring heights over a square cell; much larger ones count as edges
HEIGHT_M = 0.08  # usual height
FREE_M = 0.01  # how far above a free way of light a height may be


@dataclass(frozen=True)
class Heights:
    """Heights at nodes: mean `[n]` m and information `[n, n]` 1/m^2 from what was seen so far; without any they are those of base `[n]`."""

    mean: Tensor
    information: Tensor
    base: Tensor

    @property
    def informed(self) -> bool:
        """Whether anything was seen so far."""
        return bool(self.information.diagonal().any())


@dataclass(frozen=True)
class Registration:
    """Registers observations of one forward model."""

    forward_model: ForwardModel
    edges: Tensor
    slopes: Tensor
    pairs: Tensor
    products: Tensor

    @classmethod
    def prepare(cls, forward_model: ForwardModel) -> "Registration":
        """Make the tables of node pairs once."""
        rows, cols, region = forward_model.rows, forward_model.cols, forward_model.region
        k = torch.arange(rows * cols, device=forward_model.node.device).view(rows, cols)
        down, right = torch.stack([k[1:], k[:-1]]).flatten(1), torch.stack([k[:, 1:], k[:, :-1]]).flatten(1)  # pairs, [2, E_d], [2, E_r]
        aspect = (region.x_far_m - region.x_near_m) / rows / ((region.y_left_m - region.y_right_m) / cols)  # length over width of a cell
        slopes = torch.cat([torch.full((down.shape[1],), aspect**0.5), torch.full((right.shape[1],), aspect**-0.5)]).to(k.device)
        pairs = (forward_model.node[:, None] * (rows * cols) + forward_model.node).flatten()  # flat indices into [n, n], [4 * 4 * h * w]
        products = (forward_model.weight[:, None] * forward_model.weight).flatten(0, 1)  # w_a w_b, [4 * 4, h * w]
        return cls(forward_model, torch.cat([down, right], 1), SLOPE_M * slopes, pairs, products)

    def unknown(self) -> Heights:
        """Zero, and nothing known."""
        n = self.forward_model.rows * self.forward_model.cols
        zero = self.slopes.new_zeros(n)
        return Heights(zero, zero.new_zeros(n, n), zero)

    def residual(self, nodes: Tensor, seen: Tensor, textures: tuple[Tensor, ...], limit: Tensor) -> Tensor:
        """What heights `[k, n]` leave unexplained of a symbol image `[h, w]`, as a share of what they predict to be lit: `[k]`."""
        predicted = self._predicted(nodes, textures, limit, BLURS[-1])  # [k, h, w]
        # min(e^2, 0.3^2), [k, h, w].
        error = (self._blurred(seen[None], BLURS[-1]) - predicted).square().clamp(max=0.09) * self.forward_model.inside
        return error.sum((-2, -1)) / (predicted * self.forward_model.inside).sum((-2, -1)).clamp(min=1.0)

    def refine(
        self, nodes: Tensor, known: Heights, seen: Tensor, textures: tuple[Tensor, ...], limit: Tensor, iterations: int = ITERATIONS
    ) -> Heights:
        """Gauss-Newton from heights `[n]`, on a symbol image `[h, w]` and what is known; the information is that of the image alone.

        iterations: for each of the two blurs.

        The heights z have the least `sum rho(seen - p(z)) + (z - m)' L (z - m) + sum 4 log(1 + d_ij^2 / (4 s_ij^2)) + |z - b|^2 / h^2`
        with the predicted image p, Tukey's biweight rho, the known mean m and information L, the base b, its usual distance h, and the
        differences d_ij of z - b between neighbours with their usual size s_ij (Cauchy). None lies above a free way of light.
        """
        forward_model, (i, j), n = self.forward_model, self.edges, len(nodes)
        information = known.information
        for blur in BLURS:
            smooth = self._blurred(seen[None], blur)[0]
            for _ in range(iterations):
                around = torch.stack([nodes, nodes + PROBE_M, nodes - PROBE_M])  # [3, n], for central differences
                predicted, higher, lower = self._predicted(around, textures, limit, blur)
                slope, error = (higher - lower) / (2 * PROBE_M), smooth - predicted  # J = dp/dz and e, both [h, w]
                scale = 2 * blur[2] * torch.where(error < 0, HIDDEN, 1.0)  # of Tukey's biweight w = (1 - (e / scale)^2)^2
                weight = (  # W = w / sigma^2 times independent pixels, step / (rows * columns of the blur), [h, w]
                    (1 - (error / scale) ** 2).clamp(min=0) ** 2
                    * forward_model.inside
                    * (forward_model.step / (PIXEL_SIGMA**2 * blur[0] * blur[1]))
                )
                information = self._squared(weight * slope * slope)  # J' W J [n, n]
                force = (  # J' W e + L (m - z) + (b - z) / h^2, [n]
                    forward_model.on_nodes(weight * slope * error)
                    + known.information @ (known.mean - nodes)
                    + (known.base - nodes) / HEIGHT_M**2
                )
                free, above = self._free(forward_model.on_pixels(nodes), seen)  # f and its weight A, [h, w] each
                matrix = information + known.information + self._squared(above)  # of the normal equations, [n, n]
                force = force + forward_model.on_nodes(above * (free - forward_model.on_pixels(nodes)))  # and the pull down to f, [n]
                step = (nodes - known.base)[i] - (nodes - known.base)[j]  # d_ij, [E_d + E_r]
                stiffness = 1 / (self.slopes**2 + step**2 / 4)  # an edge as soon as it is steep: Cauchy, [E_d + E_r]
                force = force.index_add(0, i, -stiffness * step).index_add(0, j, stiffness * step)
                for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):  # D' diag(stiffness) D, where d = D (z - b)
                    matrix.view(-1).index_add_(0, a * n + b, sign * stiffness)
                matrix.diagonal().add_(1 / HEIGHT_M**2)
                # The step of Gauss-Newton, matrix^-1 (J' W e + pull of all that is known) [n].
                moved = torch.cholesky_solve(force[:, None], torch.linalg.cholesky(matrix))[:, 0]
                nodes = nodes + moved.clamp(-LARGEST_STEP_M, LARGEST_STEP_M)
        return Heights(nodes, information, known.base)

    def _predicted(self, nodes: Tensor, textures: tuple[Tensor, ...], limit: Tensor, blur: tuple[float, float, float]) -> Tensor:
        luminance = self.forward_model.luminance(textures, self.forward_model.on_pixels(nodes))
        return self._blurred(self.forward_model.symbol(luminance, limit), blur)

    def _blurred(self, image: Tensor, blur: tuple[float, float, float]) -> Tensor:
        down, across = (_gaussian(sigma, image.device) for sigma in (blur[0], blur[1] / self.forward_model.step))  # [1, 1, taps] each
        return conv2d(conv2d(image[:, None], across[:, None], padding="same"), down[..., None], padding="same")[:, 0]

    def _squared(self, weight: Tensor) -> Tensor:
        """`J^T W J` `[n, n]` of a weight `[h, w]` for each pixel."""
        n = self.forward_model.rows * self.forward_model.cols
        return weight.new_zeros(n * n).index_add_(0, self.pairs, (self.products * weight.flatten()).flatten()).view(n, n)

    def _free(self, heights: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Space carving: where light arrives, nothing nearer is in its way.

        Returns the height `[h, w]` m that dark pixels have at most by that, and the weight `[h, w]` 1/m^2 of those that are higher. With
        several lamps there are none: it is not known whose light arrives.
        """
        lamp, middle = self.forward_model.lamps[0], self.forward_model.samples // 2
        on_plane, per_m = (a[:, middle :: self.forward_model.samples] for a in (lamp.on_plane, lamp.per_m))  # [3, h, w] each
        rise = (on_plane[2] + per_m[2] * heights) / (on_plane[0] + per_m[0] * heights)  # z / x of the lamp's rays, [h, w]
        lit = (seen > 0.5) & (self.forward_model.inside > 0)
        lowest = torch.where(lit, rise, torch.inf).cummin(-2).values  # of all lit pixels farther away, [h, w]
        highest = (lowest * on_plane[0] - on_plane[2]) / (per_m[2] - lowest * per_m[0])  # height whose rise is the lowest, [h, w] m
        above = (rise > lowest) & (seen < 0.2) & (self.forward_model.inside > 0) & lowest.isfinite() & (len(self.forward_model.lamps) == 1)
        return torch.where(above, highest, 0.0), above / FREE_M**2 * self.forward_model.step


@lru_cache(maxsize=8)
def _gaussian(sigma: float, device: torch.device) -> Tensor:
    """Its kernel `[1, 1, n]`, to two and a half deviations."""
    from kornia.filters import get_gaussian_kernel1d

    return get_gaussian_kernel1d(2 * math.ceil(2.5 * sigma) + 1, sigma, device=device)[None]
