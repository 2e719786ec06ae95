"""Check of a beam against a set of requirements: value, limit and verdict of each; its cut-off; its aim before the check."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from luxloop.world.frames import rotation
from luxloop.world.headlight.lamp import direction
from luxloop.world.regulation.tables import (
    Cutoff,
    Intensity,
    Point,
    Requirement,
    Result,
    RuleSet,
    Traffic,
    Verdict,
    least_margin,
    margin,
    passes,
    rule_set,
)

MOST_SAMPLES = 400_000  # samples of a zone; larger zones are sampled more coarsely and refined around their extremes
EXTREMES = 8  # samples around which the search is refined
FINER = 10


def segment(start: Point, end: Point, step_deg: float) -> Tensor:
    n = max(math.ceil(math.dist(start, end) / step_deg), 1)
    share = torch.linspace(0, 1, n + 1, dtype=torch.float64)
    a, b = (torch.tensor(point, dtype=torch.float64)[:, None] for point in (start, end))
    return a + (b - a) * share


def cells(box: tuple[Point, ...], step_deg: float) -> Tensor:
    """The middles of the cells of a box, given by two opposite corners."""
    low, high = box
    h, v = (a + (torch.arange(round((b - a) / step_deg), dtype=torch.float64) + 0.5) * step_deg for a, b in zip(low, high, strict=True))
    return torch.cartesian_prod(h, v).T


def zone(corners: tuple[Point, ...], step_deg: float) -> Tensor:
    """The outline and the inside of a polygon."""
    step = _affordable(corners, step_deg)
    lines = [segment(a, b, step) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    (h0, v0), (h1, v1) = (tuple(map(extreme, zip(*corners, strict=True))) for extreme in (min, max))
    h, v = segment((h0, 0.0), (h1, 0.0), step)[0], segment((0.0, v0), (0.0, v1), step)[1]
    points = torch.cartesian_prod(h, v).T
    return torch.cat([*lines, points[:, _inside(corners, points)]], 1)


def around(corners: tuple[Point, ...], points: Tensor, values: Tensor, step_deg: float) -> Tensor:
    """Finer samples, within the polygon, around the points where values `[N]` are largest."""
    step = _affordable(corners, step_deg)
    highest = points[:, values.topk(min(EXTREMES, len(values))).indices]
    offset = torch.linspace(-step, step, 2 * FINER + 1, dtype=torch.float64)
    fine = (highest[:, :, None] + torch.cartesian_prod(offset, offset).T[:, None]).flatten(1)
    return fine[:, _inside(corners, fine)]


def _affordable(corners: tuple[Point, ...], step_deg: float) -> float:
    """The step wanted, or the coarser one that keeps to MOST_SAMPLES."""
    width, height = (max(axis) - min(axis) for axis in zip(*corners, strict=True))
    return max(step_deg, math.sqrt(width * height / MOST_SAMPLES))


def _inside(corners: tuple[Point, ...], points: Tensor) -> Tensor:
    """Which points `[2, N]` the polygon holds, by the even-odd rule; points on its outline may go either way."""
    h, v = points
    held = torch.zeros(points.shape[1], dtype=torch.bool)
    for (h0, v0), (h1, v1) in zip(corners, corners[1:] + corners[:1], strict=True):
        if v0 != v1:
            held ^= ((v0 > v) != (v1 > v)) & (h < h0 + (v - v0) * (h1 - h0) / (v1 - v0))
    return held


SCAN_STEP_DEG = 0.05
GRADIENT_STEPS = 2  # 0.1 deg
SCAN_HALF_DEG = 1.5  # search range of the cut-off above and below its nominal height
DARK_CD = 6.25  # 0.01 lx at 25 m, a photometer's last digit: logarithms need a floor
NEARLY_STEEPEST = 0.98  # an exponential slope is steep all along: its middle counts


def inflection(intensity: Intensity, h_deg: float, near_v_deg: float) -> tuple[float, float]:
    """Scan upwards at h for the largest `G = log10 E(v) - log10 E(v + 0.1 deg)`: the middle of that step in deg, and G in decades."""
    n = round(2 * SCAN_HALF_DEG / SCAN_STEP_DEG) + 1
    v = near_v_deg + torch.linspace(-SCAN_HALF_DEG, SCAN_HALF_DEG, n, dtype=torch.float64)
    log = intensity(direction(torch.full_like(v, h_deg), v)).clamp(min=DARK_CD).log10()
    G = log[:-GRADIENT_STEPS] - log[GRADIENT_STEPS:]
    steepest = NEARLY_STEEPEST * G.max() <= G
    middle = (v[:-GRADIENT_STEPS] + v[GRADIENT_STEPS:])[steepest].mean() / 2
    return float(middle), float(G.max())


def check_cutoff(intensity: Intensity, rules: RuleSet) -> tuple[Result, ...]:
    """Sharpness and straightness of the cut-off; none where the set does not ask for one. Of alternatives the better counts."""
    return max((_check_one_cutoff(intensity, each, rules.confidence) for each in rules.cutoff), key=least_margin, default=())


def _check_one_cutoff(intensity: Intensity, cutoff: Cutoff, confidence: str) -> tuple[Result, ...]:
    scan_h, least, most, bend_most = cutoff.scan_h_deg, cutoff.sharpness_min, cutoff.sharpness_max, cutoff.straight_within_deg
    at_v, sharpness = inflection(intensity, scan_h, cutoff.at_v_deg)
    heights = [(h, inflection(intensity, h, cutoff.at_v_deg)[0]) for h in cutoff.straight_at_h_deg]
    h, v = max(heights, key=lambda place: abs(place[1] - at_v))
    sharp: Verdict = "pass" if margin(sharpness, least, most) >= 0 else "fail"
    straight: Verdict = "pass" if abs(v - at_v) <= bend_most else "fail"
    return (
        Result("Cut-off sharpness", "sharpness", (scan_h, at_v), sharpness, least, most, sharp, confidence),
        Result("Cut-off straightness", "straightness", (h, v), abs(v - at_v), None, bend_most, straight, confidence),
    )


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
    seen = turn_lamp(intensity, aim, traffic)
    results = evaluate(seen, rules, conditional, step_deg) + check_cutoff(seen, rules)
    sign = -1.0 if traffic == "left" else 1.0
    return tuple(replace(each, where=each.where and (sign * each.where[0], each.where[1])) for each in results)


def turn_lamp(intensity: Intensity, aim: Point, traffic: Traffic = "right") -> Intensity:
    """The intensity in photometry's directions, for traffic on the right, of a lamp turned by aim `(h, v)` in deg to the right and up."""
    h, v = torch.deg2rad(torch.tensor(aim, dtype=torch.float64))
    R_photometry_lamp = rotation(torch.zeros_like(h), -v, -h)
    mirror = torch.tensor([[1.0], [-1.0 if traffic == "left" else 1.0], [1.0]], dtype=torch.float64)
    return lambda directions: intensity(R_photometry_lamp.T @ (mirror * directions)).double()


