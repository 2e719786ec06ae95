"""Utilisations that come closest to wanted light: weighted least squares within bounds, `min ||W (A u - i)||^2`, `0 <= u <= upper`."""

import torch
from torch import Tensor

from luxloop.world.spmv import Csr, multiply

CHECKED_EVERY = 10  # iterations between checks of the progress, each of which waits for the device


def solve(
    matrix: Csr,
    wanted: Tensor | tuple[Tensor, Tensor],
    *,
    weight: Tensor | None = None,
    upper: Tensor | None = None,
    start: Tensor | None = None,
    iterations: int = 300,
    tolerance: float = 1e-4,
) -> Tensor:
    """u `[..., n]` in `0..upper` with the least `sum (weight * distance of A u from low..high)^2` (T 3.5.2, eq. B.1.1).

    matrix: A `[m, n]`, several modules side by side. wanted: `[..., m]`, or bounds low and high between which the error is zero, infinite
    without a bound. weight: `[m]` or `[..., m]`, 1 by default. upper: `[n]` or `[..., n]`, 1 by default. start: `[..., n]`, warm start; a
    pixel that reaches no row keeps it. Stops when ten steps in a row move no pixel by more than the tolerance. Accelerated projected
    gradient with restarts, all batch entries at once.
    """
    low, high = wanted if isinstance(wanted, tuple) else (wanted, wanted)
    squared = torch.ones_like(low) if weight is None else weight.to(low).square().expand(low.shape)
    upper = low.new_ones(matrix.n_cols) if upper is None else upper.to(low)
    u = low.new_zeros(*low.shape[:-1], matrix.n_cols) if start is None else start.to(low).expand(*low.shape[:-1], -1).clone()
    transposed = matrix.transposed
    # |A|' W^2 |A| 1 on the diagonal dominates A' W^2 A: a step of each pixel's own length that never overshoots, without its norm.
    size = matrix.with_values(matrix.values.abs())
    curvature = multiply(size.transposed, squared * multiply(size, torch.ones_like(u)))
    step = torch.where(curvature > 0, 1 / curvature, 0.0)

    ahead, momentum = u, u.new_ones(*u.shape[:-1], 1)
    moved = torch.zeros_like(step)
    for iteration in range(1, iterations + 1):
        light = multiply(matrix, ahead)
        residual = squared * (light - light.clamp(low, high))
        following = (ahead - step * multiply(transposed, residual)).clamp(min=0).minimum(upper)
        uphill = ((ahead - following) * (following - u) * curvature).sum(-1, keepdim=True) > 0
        momentum = torch.where(uphill, 1.0, momentum)
        next_momentum = (1 + (1 + 4 * momentum.square()).sqrt()) / 2
        ahead = following + torch.where(uphill, 0.0, (momentum - 1) / next_momentum) * (following - u)
        moved = torch.maximum(moved, (following - u).abs())
        u, momentum = following, next_momentum
        if iteration % CHECKED_EVERY == 0:
            if bool((moved <= tolerance).all()):
                break
            moved = torch.zeros_like(moved)
    return u
