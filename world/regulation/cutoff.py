"""Cut-off of a passing beam: position, sharpness and straightness."""

from dataclasses import dataclass

import torch

from luxloop.world.headlight.lamp import direction
from luxloop.world.regulation.results import Intensity, Result, Verdict, least_margin, margin
from luxloop.world.regulation.tables import Cutoff, RuleSet

SCAN_STEP_DEG = 0.05
GRADIENT_STEPS = 2  # 0.1 deg
SCAN_HALF_DEG = 1.5  # how far above and below its place the cut-off is looked for
DARK_CD = 6.25  # 0.01 lx at 25 m, a photometer's last digit: logarithms need a floor
NEARLY_STEEPEST = 0.98  # an exponential slope is steep all along: its middle counts


@dataclass(frozen=True)
class Inflection:
    """The steepest place of a vertical scan: v in deg, and the decades of light lost in 0.1 deg there."""

    v_deg: float
    sharpness: float


def inflection(intensity: Intensity, h_deg: float, near_v_deg: float) -> Inflection:
    """Scan upwards at h for the largest `G = log10 E(v) - log10 E(v + 0.1 deg)`; the inflection is the middle of that step."""
    n = round(2 * SCAN_HALF_DEG / SCAN_STEP_DEG) + 1
    v = near_v_deg + torch.linspace(-SCAN_HALF_DEG, SCAN_HALF_DEG, n, dtype=torch.float64)
    log = intensity(direction(torch.full_like(v, h_deg), v)).clamp(min=DARK_CD).log10()
    G = log[:-GRADIENT_STEPS] - log[GRADIENT_STEPS:]
    steepest = NEARLY_STEEPEST * G.max() <= G
    middle = (v[:-GRADIENT_STEPS] + v[GRADIENT_STEPS:])[steepest].mean() / 2
    return Inflection(float(middle), float(G.max()))


def judge(intensity: Intensity, rules: RuleSet) -> tuple[Result, ...]:
    """Sharpness and straightness of the cut-off; none where the set does not ask for one. Of alternatives the better counts."""
    return max((_judge(intensity, each, rules.confidence) for each in rules.cutoff), key=least_margin, default=())


def _judge(intensity: Intensity, cutoff: Cutoff, confidence: str) -> tuple[Result, ...]:
    found = inflection(intensity, cutoff.scan_h_deg, cutoff.at_v_deg)
    heights = {h: inflection(intensity, h, cutoff.at_v_deg).v_deg for h in cutoff.straight_at_h_deg}
    h, v = max(heights.items(), key=lambda item: abs(item[1] - found.v_deg))
    least, most = cutoff.sharpness_min, cutoff.sharpness_max
    bend, bend_most = abs(v - found.v_deg), cutoff.straight_within_deg
    sharp: Verdict = "pass" if margin(found.sharpness, least, most) >= 0 else "fail"
    straight: Verdict = "pass" if bend <= bend_most else "fail"
    return (
        Result("Cut-off sharpness", "sharpness", (cutoff.scan_h_deg, found.v_deg), found.sharpness, least, most, sharp, confidence),
        Result("Cut-off straightness", "straightness", (h, v), bend, None, bend_most, straight, confidence),
    )