def evaluate(intensity: Intensity, rules: RuleSet, conditional: bool = False, step_deg: float = STEP_DEG) -> tuple[Result, ...]:
    """All requirements but those on the cut-off. Two calls of intensity: everywhere, then finer where zones are worst."""
    samples = [samples_of(each, step_deg) for each in rules.requirements]
    values = _values_at(intensity, samples)
    finer = [_finer(*each, step_deg) for each in zip(rules.requirements, samples, values, strict=True)]
    values = [torch.cat(pair) for pair in zip(values, _values_at(intensity, finer), strict=True)]
    samples = [torch.cat(pair, 1) for pair in zip(samples, finer, strict=True)]
    found = {each.id: _value(each, *at) for each, *at in zip(rules.requirements, samples, values, strict=True)}
    return tuple(_result(each, found, rules, conditional) for each in rules.requirements)


def _values_at(intensity: Intensity, samples: list[Tensor]) -> list[Tensor]:
    return list(intensity(direction(*torch.cat(samples, 1))).split([each.shape[1] for each in samples]))


def samples_of(requirement: Requirement, step_deg: float) -> Tensor:
    """First sample points of a requirement: `[2, N]` of h and v in deg."""
    if requirement.kind == "segment":
        start, end = requirement.where
        return segment(start, end, step_deg)
    if requirement.kind in ("zone", "imax"):
        return zone(requirement.where or IMAX_FIELD, step_deg)
    if requirement.kind == "flux":
        return cells(requirement.where, FLUX_STEP_DEG)
    return torch.tensor(requirement.where, dtype=torch.float64).view(-1, 2).T


def _finer(requirement: Requirement, points: Tensor, values: Tensor, step_deg: float) -> Tensor:
    """More points `[2, N]` around the largest and the smallest value of a zone."""
    if requirement.kind not in ("zone", "imax"):
        return points[:, :0]
    corners = requirement.where or IMAX_FIELD
    return torch.cat([around(corners, points, sign * values, step_deg) for sign in (1, -1)], 1)


