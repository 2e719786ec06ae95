"""Results of a check."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from torch import Tensor

from luxloop.world.regulation.tables import Point

Intensity = Callable[[Tensor], Tensor]  # directions [3, N] of the lamp frame -> cd [N]
Verdict = Literal["pass", "fail", "not applicable"]
Traffic = Literal["left", "right"]


@dataclass(frozen=True)
class Result:
    """One requirement's outcome. where: `(h, v)` in deg of the worst point, None for sums and fluxes.

    value, min, max: cd; lm for kind `flux`, decades in 0.1 deg for `sharpness`, deg for `straightness`. margin: what is left to the
    nearer limit as a share of it, negative where it is missed. note: the table's, with the condition if there is one.
    """

    id: str
    kind: str
    where: Point | None
    value: float
    min: float | None
    max: float | None
    verdict: Verdict
    confidence: str
    note: str = ""

    @property
    def margin(self) -> float:
        return margin(self.value, self.min, self.max)

    @property
    def limits(self) -> str:
        """The limits in words, such as `5000 to 37000`."""
        if self.min is not None and self.max is not None:
            return f"{self.min:.5g} to {self.max:.5g}"
        return f"at least {self.min:.5g}" if self.min is not None else f"at most {self.max:.5g}"


def margin(value: float, least: float | None, most: float | None) -> float:
    """What is left to the nearer limit as a share of it; a limit of zero, relative to darkness, is kept or missed without a measure."""
    low = math.inf if not least else value / least - 1
    high = math.inf if most is None else (1 - value / most if most else -math.inf if value > 0 else 0.0)
    return min(low, high)


def passes(results: Sequence[Result]) -> bool:
    return not any(each.verdict == "fail" for each in results)


def least_margin(results: Sequence[Result]) -> float:
    """The margin of the requirement that is nearest to its limit, or farthest beyond it."""
    return min((each.margin for each in results if each.verdict != "not applicable"), default=math.inf)
