"""Overlap of the symbol with its target on a flat road, measured from above by the camera of a standing vehicle."""

from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from luxloop.controllers.symbol.heights.forward_model import ForwardModel
from luxloop.controllers.symbol.sensing.projector import SymbolParams
from luxloop.perception.birdseye import BirdsEye, birds_eye, rectify
from luxloop.perception.camera import camera_view
from luxloop.perception.metrics import CELL_M, THRESHOLD, Target, iou, target


@dataclass(frozen=True)
class TargetOverlap:
    """The target in a bird's-eye view of a forward model's image. It is the evaluator's measure, from noisy frames."""

    plane: BirdsEye
    goal: Target

    @classmethod
    def of(cls, forward_model: ForwardModel, textures: tuple[Tensor, ...], symbol: SymbolParams) -> Self:
        """textures: `[rows, cols]` cd, one a module, of the symbol at its target on a flat road."""
        view = camera_view(forward_model.camera).within(*forward_model.crop.slices).with_columns(forward_model.step)
        plane = birds_eye(replace(forward_model.region, cell_m=CELL_M), view).to(forward_model.inside.device)
        flat = forward_model.luminance(textures, torch.zeros_like(forward_model.inside)[None])[0]
        return cls(plane, target(flat, plane, symbol.length_m, symbol.width_m))

    def residual(self, contrast: Tensor, limit: Tensor) -> float:
        """1 minus intersection over union, for contrast and threshold `[h, w]` cd/m^2 of the forward model's image."""
        least = torch.maximum(rectify(self.plane, limit), THRESHOLD * self.goal.median)  # of lit cells, [rows, cols] cd/m^2
        return 1 - float(iou(rectify(self.plane, contrast) > least, self.goal.luminance > least))