def _value(requirement: Requirement, points: Tensor, values: Tensor) -> tuple[float, Point | None]:
    """The decisive value and its point: nearest to a limit or farthest beyond it; for Imax the largest."""
    if requirement.kind == "unknown":
        return math.nan, None
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
    if requirement.kind == "unknown":
        verdict = "unknown"
    if requirement.only_if and not conditional:
        verdict = "not applicable"
    return Result(requirement.id, requirement.kind, where, value, least, most, verdict, rules.confidence, "; ".join(filter(None, notes)))


SHOULDER_H_DEG = (1.0, 2.0, 3.0)
SHOULDER_SHARPNESS = 0.08
LEAST_RISE = 0.05  # of a shoulder, deg per deg: a flatter one aims nothing
NEAR_MAXIMUM = 0.95  # a maximum may be a plateau: its middle goes to H-V
SEARCH_STEP_DEG = 0.25  # of the points while aims are tried
AIMS = 5  # tried in each direction


def aim_beam(intensity: Intensity, set_id: str, *, traffic: Traffic = "right") -> Point:
    """The aim `(h, v)` in deg, right and up positive, at which this set checks the lamp.

    intensity: cd `[N]` of directions `[3, N]` of the lamp frame. set_id: such as "r149-passing-c". traffic: side of the road it keeps to. A
    cut-off is set to its nominal height and its shoulder to its nominal position, a driving beam's maximum to H-V; other beams are not
    aimed. If the lamp fails at this aim, the best aim within the set's tolerance at which it passes is taken, if there is one. Raises
    LuxloopError for an unknown id.
    """
    rules = rule_set(set_id)
    seen = turn_lamp(intensity, (0.0, 0.0), traffic)

    def evaluate_aim(turn: Point, step_deg: float) -> tuple[bool, float]:
        turned = turn_lamp(seen, turn)
        results = evaluate(turned, rules, step_deg=step_deg) + check_cutoff(turned, rules)
        return passes(results), least_margin(results)

    best = _nominal(seen, rules)
    if not evaluate_aim(best, STEP_DEG)[0]:
        passing = [(margin, turn) for turn in _within(best, rules) for passed, margin in [evaluate_aim(turn, SEARCH_STEP_DEG)] if passed]
        best = max(passing)[1] if passing else best
    return (-best[0] if traffic == "left" else best[0], best[1])


def _nominal(seen: Intensity, rules: RuleSet) -> Point:
    if rules.cutoff:
        edge = max(rules.cutoff, key=lambda each: inflection(seen, each.scan_h_deg, each.at_v_deg)[1])
        v = edge.at_v_deg - inflection(seen, edge.scan_h_deg, edge.at_v_deg)[0]
        return (_sideways(turn_lamp(seen, (0.0, v)), edge) if edge.shoulder else 0.0), v
    return _to_maximum(seen) if rules.beam == "high" else (0.0, 0.0)


def _sideways(seen: Intensity, edge: Cutoff) -> float:
    """Horizontal aim: the line through the cut-off at h = 1, 2, 3 should meet its flat part at h = 0. Zero if it is not sharp there."""
    heights, sharpness = zip(*(inflection(seen, h, edge.at_v_deg) for h in SHOULDER_H_DEG), strict=True)
    h, v = (torch.tensor(each, dtype=torch.float64) for each in (SHOULDER_H_DEG, heights))
    rise = float(((h - h.mean()) * v).sum() / (h - h.mean()).square().sum())
    if rise < LEAST_RISE or min(sharpness) < SHOULDER_SHARPNESS:
        return 0.0
    return float(v.mean() - edge.at_v_deg) / rise - float(h.mean())


def _to_maximum(seen: Intensity) -> Point:
    points = zone(IMAX_FIELD, STEP_DEG)
    values = seen(direction(*points))
    h, v = points[:, values >= NEAR_MAXIMUM * values.max()].mean(1).tolist()
    return -h, -v


def _within(nominal: Point, rules: RuleSet) -> list[Point]:
    reach = rules.re_aim_deg
    sideways = [*torch.linspace(-reach.left, reach.right, AIMS).tolist(), 0.0]
    upwards = torch.linspace(-reach.vertical, reach.vertical, AIMS).tolist()
    return [(nominal[0] + h, nominal[1] + v) for h in sideways for v in upwards]
