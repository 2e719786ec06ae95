"""Objective of tuning: a weighted sum of named terms over a run's figures. A failed run has the maximum cost."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from luxloop.loop.scenario.model import Scenario
from luxloop.world.errors import LuxloopError, did_you_mean

FAILED = 2.0  # cost of a term without a value, and the maximum: as if the symbol settled after twice the run

Figures = Mapping[str, Any]
# name: (figure, its conversion to a cost, description)
TERMS = {
    "settling": ("settle_step", lambda value, row: value / row["steps"], "settle step, as a share of all steps"),
    "overshoot": ("overshoot_percent", lambda value, row: value / 100, "overshoot, as a share of the initial error"),
    "residual": ("residual_percent", lambda value, row: value / 10, "centroid error at the end, in tenths of the symbol's size"),
    "iou": ("iou_mean", lambda value, row: 1 - value, "1 - IoU, mean of all evaluated steps"),
    "effort": ("effort", lambda value, row: value - 1, "path of the symbol's pose along x and y, as a share of the way, less 1"),
    "energy": ("utilisation_mean", lambda value, row: value, "utilisation of all pixels, mean of all steps"),
}


@dataclass(frozen=True)
class Objective:
    """An objective. weights: of terms, by name."""

    weights: dict[str, float]

    def __str__(self) -> str:
        return "+".join(name if weight == 1 else f"{weight:g}*{name}" for name, weight in self.weights.items())

    def refuse(self, scenario: Scenario) -> None:
        """Raises LuxloopError where a term needs a symbol that a controller holds, and the scenario has none."""
        if not scenario.symbols and (needing := self.weights.keys() - {"energy"}):
            raise LuxloopError(
                f"{scenario.name}: no controller holds a symbol, which {', '.join(sorted(needing))} need; "
                "tune a scenario with one, or give --objective energy"
            )

    def cost(self, row: Figures) -> float:
        """Cost of a run's figures, which are empty for a failed run."""
        return sum(weight * _term(name, row) for name, weight in self.weights.items())


def parse(text: str) -> Objective:
    """Objective from a text such as settling+0.5*overshoot. Raises LuxloopError with the mistake."""
    weights: dict[str, float] = {}
    for part in text.split("+"):
        match = re.fullmatch(r"\s*(?:(\d+\.?\d*|\.\d+)\s*\*)?\s*(\w+)\s*", part)
        if not match:
            raise LuxloopError(f"--objective {text}: {part.strip()!r} is not a term; write for example settling+0.5*overshoot")
        weight, name = match.groups()
        if name not in TERMS:
            raise LuxloopError(f"--objective {text}: there is no term {name!r}; {did_you_mean(name, TERMS)}")
        weights[name] = weights.get(name, 0.0) + float(weight or 1)
    if not any(weights.values()):
        raise LuxloopError(f"--objective {text}: weighs nothing, so all trials would be alike; give a term a weight above 0")
    return Objective(weights)


def _term(name: str, row: Figures) -> float:
    figure, of, _ = TERMS[name]
    value = row.get(figure)
    if value is None:
        # A run that starts at the target has no overshoot and no way to go, and one whose symbol is never seen neither.
        return 0.0 if name in ("overshoot", "effort") and row.get("residual_percent") is not None else FAILED
    return min(float(of(value, row)), FAILED)
