"""Least squares over all pixels together (T 3.5.2): within bounds, or by the pseudo-inverse for lamps with few pixels."""

from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.controllers.jpo.part import PixelGoal, anywhere, reached_rows, submatrix, without_fixed
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr, multiply, solve

FEW_PIXELS = 2_000  # most pixels whose pseudo-inverse takes seconds


def least_squares(matrix: Csr, goal: PixelGoal, iterations: int = 300, tolerance: float = 1e-4) -> Tensor:
    """u `[..., n_p]` with the least `sum weight * (A u - target)^2`, from its start (T 3.5.2, eq. B.1.1).

    matrix: `[n_t, n_p]` cd, not negative. Weights count as in the reduction (T eq. 7.4.5), not squared. A pixel that reaches no texel with
    a positive remaining setpoint is off, since it could only increase the error. Stops when ten steps in a row move no pixel by more than
    the tolerance.
    """
    transposed = matrix.transpose
    target = without_fixed(matrix, goal)
    short = torch.where((target > 0) & (goal.weight > 0), 1.0, 0.0).to(target)
    useful = goal.free & (multiply(transposed, short) > 0)
    cols = anywhere(useful).nonzero()[:, 0]
    rows = reached_rows(transposed, cols).nonzero()[:, 0]
    u = torch.where(goal.free, 0.0, goal.start)
    if len(cols):
        A = submatrix(matrix, rows, cols)
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
