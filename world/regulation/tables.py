"""The limits themselves: sets of requirements on a beam, read from the tables beside this file."""

import tomllib
from functools import cache
from pathlib import Path
from typing import Literal

from pydantic import Field

from world.errors import LuxloopError, did_you_mean
from world.params import Params

Point = tuple[float, float]


class Requirement(Params):
    """Limits of the luminous intensity at points `(h, v)` in deg, h to the right, v up."""

    id: str
    kind: Literal["point", "segment", "zone", "sum", "imax", "flux"]
    where: tuple[Point, ...] = Field((), description="a point, a segment's ends, a zone's corners, points to add up, a box's two corners")
    min: float | None = Field(None, description="cd, or lm for flux; a multiple of the value of `of` where that is given")
    max: float | None = None
    of: str = Field("", description="id of another requirement, or Imax: limits are relative to its value")
    only_if: str = Field("", description="the requirement counts under this condition only, which photometry cannot tell")
    note: str = ""


class Cutoff(Params):
    """How a passing beam's cut-off is found, judged and aimed (R149 and FMVSS 108 alike)."""

    scan_h_deg: float = Field(description="the vertical line on which the cut-off is looked for")
    at_v_deg: float = Field(description="where the cut-off goes on that line")
    sharpness_min: float = Field(description="least of log10 E(v) - log10 E(v + 0.1 deg) on the scan")
    sharpness_max: float | None = None
    straight_at_h_deg: tuple[float, ...]
    straight_within_deg: float
    shoulder: bool = Field(False, description="aim sideways too, by the rising part of the cut-off")


class ReAim(Params):
    """How far a lamp may be turned from its nominal aim to pass."""

    left: float = 0.0
    right: float = 0.0
    vertical: float = 0.0


class RuleSet(Params):
    """All requirements of one class of beam; values of one lamp."""

    id: str
    also: str = ""
    title: str
    table: str
    beam: Literal["low", "high", "adaptive"]
    confidence: str
    note: str = ""
    cutoff: tuple[Cutoff, ...] = Field((), description="alternatives, of which the sharper counts")
    re_aim_deg: ReAim = ReAim()
    requirements: tuple[Requirement, ...]


@cache
def sets() -> dict[str, RuleSet]:
    """All sets by their id."""
    tables = [tomllib.loads(path.read_text("utf-8")) for path in sorted(Path(__file__).parent.glob("*.toml"))]
    return {name: RuleSet(id=name, **content) for table in tables for name, content in table.items()}


def rule_set(set_id: str) -> RuleSet:
    """The set of this id, whatever its case. Raises LuxloopError that names those that have the word in them, or the nearest one."""
    wanted = set_id.lower().replace("_", "-").replace(" ", "-")
    known = sets() | {each.also: each for each in sets().values() if each.also}
    if wanted in known:
        return known[wanted]
    alike = sorted(name for name in known if wanted in name) if wanted else []
    hint = f"did you mean {', '.join(alike)}?" if alike else did_you_mean(wanted, sorted(known))
    raise LuxloopError(f"there is no rule {set_id!r}; {hint}")
