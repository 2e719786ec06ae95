"""Sets of requirements on beams, read from the tables beside this file, and results of a check."""

import math
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from pydantic import Field
from torch import Tensor

from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.params import Params

Point = tuple[float, float]


class Requirement(Params):
    """Limits of the luminous intensity at points `(h, v)` in deg, h to the right, v up."""

    id: str
    kind: Literal["point", "segment", "zone", "sum", "imax", "flux", "unknown"] = Field(
        description="unknown: a requirement exists, but not its numbers, or photometry of a lamp cannot decide it"
    )
    where: tuple[Point, ...] = Field(
        (), description="a point, the ends of a segment, the corners of a zone, points to add up, or two corners of a box"
    )
    min: float | None = Field(None, description="lower limit in cd, or lm for flux; with `of`, as a multiple of its value")
    max: float | None = None
    of: str = Field("", description="id of another requirement, or Imax: limits are relative to its value")
    only_if: str = Field("", description="condition under which the requirement applies, which photometry cannot decide")
    note: str = ""


class Cutoff(Params):
    """Detection, check and aim of a passing beam's cut-off (R149 and FMVSS 108)."""

    scan_h_deg: float = Field(description="vertical line on which the cut-off is sought")
    at_v_deg: float = Field(description="height to which the cut-off is aimed on that line")
    sharpness_min: float = Field(description="least of log10 E(v) - log10 E(v + 0.1 deg) on the scan")
    sharpness_max: float | None = None
    straight_at_h_deg: tuple[float, ...]
    straight_within_deg: float
    shoulder: bool = Field(False, description="also aim horizontally, by the rising part of the cut-off")


class ReAim(Params):
    """Tolerance for re-aiming a lamp from its nominal aim."""

    left: float = 0.0
    right: float = 0.0
    vertical: float = 0.0


class RuleSet(Params):
    """All requirements of one class of beam; values of one lamp."""

    id: str
    also: str = ""
    title: str
    table: str
    beam: Literal["low", "high", "adaptive", "projection"]
    confidence: str
    note: str = ""
    cutoff: tuple[Cutoff, ...] = Field((), description="alternative scans; the sharper cut-off applies")
    re_aim_deg: ReAim = ReAim()
    requirements: tuple[Requirement, ...]


@cache
def sets() -> dict[str, RuleSet]:
    """All sets by their id."""
    tables = [tomllib.loads(path.read_text("utf-8")) for path in sorted(Path(__file__).parent.glob("*.toml"))]
    return {name: RuleSet(id=name, **content) for table in tables for name, content in table.items()}


def beam_rules() -> tuple[str, ...]:
    """Ids of the sets for beams."""
    return tuple(name for name, each in sets().items() if each.beam != "projection")


def rule_set(set_id: str) -> RuleSet:
    """The set of this id, whatever its case. Raises LuxloopError that names those that have the word in them, or the nearest one."""
    wanted = set_id.lower().replace("_", "-").replace(" ", "-")
    known = sets() | {each.also: each for each in sets().values() if each.also}
    if wanted in known:
        return known[wanted]
    alike = sorted(name for name in known if wanted in name) if wanted else []
    hint = f"did you mean {', '.join(alike)}?" if alike else did_you_mean(wanted, sorted(known))
    raise LuxloopError(f"there is no rule {set_id!r}; {hint}")


Intensity = Callable[[Tensor], Tensor]  # directions [3, N] of the lamp frame -> cd [N]
Verdict = Literal["pass", "fail", "not applicable", "unknown"]
Traffic = Literal["left", "right"]
UNITS = {"flux": "lm", "unknown": "", "sharpness": "decades in 0.1 deg", "straightness": "deg"}  # of values by kind of requirement, else cd


@dataclass(frozen=True)
class Result:
    """One requirement's outcome. where: `(h, v)` in deg of the worst point, None for sums and fluxes.

    value, min, max: in `unit`, NaN and None if unknown. margin: what is left to the nearer limit as a share of it, negative where it is
    missed. note: the table's, with the condition if there is one.
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
    def unit(self) -> str:
        return UNITS.get(self.kind, "cd")

    @property
    def limits(self) -> str:
        """The limits in words, such as `5,000 to 37,000`."""
        if self.min is not None and self.max is not None:
            return f"{digits(self.min)} to {digits(self.max)}"
        return f"at least {digits(self.min)}" if self.min is not None else "–" if self.max is None else f"at most {digits(self.max)}"

    def __str__(self) -> str:
        """Requirement, place, value and limits, such as `50V at +0.00, -0.86 deg: 12 cd, at least 5,100 cd`."""
        where = "" if self.where is None else f" at {self.where[0]:+.2f}, {self.where[1]:+.2f} deg"
        return f"{self.id}{where}: {digits(self.value)} {self.unit}, {self.limits} {self.unit}"


def digits(value: float) -> str:
    """A value with four significant digits and all digits before the point, a dash for NaN."""
    return "–" if math.isnan(value) else f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def margin(value: float, least: float | None, most: float | None) -> float:
    """What is left to the nearer limit as a share of it; a limit of zero, relative to darkness, is kept or missed without a measure."""
    low = math.inf if not least else value / least - 1
    high = math.inf if most is None else (1 - value / most if most else -math.inf if value > 0 else 0.0)
    return min(low, high)


def passes(results: Sequence[Result]) -> bool:
    """Whether a requirement passes and none fails."""
    verdicts = {each.verdict for each in results}
    return "pass" in verdicts and "fail" not in verdicts


def least_margin(results: Sequence[Result]) -> float:
    """The margin of the requirement that is nearest to its limit, or farthest beyond it."""
    return min((each.margin for each in results if each.verdict in ("pass", "fail")), default=math.inf)
