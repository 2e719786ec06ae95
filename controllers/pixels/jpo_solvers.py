"""The utilisations of all pixels with the least absolute or squared error (T 8.3, 8.4); of the former with a proven bound of the gap.

`min sum_i w_i |(A u)_i - s_i|, 0 <= u <= 1` by primal-dual steps (Chambolle and Pock 2011) on subsets of the texels in turn (Chambolle,
Ehrhardt, Richtárik and Schönlieb 2018), with step widths from the sums of columns and rows (Pock and Chambolle 2011). All pixels move after
each subset, so one product with the whole matrix and its transpose yields SUBSETS steps. The dual value is a lower bound of the error.

Both problems are first reduced to the free pixels and the texels that these light. Luminous intensities are not negative: the error of a
texel with setpoint zero is linear in every utilisation, and the light of fixed pixels is subtracted from setpoints. A pixel that lights no
texel with a positive setpoint can only increase the error and is off in every optimum. For a symbol a few hundred of 16 k pixels remain.
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr, entries_in, multiply, row_of_entries, solve

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


SUBSETS = 8  # of the texels, each spread over the whole texture; more help little, and the calls slow down small lamps
PRIMAL_WEIGHT = 0.2  # size of primal against dual steps, in mean utilisations; measured in docs/jpo.md
NEAR = 0.1  # share of the mean setpoint: texels within it are neither clearly too dark nor too bright
CHECKED_EVERY = 20  # iterations between checks of the gap, each of which synchronises the device


@dataclass(frozen=True)
class LeastError:
    """Result. u: `[..., n_p]`. error: `[...]` cd, weighted sum of absolute deviations at u. bound: `[...]` cd, lower bound of the error for
    any utilisation. iterations: number of iterations. entries: number of matrix entries that each iteration reads twice.
    """

    u: Tensor
    error: Tensor
    bound: Tensor
    iterations: int
    entries: int


def least_error(matrix: Csr, goal: PixelGoal, iterations: int = 20_000, gap: float | None = 0.005) -> LeastError:
    """The utilisation with the least weighted sum of absolute deviations (T eq. 8.3.1); never worse than its start.

    matrix: `[n_t, n_p]` cd, not negative. iterations: most iterations. gap: stop when the error is proven to be within this share of the
    least one; None makes all iterations and checks only at the end.
    """
    left = _reduce_problem(matrix, goal)
    u = goal.start[..., left.cols] * left.upper
    best, light = u, multiply(left.A, u)
    least, bound = left.error(light, u), left.constant
    full = torch.where(goal.free, 0.0, goal.start)
    if not len(left.cols):
        return LeastError(full, least, least, 0, 0)
    tau, sigma = left.steps()
    answers, widths, s, w = (list(each.split(left.sizes, -1)) for each in (left.pull(light), sigma, left.s, left.w))
    done = 0
    while done < iterations:
        slope = ahead = left.slope(torch.cat(answers, -1))  # c + A'y, [..., n]; computed again here, since updates accumulate rounding
        steps = iterations if gap is None else min(CHECKED_EVERY, iterations - done)
        for k in [*range(len(answers))] * steps:
            u = (u - tau * ahead).clamp(min=0).minimum(left.upper)  # primal step: u <- proj(u - tau (c + A'y_ahead)), [..., n]
            answer = (answers[k] + widths[k] * (multiply(left.rows[k], u) - s[k])).clamp(-w[k], w[k])
            change = multiply(left.columns[k], answer - answers[k])  # A_k' (y_k,new - y_k), [..., n]
            answers[k], slope = answer, slope + change
            ahead = slope + len(answers) * change  # extrapolated dual of the next step (Chambolle et al. 2018)
        done += steps
        error = left.error(multiply(left.A, u), u)
        best = torch.where((error < least)[..., None], u, best)
        least, bound = torch.minimum(error, least), torch.maximum(bound, left.bound(torch.cat(answers, -1)))
        if gap is not None and bool((least - bound <= gap * least).all()):
            break
    full[..., left.cols] += best
    return LeastError(full, least, bound, done, len(left.A.values))


@dataclass(frozen=True)
class _Problem:
    """`min c'u + sum_i w_i |(A u)_i - s_i| + constant, 0 <= u <= upper`, on some rows, and the columns `cols`, of a headlight matrix.

    rows: A in subsets of `sizes` rows, each spread over the whole texture. columns: their transposes. s, w: `[..., m]`. c, gain, upper:
    `[..., n]`; gain is `A'w`. Where a batch entry does not need a row or column, its w or upper is zero.
    """

    cols: Tensor
    A: Csr
    sizes: list[int]
    rows: list[Csr]
    columns: list[Csr]
    s: Tensor
    w: Tensor
    c: Tensor
    gain: Tensor
    upper: Tensor
    constant: Tensor

    def error(self, light: Tensor, u: Tensor) -> Tensor:
        return (self.c * u).sum(-1) + (self.w * (light - self.s).abs()).sum(-1) + self.constant

    def bound(self, y: Tensor) -> Tensor:
        """The dual value `constant - s'y + sum_j min(c + A'y, 0)_j upper_j`, `[...]` cd: for any y in -w..w, no u has a smaller error."""
        return self.constant - (self.s * y).sum(-1) + (self.slope(y).clamp(max=0) * self.upper).sum(-1)

    def slope(self, y: Tensor) -> Tensor:
        """Slope of the error over u at dual y: `c + A'y`, `[..., n]`."""
        return self.c + torch.stack(self.pulls(y)).sum(0)

    def pulls(self, y: Tensor) -> list[Tensor]:
        """`A_k'y_k` of each subset, `[..., n]`."""
        return [multiply(columns, each) for columns, each in zip(self.columns, y.split(self.sizes, -1), strict=True)]

    def pull(self, light: Tensor) -> Tensor:
        """Initial dual `[..., m]`: -w or w at texels that are clearly too dark or too bright, in between where undecided."""
        counts = self.w > 0
        near = NEAR * torch.where(counts, self.s, 0.0).sum(-1, keepdim=True) / counts.sum(-1, keepdim=True).clamp(min=1)
        return (self.w * (light - self.s) / near.clamp(min=torch.finfo(self.s.dtype).tiny)).clamp(-self.w, self.w)

    def steps(self) -> tuple[Tensor, Tensor]:
        """Step widths tau `[..., n]` and sigma `[..., m]`, in units of u and w; convergent for any PRIMAL_WEIGHT (Pock, Chambolle 2011)."""
        reach = multiply(self.A, torch.ones_like(self.c[(0,) * (self.c.ndim - 1)]))
        ssc = torch.where(self.upper > 0, 1 / self.gain, 0.0) * torch.stack(self.pulls(self.w * (self.s / reach).clamp(max=1))).sum(0)
        pace = PRIMAL_WEIGHT * ssc.sum(-1, keepdim=True) / self.upper.sum(-1, keepdim=True).clamp(min=1)
        of_subset = torch.stack(self.pulls(self.w)).amax(0)
        width = torch.where(self.upper > 0, 1 / (len(self.columns) * of_subset), 0.0)
        return pace * width, torch.where(self.w > 0, self.w / (pace * reach), 0.0)


def _reduce_problem(matrix: Csr, goal: PixelGoal) -> _Problem:
    """Reduce the problem to the pixels that can be on in an optimum, and the texels that they light.

    The error of a texel without a positive setpoint is linear in u. A pixel whose light costs more at these texels than it can gain at the
    other texels is off in every optimum.
    """
    transposed = matrix.transpose
    target = residual_target(matrix, goal)
    short = (target > 0) & (goal.weight > 0)
    gain, cost = (multiply(transposed, torch.where(mask, goal.weight, 0.0)) for mask in (short, ~short))
    useful = goal.free & (gain > cost)
    cols = anywhere(useful).nonzero()[:, 0]
    rows = (anywhere(short) & reached_rows(transposed, cols)).nonzero()[:, 0]
    columns = every_nth_column(transposed.part(cols, rows), SUBSETS)
    sizes = [piece.n_cols for piece in columns]
    rows = torch.cat([rows[k::SUBSETS] for k in range(SUBSETS)])
    A, stops = matrix.part(rows, cols), [sum(sizes[:k]) for k in range(len(sizes) + 1)]
    s, w = target[..., rows], torch.where(short, goal.weight, 0.0)[..., rows]
    return _Problem(
        cols,
        A,
        sizes,
        [A.band(start, stop) for start, stop in pairwise(stops)],
        columns,
        s,
        w,
        cost[..., cols],
        gain[..., cols],
        useful[..., cols].to(s),
        (goal.weight * target.abs()).sum(-1) - (w * s).sum(-1),
    )


FEW_PIXELS = 2_000  # most pixels whose pseudo-inverse takes seconds


def least_squares(matrix: Csr, goal: PixelGoal, iterations: int = 300, tolerance: float = 1e-4) -> Tensor:
    """u `[..., n_p]` with the least `sum weight * (A u - target)^2`, from its start (T 3.5.2, eq. B.1.1).

    matrix: `[n_t, n_p]` cd, not negative. Weights count as in the reduction (T eq. 7.4.5), not squared. A pixel that reaches no texel with
    a positive remaining setpoint is off, since it could only increase the error. Stops when ten steps in a row move no pixel by more than
    the tolerance.
    """
    transposed = matrix.transpose
    target = residual_target(matrix, goal)
    short = torch.where((target > 0) & (goal.weight > 0), 1.0, 0.0).to(target)
    useful = goal.free & (multiply(transposed, short) > 0)
    cols = anywhere(useful).nonzero()[:, 0]
    rows = reached_rows(transposed, cols).nonzero()[:, 0]
    u = torch.where(goal.free, 0.0, goal.start)
    if len(cols):
        A = matrix.part(rows, cols)
        start, upper = goal.start[..., cols], useful[..., cols].to(target)
        weight = goal.weight[..., rows].sqrt()
        u[..., cols] += solve(
            A, target[..., rows], weight=weight, upper=upper, start=start * upper, iterations=iterations, tolerance=tolerance
        )
    return u


@dataclass(frozen=True)
class MoorePenrose:
    """Least squares by the pseudo-inverse (T eq. 3.5.2, B.1.4), `A^+ = (A' A)^+ A'`, clamped to 0..1.

    Clamping makes it worse than `least_squares` wherever the unbounded solution leaves 0..1. transposed: A'. inverse: `(A' A)^+`, `[n_p,
    n_p]` float64.
    """

    transposed: Csr
    inverse: Tensor

    @classmethod
    def prepare(cls, headlight: Headlight) -> "MoorePenrose":
        """Compute the inverse once. Raises LuxloopError for lamps with more than 2,000 pixels."""
        if headlight.n_pixels > FEW_PIXELS:
            raise LuxloopError(
                f"the pseudo-inverse of {headlight.name!r} would be a full matrix for {headlight.n_pixels} pixels; it is for lamps of at "
                f"most {FEW_PIXELS}: use least squares"
            )
        A = headlight.matrix.to_scipy().astype("float64")
        gram = torch.from_numpy((A.T @ A).toarray()).to(headlight.matrix.values.device)
        return cls(headlight.matrix.transpose.to(torch.float64), torch.linalg.pinv(gram, hermitian=True))

    def utilisation(self, texture: Tensor) -> Tensor:
        """Utilisation `[..., n_p]` in 0..1 for a wanted light texture `[..., rows, cols]` in cd."""
        return (multiply(self.transposed, texture.flatten(-2).double()) @ self.inverse).clamp(0, 1).to(texture)  # u = (A' A)^+ A' i
