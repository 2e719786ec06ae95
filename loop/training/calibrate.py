"""Makes scores say how often they are right (Platt 1999; Guo et al. 2017)."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from scipy.optimize import minimize
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from loop.training.judge import JUDGED_LX, boxes_right, object_based, seen
from loop.training.scenes import CLASSES, read
from perception.detection.network import NetworkDetector
from world.errors import LuxloopError

SUREST = 1e-6  # least that is missing to a score of 1, whose logit has no end


def calibrate(detector: NetworkDetector, rows: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Slope and shift that the logits of the detector's network have been given, so that scores are the share of boxes that are right.

    rows: of scenes that `loop.training.scenes.draw` gave, other than those learnt from; each is seen in full and in object-based light.
    Raises LuxloopError where the scores do not tell right boxes from wrong ones.
    """
    asked: list[tuple[float, bool]] = []
    for row in rows:
        scene = read(row)
        full, alone = seen(scene, JUDGED_LX, int(row["seed"]), 0), seen(scene, object_based(scene), int(row["seed"]), 1)
        for found in detector.detect(torch.stack([full, alone])):
            asked += boxes_right(found, scene.objects, range(len(CLASSES)))
    scores, right = torch.tensor(asked, dtype=torch.float64).view(-1, 2).T
    slope, shift = logistic(scores.logit(eps=SUREST), right)
    if not right.any() or not (math.isfinite(slope) and math.isfinite(shift)) or slope <= 0:
        raise LuxloopError("the network has learnt nothing that tells right boxes from wrong ones; give more --scenes or --epochs")
    detector.network.calibrate(slope, shift)
    return slope, shift


def logistic(x: Tensor, right: Tensor) -> tuple[float, float]:
    """Slope and shift of the logistic curve that says best of each x, `[n]`, how likely it is right, `[n]` of 0 or 1.

    What is right counts as nearly right, what is not as nearly not, so that there is a best curve (Platt 1999).
    """
    hits, misses = float(right.sum()), float((1 - right).sum())
    targets = torch.where(right > 0, (hits + 1) / (hits + 2), 1 / (misses + 2))

    def loss(parameters: list[float]) -> tuple[float, list[float]]:
        given = torch.tensor(parameters, dtype=torch.float64, requires_grad=True)
        value = binary_cross_entropy_with_logits(given[0] * x + given[1], targets, reduction="sum")
        value.backward()
        assert given.grad is not None
        return float(value.detach()), given.grad.tolist()

    slope, shift = minimize(loss, [1.0, 0.0], jac=True, method="BFGS").x
    return float(slope), float(shift)
