"""Check of a beam against a set of requirements: value, limit and verdict of each."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from luxloop.world.frames import rotation
from luxloop.world.headlight.lamp import direction
from luxloop.world.regulation import cutoff, sampling
from luxloop.world.regulation.results import Intensity, Result, Traffic, Verdict, margin
from luxloop.world.regulation.tables import Point, Requirement, RuleSet, rule_set

IMAX_FIELD = ((-45.0, -20.0), (45.0, -20.0), (45.0, 20.0), (-45.0, 20.0))  # deg; no headlamp has its maximum outside
STEP_DEG = 0.05
FLUX_STEP_DEG = 0.1


def check_beam(
    intensity: Intensity,
    set_id: str,
    *,
    aim: Point = (0.0, 0.0),
    traffic: Traffic = "right",
    conditional: bool = False,
    step_deg: float = STEP_DEG,
) -> tuple[Result, ...]:
    """Check one lamp's beam against a set of requirements, each at its worst point.

    intensity: cd `[N]` of directions `[3, N]` of the lamp frame. set_id: such as "r149-passing-c". aim: how far the lamp is turned, deg to
    the right and up; `aim()` finds it. traffic: the tables are made for traffic on the right and are mirrored for the left. conditional:
    include requirements that apply only under a condition. step_deg: spacing of the points at which zones are sampled. Raises LuxloopError
    for an unknown id.
    """
    rules = rule_set(set_id)
    seen = aimed(intensity, aim, traffic)
    results = evaluate(seen, rules, conditional, step_deg) + cutoff.judge(seen, rules)
    sign = -1.0 if traffic == "left" else 1.0
    return tuple(replace(each, where=each.where and (sign * each.where[0], each.where[1])) for each in results)


def aimed(intensity: Intensity, aim: Point, traffic: Traffic = "right") -> Intensity:
    """The intensity in photometry's directions, for traffic on the right, of a lamp turned by aim `(h, v)` in deg to the right and up."""
    h, v = torch.deg2rad(torch.tensor(aim, dtype=torch.float64))
    R_photometry_lamp = rotation(torch.zeros_like(h), -v, -h)
    mirror = torch.tensor([[1.0], [-1.0 if traffic == "left" else 1.0], [1.0]], dtype=torch.float64)
    return lambda directions: intensity(R_photometry_lamp.T @ (mirror * directions)).double()


def evaluate(intensity: Intensity, rules: RuleSet, conditional: bool = False, step_deg: float = STEP_DEG) -> tuple[Result, ...]:
    """All requirements but those on the cut-off. Two calls of intensity: everywhere, then finer where zones are worst."""
    samples = [samples_of(each, step_deg) for each in rules.requirements]
    values = _seen(intensity, samples)
    finer = [_finer(*each, step_deg) for each in zip(rules.requirements, samples, values, strict=True)]
    values = [torch.cat(pair) for pair in zip(values, _seen(intensity, finer), strict=True)]
    samples = [torch.cat(pair, 1) for pair in zip(samples, finer, strict=True)]
    found = {each.id: _value(each, *at) for each, *at in zip(rules.requirements, samples, values, strict=True)}
    return tuple(_result(each, found, rules, conditional) for each in rules.requirements)


def _seen(intensity: Intensity, samples: list[Tensor]) -> list[Tensor]:
    return list(intensity(direction(*torch.cat(samples, 1))).split([each.shape[1] for each in samples]))


def samples_of(requirement: Requirement, step_deg: float) -> Tensor:
    """First sample points of a requirement: `[2, N]` of h and v in deg."""
    if requirement.kind == "segment":
        start, end = requirement.where
        return sampling.segment(start, end, step_deg)
    if requirement.kind in ("zone", "imax"):
        return sampling.zone(requirement.where or IMAX_FIELD, step_deg)
    if requirement.kind == "flux":
        return sampling.cells(requirement.where, FLUX_STEP_DEG)
    return torch.tensor(requirement.where, dtype=torch.float64).T


def _finer(requirement: Requirement, points: Tensor, values: Tensor, step_deg: float) -> Tensor:
    """More points `[2, N]` around the largest and the smallest value of a zone."""
    if requirement.kind not in ("zone", "imax"):
        return points[:, :0]
    corners = requirement.where or IMAX_FIELD
    return torch.cat([sampling.around(corners, points, sign * values, step_deg) for sign in (1, -1)], 1)


def _value(requirement: Requirement, points: Tensor, values: Tensor) -> tuple[float, Point | None]:
    """The decisive value and its point: nearest to a limit or farthest beyond it; for Imax the largest."""
    if requirement.kind == "sum":
        return float(values.sum()), None
    if requirement.kind == "flux":
        return float((values * torch.deg2rad(points[1]).cos()).sum()) * math.radians(FLUX_STEP_DEG) ** 2, None
    worst = _worst(requirement, values)
    h, v = points[:, worst].tolist()
    return float(values[worst]), (h, v)


def _worst(requirement: Requirement, values: Tensor) -> int:
    high, low = int(values.argmax()), int(values.argmin())
    if requirement.kind == "imax" or requirement.min is None:
        return high
    low_margin = margin(float(values[low]), requirement.min, None)
    return low if low_margin <= margin(float(values[high]), None, requirement.max) else high


def _result(requirement: Requirement, found: dict[str, tuple[float, Point | None]], rules: RuleSet, conditional: bool) -> Result:
    unit = found[requirement.of][0] if requirement.of else 1.0
    least, most = (None if limit is None else limit * unit for limit in (requirement.min, requirement.max))
    value, where = found[requirement.id]
    notes = [requirement.note]
    if requirement.of:
        notes.append(f"limit {requirement.max or requirement.min:g} times {requirement.of}")
    if requirement.only_if:
        notes.append(f"only if {requirement.only_if}")
    verdict: Verdict = "pass" if (least or 0) <= value <= (math.inf if most is None else most) else "fail"
    if requirement.only_if and not conditional:
        verdict = "not applicable"
    return Result(requirement.id, requirement.kind, where, value, least, most, verdict, rules.confidence, "; ".join(filter(None, notes)))
