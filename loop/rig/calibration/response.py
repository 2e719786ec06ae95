"""From digital numbers to light: the response curve of a camera (Debevec and Malik 1997), its black level and its noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from luxloop.loop.rig.calibration.bench import Array, Image
from luxloop.world.errors import LuxloopError

KNOTS: Final = 32
SAMPLES: Final = 400  # camera pixels
SMOOTH: Final = 10.0  # weight of the curve's second difference beside one reading
USED: Final = (0.02, 0.98)  # of the range of digital numbers


@dataclass(frozen=True, eq=False)
class Response:
    """curve: `[levels + 1]` float32, light at each digital number: 0 at black, 1 at the largest. std: `[levels + 1]`, its uncertainty
    relative to 1, None where it was not measured.
    """

    curve: Array
    std: Array | None = None

    @classmethod
    def linear(cls, levels: int, black: float = 0.0) -> Self:
        """A linear response. levels: largest digital number. black: digital number without light."""
        return cls(((np.arange(levels + 1) - black) / (levels - black)).astype(np.float32))

    def light(self, frames: Image) -> Array:
        """Light of digital numbers, in the same shape."""
        return self.curve[frames]


def response_curve(frames: Sequence[Image], ratios: Sequence[float], levels: int) -> Response:
    """The response from frames `[height, width]` of the same scene at lights that are in known ratios, by exposure time or by utilisation.

    frames[k] has `ratios[k]` times the light of ratio 1, without other light; one of ratio 0, where there is one, gives the black level.
    Raises LuxloopError if the frames do not suffice.
    """
    order = np.argsort(ratios)
    stack, by = np.stack([frames[k] for k in order]).astype(float), np.array([ratios[k] for k in order], float)
    black = float(np.median(stack[by == 0])) if (by == 0).any() else 0.0
    stack, by = stack[by > 0], by[by > 0]
    low, high = black + USED[0] * (levels - black), USED[1] * levels
    flat = stack.reshape(len(by), -1)
    good = (flat > low) & (flat < high)
    useful = np.flatnonzero(good.sum(0) >= 2)
    if len(by) < 3 or len(useful) < KNOTS:
        raise LuxloopError("the series says too little of the response; take at least three exposures, from dark to nearly saturated")
    by_brightness = useful[np.argsort(flat[:, useful].mean(0))]
    chosen = by_brightness[np.linspace(0, len(by_brightness) - 1, min(SAMPLES, len(by_brightness))).astype(int)]
    knots = np.linspace(np.log(low - black), np.log(high - black), KNOTS)
    log_light, covariance = _solved(np.log((flat[:, chosen] - black).clip(min=1e-3)), good[:, chosen], np.log(by), knots)
    numbers = np.arange(levels + 1.0)
    step = np.maximum(numbers - black, 1e-3)
    at = np.log(step)
    slopes = [(log_light[k + 1] - log_light[k]) / (knots[k + 1] - knots[k]) for k in (0, -2)]
    beyond = np.minimum(at - knots[0], 0) * slopes[0] + np.maximum(at - knots[-1], 0) * slopes[1]
    curve = np.maximum.accumulate(np.exp(np.interp(at, knots, log_light) + beyond))
    first = int(np.floor(black)) + 1
    dark = numbers < first
    curve[dark] = (numbers[dark] - black) * curve[first] / (first - black)  # noise about black keeps its sign
    std = np.interp(at, knots, np.sqrt(np.maximum(np.diag(covariance), 0))) * curve.clip(min=0)
    return Response((curve / curve[-1]).astype(np.float32), (std / curve[-1]).astype(np.float32))


def _solved(codes: Array, good: np.ndarray, log_by: Array, knots: Array) -> tuple[Array, Array]:
    """Logarithm of the light at knots `[n]` with its covariance: `g(z) = ln L_i + ln t_k` by least squares.

    codes: logarithms of digital numbers over black, in which any power is a straight line, and g is one between knots.
    """
    k, i = np.nonzero(good)
    z = codes[k, i]
    left = ((z - knots[0]) / (knots[1] - knots[0])).astype(int).clip(0, len(knots) - 2)
    share = (z - knots[left]) / (knots[1] - knots[0])
    n, rows = len(knots), np.arange(len(z))
    weight = np.exp(0.5 * (z - knots[-1]))  # as the noise of light has it
    design = np.zeros((len(z) + n - 1, n + codes.shape[1]))
    design[rows, left], design[rows, left + 1] = weight * (1 - share), weight * share
    design[rows, n + i] = -weight
    right = np.concatenate([weight * log_by[k], np.zeros(n - 1)])
    for offset, factor in enumerate((1.0, -2.0, 1.0)):
        design[len(z) + np.arange(n - 2), np.arange(n - 2) + offset] = SMOOTH * factor
    design[-1, n - 1] = 1e3
    solved, *_ = np.linalg.lstsq(design, right, rcond=None)
    left_over = design[: len(z)] @ solved - right[: len(z)]
    variance = float(left_over @ left_over) / max(len(z) - len(solved), 1)
    return solved[:n], variance * np.linalg.pinv(design.T @ design)[:n, :n]
