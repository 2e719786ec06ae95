"""The least mean absolute error that all pixels together can reach (T 8.3, 8.4), with a proof of how much is missing to it.

`min sum_i w_i |(A u)_i - s_i|, 0 <= u <= 1` by over-relaxed primal-dual steps (Chambolle and Pock 2011; Condat 2013), whose widths are the
sums of columns and rows (Pock and Chambolle 2011). The dual value is a lower bound of the error.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from controllers.jpo_part import Wanted, anywhere, reached_rows, submatrix, without_fixed
from world.spmv import Csr, multiply

OVER = 1.9  # relaxation: below 2 steps converge, and nearly twice as fast as at 1
PRIMAL_WEIGHT = 0.3  # of the mean utilisation, as measured in docs/jpo.md: how far pixels move a step, against the dual
NEAR = 0.1  # of the largest setpoint: texels this close to theirs are undecided between too dark and too bright
CHECKED_EVERY = 20  # steps between looks at the gap, each of which waits for the device


@dataclass(frozen=True)
class LeastError:
    """u: `[..., n_p]`. dual: `[..., n_t]`, what the sum would lose a cd of setpoint, to start a similar problem from. error: `[...]` cd,
    the weighted sum of absolute deviations at u. bound: `[...]` cd, no utilisation has less. iterations: that were made; entries: of the
    headlight matrix that each of them read, twice.
    """

    u: Tensor
    dual: Tensor
    error: Tensor
    bound: Tensor
    iterations: int
    entries: int


def least_error(
    matrix: Csr, goal: Wanted, *, dual: Tensor | None = None, iterations: int = 20_000, gap: float | None = 0.005
) -> LeastError:
    """The utilisation with the least weighted sum of absolute deviations; never worse than its start.

    matrix: `[n_t, n_p]` cd, not negative. dual: `[..., n_t]` of a similar problem. gap: stop where the error is proved to be at most this
    share above the least; None makes all iterations and does not ask the device. Batch entries share the texels and pixels that are left.

    Left are the texels with a positive setpoint, since the error of all others is linear in u, and the pixels that make good there more
    than they cost elsewhere: all others are off in an optimum, since no light of theirs lowers the sum.
    """
    transposed = matrix.transposed
    target, weight = without_fixed(matrix, goal), goal.weight
    short = (target > 0) & (weight > 0)
    gain, cost = (multiply(transposed, torch.where(mask, weight, 0.0)) for mask in (short, ~short))
    useful = goal.free & (gain > cost)
    cols = anywhere(useful).nonzero()[:, 0]
    rows = (anywhere(short) & reached_rows(transposed, cols)).nonzero()[:, 0]
    A, At = submatrix(matrix, rows, cols), submatrix(transposed, cols, rows)

    s, w = target[..., rows], torch.where(short, weight, 0.0)[..., rows]
    c, gain, upper = cost[..., cols], gain[..., cols], useful[..., cols].to(s)
    constant = (weight * target.abs()).sum(-1) - (w * s).sum(-1)  # of texels that no pixel here lights, or only too bright
    reach = multiply(A, torch.ones_like(c[(0,) * (c.ndim - 1)]))

    def error_of(light: Tensor, u: Tensor) -> Tensor:
        return (c * u).sum(-1) + (w * (light - s).abs()).sum(-1) + constant

    u = goal.start[..., cols] * upper
    best, light = u, multiply(A, u)
    least, bound = error_of(light, u), constant.clone()
    near = NEAR * s.amax(-1, keepdim=True) if len(rows) else s
    y = (w * (light - s) / near).clamp(-w, w) if dual is None else dual[..., rows].clamp(-w, w)
    typical = (multiply(At, w * (s / reach).clamp(max=1)) / gain).clamp(0, 1)  # as SSC would have it
    pace = PRIMAL_WEIGHT * (typical * upper).sum(-1, keepdim=True) / upper.sum(-1, keepdim=True).clamp(min=1)
    tau, sigma = pace / gain, w / (pace * reach)
    tau, sigma = torch.where(upper > 0, tau, 0.0), torch.where(w > 0, sigma, 0.0)

    done = 0
    while done < iterations and len(cols):
        steps = min(CHECKED_EVERY, iterations - done) if gap is not None else iterations
        for _ in range(steps):
            following = (u - tau * (c + multiply(At, y))).clamp(min=0).minimum(upper)
            answer = (y + sigma * (multiply(A, 2 * following - u) - s)).clamp(-w, w)
            u, y = u + OVER * (following - u), y + OVER * (answer - y)
        done += steps
        error = error_of(multiply(A, following), following)
        best = torch.where((error < least)[..., None], following, best)
        least = torch.minimum(error, least)
        proved = constant - (s * answer).sum(-1) + ((c + multiply(At, answer)).clamp(max=0) * upper).sum(-1)
        bound = torch.maximum(bound, proved)
        if gap is not None and bool((least - bound <= gap * least).all()):
            break

    full = torch.where(goal.free, 0.0, goal.start)
    full[..., cols] += best
    everywhere = torch.zeros_like(target)
    everywhere[..., rows] = y.clamp(-w, w)
    return LeastError(full, everywhere, least, bound if len(cols) else least, done, len(A.values))
