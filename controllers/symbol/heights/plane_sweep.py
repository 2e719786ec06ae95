"""Heights from one observation by a plane sweep, as in stereo vision: every height is tried everywhere, neighbours settle what is
ambiguous.
"""

import torch
from torch import Tensor
from torch.nn.functional import pad

from luxloop.controllers.symbol.heights.forward_model import ForwardModel

CAPS = (0.25, 0.6)  # a pixel costs no more than this where light is missing, which may be hidden, and where it comes from nowhere
PIXEL = 0.4  # of the camera, cost as much as one height step between neighbours
STEP, JUMP = 0.3, 3.0  # cost of neighbours that differ by one height step, and by more


def plane_sweep(
    forward_model: ForwardModel, seen: Tensor, textures: tuple[Tensor, ...], limit: Tensor, heights: Tensor, base: Tensor
) -> Tensor:
    """Heights in m at the nodes `[n]`, out of `[k]` over the base `[n]` that are tried, in even steps about zero.

    seen: symbol image `[h, w]`. limit: threshold `[h, w]` cd/m^2. textures: light that was shown, `[rows, cols]` cd a module.
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
