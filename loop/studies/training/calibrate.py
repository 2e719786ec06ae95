"""Calibration of scores to the share of correct boxes (Platt 1999; Guo et al. 2017)."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from scipy.optimize import minimize
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from luxloop.loop.studies.training.judge import JUDGED_LX, boxes_right, object_based, seen
from luxloop.loop.studies.training.scenes import CLASSES, read
from luxloop.perception.detection.network import NetworkDetector
from luxloop.world.errors import LuxloopError

SUREST = 1e-6  # least distance of a score to 1, where the logit diverges


def calibrate(detector: NetworkDetector, rows: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Calibrate the logits of the detector's network so that scores are shares of correct boxes; returns slope and shift.

    rows: from `luxloop.loop.studies.training.scenes.draw`, of scenes not used in training; each is seen in full and in object-based light.
    Raises LuxloopError if the scores do not separate correct boxes from wrong ones.
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
        raise LuxloopError("the network's scores do not separate correct boxes from wrong ones; give more --scenes or --epochs")
    detector.network.calibrate(slope, shift)
    return slope, shift


def logistic(x: Tensor, right: Tensor) -> tuple[float, float]:
    """Slope and shift of the logistic curve that fits best the probability of right (`[n]`, 0 or 1) over x, `[n]`.

    Targets are slightly inside 0..1, so that a best curve exists (Platt 1999).
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
