"""Reduction of a joint optimisation to the free pixels and the texels that these pixels light.

Luminous intensities are not negative. So the error of a texel with setpoint zero is linear in every utilisation, and the light of fixed
pixels is subtracted from setpoints. A pixel that lights no texel with a positive setpoint can only increase the error and is off in every
optimum. For a symbol a few hundred of 16 k pixels remain.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr, entries_in, multiply, row_of_entries

HARD = 1_000.0  # limit of weights of positive setpoints, even infinite ones: a lamp can be forced to be dark, but not to give light


@dataclass(frozen=True)
class PixelGoal:
    """Setpoints of all texels, and the pixels that may change to reach them.

    target: `[..., n_t]` cd. weight: `[..., n_t]`, finite and not negative. start: `[..., n_p]` in 0..1. free: `[..., n_p]` bool; all other
    pixels keep their start.
    """

    target: Tensor
    weight: Tensor
    start: Tensor
    free: Tensor


def pixel_goal(
    headlight: Headlight, texture: Tensor, weight: Tensor | None = None, start: Tensor | None = None, free: Tensor | None = None
) -> PixelGoal:
    """The optimisation problem of a wanted light texture `[..., rows, cols]` in cd.

    weight: `[..., rows, cols]`, 0 to infinity, by default 1, limited to HARD. start: `[..., n_p]`, by default that of SSC with a_m = a_r =
    1. free: `[..., n_p]` bool, by default all. Pixels that reach a dark texel of infinite weight are off and not free. Raises LuxloopError
    for a texture, weight or start of another size than the headlight's.
    """
    size = (headlight.rows, headlight.cols)
    for name, given in (("wanted light texture", texture), ("weight of a wanted light texture", weight)):
        if given is not None and tuple(given.shape[-2:]) != size:
            raise LuxloopError(f"the {name} is of shape {list(given.shape)}; {headlight.name!r} needs {size[0]} rows by {size[1]} columns")
    if start is not None and start.shape[-1] != headlight.n_pixels:
        raise LuxloopError(
            f"the start has {start.shape[-1]} pixels and {headlight.name!r} has {headlight.n_pixels}: give one utilisation each"
        )
    transposed = headlight.matrix.transpose
    target = texture.flatten(-2)
    weight = torch.ones_like(target) if weight is None else weight.flatten(-2).to(target).expand_as(target)
    masked = reaching(transposed, weight.isinf() & (target <= 0))
    weight = weight.clamp(max=HARD)
    if start is None:
        reach = multiply(headlight.matrix, target.new_ones(headlight.n_pixels))
        share = torch.where(reach > 0, (target / reach).clamp(0, 1), 0.0)
        start = multiply(transposed, weight * share) / multiply(transposed, weight).clamp(min=torch.finfo(target.dtype).tiny)
    start = start.to(target).expand_as(masked).masked_fill(masked, 0.0)
    return PixelGoal(target, weight, start, ~masked if free is None else free & ~masked)


def reaching(transposed: Csr, texels: Tensor) -> Tensor:
    """Pixels `[..., n_p]` bool that light any of the texels `[..., n_t]` bool. transposed: the pixel-major matrix."""
    return multiply(transposed, texels.to(transposed.values)) > 0


def every_nth_column(matrix: Csr, n: int) -> list[Csr]:
    """`A[:, k::n]` for all k from 0 to n - 1 that have columns."""
    rows, count = matrix.n_rows, min(n, matrix.n_cols)
    first = matrix.indices % n
    order = first.argsort(stable=True)
    lengths = torch.bincount(first * rows + row_of_entries(matrix), minlength=n * rows).view(n, rows)[:count]
    ends = torch.nn.functional.pad(lengths.cumsum(1), (1, 0)).int()
    entries = order.split(lengths.sum(1).tolist())
    return [Csr(ends[k], matrix.indices[own] // n, matrix.values[own], len(range(k, matrix.n_cols, n))) for k, own in enumerate(entries)]


def anywhere(mask: Tensor) -> Tensor:
    """Whether the mask `[..., n]` is true in any batch entry, `[n]`."""
    return mask.reshape(-1, mask.shape[-1]).any(0)


def reached_rows(transposed: Csr, cols: Tensor) -> Tensor:
    """Texels `[n_t]` bool that pixels `[m]` light. transposed: the pixel-major matrix."""
    lit = torch.zeros(transposed.n_cols, dtype=torch.bool, device=cols.device)
    lit[transposed.indices[entries_in(transposed, cols)[1]].long()] = True
    return lit


def residual_target(matrix: Csr, goal: PixelGoal) -> Tensor:
    """Setpoints of the free pixels `[..., n_t]` in cd: the target less the light of all other pixels."""
    fixed = torch.where(goal.free, 0.0, goal.start)
    return goal.target - multiply(matrix, fixed) if bool(fixed.any()) else goal.target
