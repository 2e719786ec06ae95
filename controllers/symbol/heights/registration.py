"""Road heights from one observation: plane sweep as initial guess, then Gauss-Newton registration with band matrices."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import scipy  # loads its parts on first use
import torch
from torch import Tensor
from torch.nn.functional import pad

from luxloop.controllers.symbol.heights.forward_model import ForwardModel


def solve(band: Tensor, right: Tensor) -> Tensor:
    """The `x [n, k]` with `A x = right [n, k]` of a positive definite band matrix A: its main diagonal and those below, `[width, n]`."""
    found = scipy.linalg.solveh_banded(band.cpu().numpy(), right.cpu().numpy(), lower=True, check_finite=False)
    return torch.from_numpy(found).to(right.device)


Blur = tuple[float, float, float]  # rows and camera columns, and half the residual of an outlier
COARSE, FINE = (1.0, 4.0, 0.4), (0.6, 2.5, 0.25)
BLURS = (COARSE,) * 3 + (FINE,) * 3  # of the steps from unknown heights
HIDDEN = 0.6  # factor on the outlier scale where light is missing, since it may be hidden
PROBE_M = 0.002  # of height, for slopes
LARGEST_STEP_M = 0.03
PIXEL_SIGMA = 0.15  # of the symbol image
SLOPE_M = 0.02  # usual difference of neighbouring heights over a square cell; much larger ones are edges
HEIGHT_M = 0.08  # usual height
FREE_M = 0.01  # tolerance of heights above a free light path


@dataclass(frozen=True)
class Heights:
    """Height estimate at the nodes: mean `[n]` m, information of each `[n]` 1/m^2, and base `[n]` m, the mean before any observation.

    shared: `[n]` 1/m, of an error that all heights share, such as the pitch's: the information matrix is
    `diag(information) - shared shared'`. It counts until the next observation, whose own is taken as independent.
    """

    mean: Tensor
    information: Tensor
    base: Tensor
    shared: Tensor

    @property
    def any_information(self) -> bool:
        """Whether the information is not zero."""
        return bool(self.information.any())


@dataclass(frozen=True)
class Registration:
    """Registers heights to symbol images by one forward model.

    edges: `[2, e]`, pairs of neighbouring nodes. slopes: `[e]` m, usual height differences of the pairs. tied, pairs: flat indices in band
    matrices of the nodes. products: `[10, h * w]`, products of the bilinear weights of a pixel's nodes.
    """

    forward_model: ForwardModel
    edges: Tensor
    slopes: Tensor
    tied: Tensor
    pairs: Tensor
    products: Tensor

    @classmethod
    def prepare(cls, forward_model: ForwardModel) -> "Registration":
        """Compute the tables of node pairs."""
        rows, cols, region = forward_model.rows, forward_model.cols, forward_model.region
        n, node, weight = rows * cols, forward_model.node, forward_model.weight
        k = torch.arange(n, device=node.device).view(rows, cols)
        down, right = torch.stack([k[1:], k[:-1]]).flatten(1), torch.stack([k[:, 1:], k[:, :-1]]).flatten(1)  # pairs, [2, E_d], [2, E_r]
        aspect = (region.x_far_m - region.x_near_m) / rows / ((region.y_left_m - region.y_right_m) / cols)  # length over width of a cell
        slopes = torch.cat([torch.full((down.shape[1],), aspect**0.5), torch.full((right.shape[1],), aspect**-0.5)]).to(k.device)
        i, j = edges = torch.cat([down, right], 1)
        a, b = torch.tril_indices(4, 4, device=k.device)  # pairs of the four nodes of a pixel, of which a is not before b
        pairs = ((node[a] - node[b]) * n + node[b]).flatten()  # [10 * h * w]
        return cls(forward_model, edges, SLOPE_M * slopes, torch.cat([i, j, (i - j) * n + j]), pairs, weight[a] * weight[b])

    def unknown(self) -> Heights:
        """Heights of zero without information."""
        return Heights(*self.slopes.new_zeros(4, self.forward_model.rows * self.forward_model.cols))

    def residual(self, luminance: Tensor, seen: Tensor, limit: Tensor) -> Tensor:
        """Residual `[k]` of predicted luminances `[k, h, w]` against a symbol image `[h, w]`, as a share of the predicted lit area."""
        predicted = self._blur(self.forward_model.symbol(luminance, limit), FINE)  # [k, h, w]
        # min(e^2, 0.3^2), [k, h, w].
        error = (self._blur(seen[None], FINE) - predicted).square().clamp(max=0.09) * self.forward_model.inside
        return error.sum((-2, -1)) / (predicted * self.forward_model.inside).sum((-2, -1)).clamp(min=1.0)

    def refine(
        self, nodes: Tensor, known: Heights, seen: Tensor, textures: tuple[Tensor, ...], limit: Tensor, blurs: Sequence[Blur] = BLURS
    ) -> Heights:
        """Gauss-Newton from heights `[n]` m, on a symbol image `[h, w]` and prior heights; returns the information of the image alone.

        blurs: of each step.

        The heights z have the least `sum rho(seen - p(z)) + (z - m)' L (z - m) + sum 4 log(1 + d_ij^2 / (4 s_ij^2)) + |z - b|^2 / h^2` with
        the predicted image p, Tukey's biweight rho, the known mean m and information L, the base b, its usual distance h, and the
        differences d_ij of z - b between neighbours with their usual size s_ij (Cauchy). Heights above a free light path are pulled down.
        """
        forward_model, (i, j) = self.forward_model, self.edges
        lit, dark = (each & (forward_model.inside > 0) for each in (seen > 0.5, seen < 0.2))
        for blur in blurs:
            heights, beside = forward_model.on_pixels(nodes), nodes - known.base
            luminance = forward_model.luminance(textures, torch.stack([heights + PROBE_M, heights - PROBE_M]))
            smooth, higher, lower = self._blur(torch.cat([seen[None], forward_model.symbol(luminance, limit)]), blur)
            slope, error = (higher - lower) / (2 * PROBE_M), smooth - (higher + lower) / 2  # J = dp/dz and e, both [h, w]
            scale = 2 * blur[2] * torch.where(error < 0, HIDDEN, 1.0)  # of Tukey's biweight w = (1 - (e / scale)^2)^2
            weight = (  # W = w / sigma^2 times independent pixels, step / (rows * columns of the blur), [h, w]
                (1 - (error / scale) ** 2).clamp(min=0) ** 2
                * forward_model.inside
                * (forward_model.step / (PIXEL_SIGMA**2 * blur[0] * blur[1]))
            )
            weighted = weight * slope  # W J, [h, w]
            free, above = self._free(heights, lit, dark)  # f and its weight A, [h, w] each
            step = beside[i] - beside[j]  # d_ij, [E_d + E_r]
            stiffness = 1 / (self.slopes**2 + step**2 / 4)  # an edge as soon as it is steep: Cauchy, [E_d + E_r]
            force = (  # J' W e and the pull down to f + L (m - z) + (b - z) / h^2 - D' diag(stiffness) d with d = D (z - b), [n]
                forward_model.on_nodes(weighted * error + above * (free - heights))
                + known.information * (known.mean - nodes)
                - known.shared * (known.shared @ (known.mean - nodes))
                - beside / HEIGHT_M**2
            ).index_add_(0, self.edges.flatten(), torch.cat([-stiffness * step, stiffness * step]))
            matrix = self._normal_matrix(weighted * slope + above)  # J' W J + A + D' diag(stiffness) D + diag(L) + 1 / h^2, a band
            matrix.view(-1).index_add_(0, self.tied, torch.cat([stiffness, stiffness, -stiffness]))
            matrix[0].add_(known.information).add_(1 / HEIGHT_M**2)
            # The step of Gauss-Newton, (matrix - s s')^-1 force (Sherman-Morrison), [n].
            moved, common = solve(matrix, torch.stack([force, known.shared], 1)).unbind(1)
            moved = moved + common * (known.shared @ moved / (1 - known.shared @ common))
            nodes = nodes + moved.clamp(-LARGEST_STEP_M, LARGEST_STEP_M)
        # Information is kept at the nodes alone, so each gets the sum of its row of J' W J.
        return Heights(nodes, forward_model.on_nodes(weighted * slope), known.base, torch.zeros_like(nodes))

    def _blur(self, image: Tensor, blur: Blur) -> Tensor:
        height, width = self.forward_model.shape
        down, across = _gaussian(blur[0], height, image.device), _gaussian(blur[1] / self.forward_model.step, width, image.device)
        return down @ image @ across

    def _normal_matrix(self, weight: Tensor) -> Tensor:
        """`J^T W J` of pixel weights `[h, w]`, as a band matrix `[cols + 2, n]`."""
        n, width = self.forward_model.rows * self.forward_model.cols, self.forward_model.cols + 2
        return weight.new_zeros(width * n).index_add_(0, self.pairs, (self.products * weight.flatten()).flatten()).view(width, n)

    def _free(self, heights: Tensor, lit: Tensor, dark: Tensor) -> tuple[Tensor, Tensor]:
        """Space carving: no height lies above a light path to a lit pixel beyond.

        heights: `[h, w]` m. lit, dark: `[h, w]` bool, pixels with and without light. Returns the upper bound `[h, w]` m of dark pixels'
        heights, and the weight `[h, w]` 1/m^2 of heights above the bound. No bounds with several lamps, since any may light a pixel.
        """
        lamp, middle = self.forward_model.lamps[0], self.forward_model.samples // 2
        on_plane, per_m = (a[:, middle :: self.forward_model.samples] for a in (lamp.on_plane, lamp.per_m))  # [3, h, w] each
        v = (on_plane[2] + per_m[2] * heights) / (on_plane[0] + per_m[0] * heights)  # of the lamp's rays, downwards, [h, w]
        lowest = torch.where(lit, v, -torch.inf).cummax(-2).values  # of all lit pixels farther away, [h, w]
        highest = (lowest * on_plane[0] - on_plane[2]) / (per_m[2] - lowest * per_m[0])  # height of the lowest ray, [h, w] m
        above = (v < lowest) & dark & lowest.isfinite() & (len(self.forward_model.lamps) == 1)
        return torch.where(above, highest, 0.0), above / FREE_M**2 * self.forward_model.step


@lru_cache(maxsize=16)
def _gaussian(sigma: float, size: int, device: torch.device) -> Tensor:
    """Gaussian blur as a matrix `[size, size]`; the kernel ends at 2.5 sigma, and the image is zero beyond its border."""
    from kornia.filters import get_gaussian_kernel1d

    k, reach = torch.arange(size, device=device), math.ceil(2.5 * sigma)
    kernel = get_gaussian_kernel1d(2 * reach + 1, sigma, device=device)[0]
    apart = (k[:, None] - k).abs()
    return torch.where(apart <= reach, kernel[(reach + apart).clamp(max=2 * reach)], 0.0)


CAPS = (0.25, 0.6)  # largest costs of a pixel with missing light, which may be hidden, and with unexpected light
PIXEL = 0.4  # camera pixels whose cost equals one height step between neighbours
STEP, JUMP = 0.3, 3.0  # cost of neighbours that differ by one height step, and by more


def plane_sweep(
    forward_model: ForwardModel, seen: Tensor, textures: tuple[Tensor, ...], limit: Tensor, heights: Tensor, base: Tensor
) -> Tensor:
    """Heights in m at the nodes `[n]`, from candidates `[k]` over the base `[n]`, in even steps about zero.

    seen: symbol image `[h, w]`. limit: threshold `[h, w]` cd/m^2. textures: shown light, `[rows, cols]` cd a module.
    """
    tried = heights[:, None, None] + forward_model.on_pixels(base)
    lack = seen - forward_model.symbol(forward_model.luminance(textures, tried), limit)
    cost = torch.where(lack < 0, (-lack).clamp(max=CAPS[0]), lack.clamp(max=CAPS[1])) * forward_model.inside
    costs = forward_model.on_nodes(cost) * (PIXEL * forward_model.step) + 0.4 * heights.abs()[:, None]
    return base + heights[semi_global(costs.T.unflatten(0, (forward_model.rows, forward_model.cols))).flatten()]


def semi_global(costs: Tensor) -> Tensor:
    """The cheapest label `[rows, cols]` for costs `[rows, cols, labels]`, with neighbours in four directions (Hirschmueller 2008)."""
    total = torch.zeros_like(costs)
    for dim in (0, 1):
        for backwards in (False, True):
            along = costs.transpose(0, dim)
            along = along.flip(0) if backwards else along
            path = [along[0]]
            for cost in along[1:]:
                before = path[-1]
                least = before.amin(-1, keepdim=True)
                beside = torch.minimum(pad(before[:, 1:], (0, 1), value=torch.inf), pad(before[:, :-1], (1, 0), value=torch.inf)) + STEP
                path.append(cost + torch.minimum(torch.minimum(before, beside), least + JUMP) - least)
            paths = torch.stack(path)
            total += (paths.flip(0) if backwards else paths).transpose(0, dim)
    return total.argmin(-1)
