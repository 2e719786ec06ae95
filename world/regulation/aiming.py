"""Aiming of a lamp before a check: by its cut-off or maximum, then re-aimed within the tolerance if that helps."""

import torch

from luxloop.world.headlight.lamp import direction
from luxloop.world.regulation import cutoff, sampling
from luxloop.world.regulation.checking import IMAX_FIELD, STEP_DEG, aimed, evaluate
from luxloop.world.regulation.results import Intensity, Traffic, least_margin, passes
from luxloop.world.regulation.tables import Cutoff, Point, RuleSet, rule_set

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
    seen = aimed(intensity, (0.0, 0.0), traffic)

    def judged(turn: Point, step_deg: float) -> tuple[bool, float]:
        turned = aimed(seen, turn)
        results = evaluate(turned, rules, step_deg=step_deg) + cutoff.judge(turned, rules)
        return passes(results), least_margin(results)

    best = _nominal(seen, rules)
    if not judged(best, STEP_DEG)[0]:
        passing = [(margin, turn) for turn in _within(best, rules) for passed, margin in [judged(turn, SEARCH_STEP_DEG)] if passed]
        best = max(passing)[1] if passing else best
    return (-best[0] if traffic == "left" else best[0], best[1])


def _nominal(seen: Intensity, rules: RuleSet) -> Point:
    if rules.cutoff:
        edge = max(rules.cutoff, key=lambda each: cutoff.inflection(seen, each.scan_h_deg, each.at_v_deg).sharpness)
        v = edge.at_v_deg - cutoff.inflection(seen, edge.scan_h_deg, edge.at_v_deg).v_deg
        return (_sideways(aimed(seen, (0.0, v)), edge) if edge.shoulder else 0.0), v
    return _to_maximum(seen) if rules.beam == "high" else (0.0, 0.0)


def _sideways(seen: Intensity, edge: Cutoff) -> float:
    """By the line through the cut-off at h = 1, 2, 3, which should meet its flat part at h = 0; not at all if those are not sharp."""
    found = [cutoff.inflection(seen, h, edge.at_v_deg) for h in SHOULDER_H_DEG]
    h = torch.tensor(SHOULDER_H_DEG, dtype=torch.float64)
    v = torch.tensor([each.v_deg for each in found], dtype=torch.float64)
    rise = float(((h - h.mean()) * v).sum() / (h - h.mean()).square().sum())
    if rise < LEAST_RISE or min(each.sharpness for each in found) < SHOULDER_SHARPNESS:
        return 0.0
    return float(v.mean() - edge.at_v_deg) / rise - float(h.mean())


def _to_maximum(seen: Intensity) -> Point:
    points = sampling.zone(IMAX_FIELD, STEP_DEG)
    values = seen(direction(*points))
    h, v = points[:, values >= NEAR_MAXIMUM * values.max()].mean(1).tolist()
    return -h, -v


def _within(nominal: Point, rules: RuleSet) -> list[Point]:
    reach = rules.re_aim_deg
    sideways = [*torch.linspace(-reach.left, reach.right, AIMS).tolist(), 0.0]
    upwards = torch.linspace(-reach.vertical, reach.vertical, AIMS).tolist()
    return [(nominal[0] + h, nominal[1] + v) for h in sideways for v in upwards]
