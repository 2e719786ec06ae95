"""IoU on a rig without ground truth: from its own camera's bird's-eye view of the plane that the camera is calibrated to.

It includes the camera's noise. If the road is not this plane, a symbol that looks correct to the camera lies elsewhere.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from torch import Tensor

from luxloop.loop.rig.mark import surroundings
from luxloop.loop.rig.params import MarkParams
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.loop.simulation.protocol import Exposure
from luxloop.perception.birdseye import BirdsEye, birds_eye, region_around
from luxloop.perception.camera import CameraParams, camera_view, luminance_of
from luxloop.perception.metrics import CELL_M, Metrics, Target, evaluate, target

LAST = 10  # pairs of frames


@dataclass(frozen=True, eq=False)
class CameraJudge:
    """Judges one symbol. plane: of the assumed road. goal: the symbol at its target on it, as the camera would see it."""

    camera: CameraParams
    plane: BirdsEye
    goal: Target

    @classmethod
    def of(cls, symbol: ControlledSymbol, camera: CameraParams) -> Self:
        """The judge of a held symbol. camera: the scenario's."""
        held, projector = symbol.function.held, symbol.projector
        region = region_around(held.x_m, held.y_m, held.length_m, held.width_m, CELL_M)
        flat = symbol.sensor.model.luminance(projector.light(projector.target))
        plane = birds_eye(region, camera_view(camera)).to(flat.device)
        return cls(camera, plane, target(flat, plane, held.length_m, held.width_m))

    def verdict(self, on: Tensor, off: Tensor) -> Metrics:
        """Verdict on frames `[height, width]` with the symbol (on) and without it (off)."""
        return evaluate(luminance_of(on, self.camera) - luminance_of(off, self.camera), self.plane, self.goal)


class Judged:
    """The last steps of a run, judged after its end, since judging would delay the steps."""

    def __init__(self, symbols: Mapping[str, ControlledSymbol], camera: CameraParams, mark: MarkParams | None = None) -> None:
        """symbols: held symbols by name. camera: the scenario's. mark: in the light, left out of the judgement."""
        self._mark = mark
        self._judges = {name: CameraJudge.of(each, camera) for name, each in symbols.items()}
        self._on: tuple[Exposure, Tensor] | None = None
        self._pairs = {name: deque[tuple[int, Tensor, Tensor]](maxlen=LAST) for name in symbols}

    def look(self, exposure: Exposure, image: Tensor | None) -> None:
        """Take the frame of an exposure, None if it is lost; frames of consecutive exposures are compared."""
        before, self._on = self._on, None if image is None else (exposure, image)
        if before is None or image is None or before[0].number + 1 != exposure.number:
            return
        for name in before[0].projections.keys() - exposure.projections.keys():
            self._pairs[name].append((exposure.number, before[1], image))

    def summary(self) -> dict[str, Any]:
        """By name: IoU and centroid error (None where nothing is lit) of the last pair of frames, the number of its exposure, and the mean
        IoU of the last ten.
        """
        found = {}
        for name, pairs in self._pairs.items():
            verdicts = [self._judges[name].verdict(self._unmarked(on), self._unmarked(off)) for _, on, off in pairs]
            if verdicts:
                off = verdicts[-1].centroid_percent.tolist()
                ious = [float(each.iou) for each in verdicts]
                lit = all(map(math.isfinite, off))
                mean = sum(ious) / len(ious)
                found[name] = {
                    "exposure": pairs[-1][0],
                    "iou_final": ious[-1],
                    "iou_mean": mean,
                    "centroid_error_percent": off if lit else None,
                    "pairs": len(ious),
                }
        return found

    def _unmarked(self, image: Tensor) -> Tensor:
        if (mark := self._mark) is None:
            return image
        image = image.clone()
        image[surroundings(mark)] = 0
        return image
