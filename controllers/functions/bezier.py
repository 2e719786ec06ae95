"""Bezier curves of any degree: points, arc length, and the closest point by Halley's steps (T B.2)."""

from math import comb

import numpy as np
import torch
from torch import Tensor

HALLEY_STEPS = 6  # from the best sample, Halley's cubic convergence needs three or four
SAMPLES_PER_DEGREE = (
    64  # so dense because a curve turns fast near a cusp, where the closest point may lie between two samples that are not the closest
)
INTERVALS, NODES = 32, 8  # of the arc length's quadrature: error about 1e-9 of the length for curves without a cusp


def point(control: Tensor, t: Tensor) -> Tensor:
    """Curve points `[..., N, D]` at parameters `[..., N]` in 0..1 (T eq. B.2.1). control: control points `[..., n + 1, D]`, in any unit."""
    n = control.shape[-2] - 1
    power = torch.arange(n + 1, device=control.device)
    binomial = torch.tensor([comb(n, i) for i in range(n + 1)]).to(control)
    return (binomial * (1 - t[..., None]) ** (n - power) * t[..., None] ** power) @ control


def derivative(control: Tensor) -> Tensor:
    """Control points `[..., max(n, 1), D]` of the curve's derivative, itself a Bezier curve."""
    n = control.shape[-2] - 1
    return n * control.diff(dim=-2) if n else torch.zeros_like(control)


def length_at(control: Tensor, t: Tensor) -> Tensor:
    """Arc length `[..., N]` from the start to the parameters `[..., N]` in 0..1, by Gauss-Legendre quadrature piece by piece."""
    knots = torch.linspace(0, 1, INTERVALS + 1).to(control)
    piece = (t.detach() * INTERVALS).long().clamp(0, INTERVALS - 1)
    whole = _arc(control, knots[:-1], knots[1:]).cumsum(-1)
    before = torch.nn.functional.pad(whole, (1, 0)).expand(*t.shape[:-1], -1).gather(-1, piece)
    return before + _arc(control, knots[piece], t)


def closest(control: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """Parameter and distance, both `[..., N]`, of the curve's point that is closest to each of `points` `[..., N, D]` (T eq. B.2.3, B.2.4).

    Halley's steps start at the best of several samples, both ends included, and stay between its neighbours, since free steps may run to a
    maximum. The better of result and sample is returned.
    """
    n = control.shape[-2] - 1
    samples = torch.linspace(0, 1, SAMPLES_PER_DEGREE * max(n, 1) + 1).to(control)
    t = samples[torch.cdist(points, point(control, samples)).argmin(-1)]
    step = 1 / (len(samples) - 1)
    low, high = (t - step).clamp(min=0), (t + step).clamp(max=1)
    curves = [control]
    for _ in range(3):
        curves.append(derivative(curves[-1]))
    best, nearest = t, _squared(control, t, points)
    for _ in range(HALLEY_STEPS):
        b, b1, b2, b3 = (point(curve, t) for curve in curves)
        away = b - points
        f1 = (away * b1).sum(-1)
        f2 = (b1 * b1 + away * b2).sum(-1)
        f3 = (3 * b1 * b2 + away * b3).sum(-1)
        slope = 2 * f2 * f2 - f1 * f3  # T eq. B.2.4; f1, f2, f3 are half the derivatives of T eq. B.2.3, [..., N]
        t = (t - torch.where(slope == 0, 0.0, 2 * f1 * f2 / torch.where(slope == 0, 1.0, slope))).clamp(low, high)
        squared = _squared(control, t, points)
        closer = squared < nearest
        best, nearest = torch.where(closer, t, best), torch.where(closer, squared, nearest)
    return best, nearest.sqrt()


def _squared(control: Tensor, t: Tensor, points: Tensor) -> Tensor:
    return (point(control, t) - points).square().sum(-1)


def _arc(control: Tensor, start: Tensor, stop: Tensor) -> Tensor:
    """Length `[..., N]` of the curve from parameters `[..., N]` to others."""
    nodes, weights = (torch.from_numpy(each).to(control) for each in np.polynomial.legendre.leggauss(NODES))
    half = ((stop - start) / 2)[..., None]
    t = start[..., None] + half * (nodes + 1)
    speed = point(derivative(control), t.flatten(-2)).norm(dim=-1).unflatten(-1, t.shape[-2:])
    return (speed * weights * half).sum(-1)
