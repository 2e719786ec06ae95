"""The rig as a plant: it shows exposures, assigns pictures to them, and evaluates symbols after the run."""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.rig.arrays import Grids, Image, grids_of
from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.matching import mark_surroundings
from luxloop.loop.rig.params import MarkParams
from luxloop.loop.rig.rig import Rig
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame
from luxloop.loop.simulation.truth import LampModule
from luxloop.perception.birdseye import BirdsEye, birds_eye, region_around
from luxloop.perception.camera import CameraParams, camera_view, luminance_of
from luxloop.perception.metrics import CELL_M, Target, evaluate, target


@dataclass(frozen=True, eq=False)
class RigPlant:
    """A rig as a plant. It has no state, since hardware cannot return to an earlier one, and does not know the truth.

    Its clock is `time.monotonic`. grids: rows and columns of the modules' pixels. like: gives dtype and device of frames. last: number of
    the last exposure; the lamp is dark afterwards. look: called with each exposure and its image, None if lost.
    """

    rig: Rig
    grids: Grids
    like: Tensor
    last: int
    look: Callable[[Exposure, Tensor | None], None] = lambda exposure, image: None

    @classmethod
    def of(cls, rig: Rig, modules: Sequence[LampModule], exposures: int) -> "RigPlant":
        """Plant of an open rig. modules: of the scenario's lamps. exposures: number of exposures of the run."""
        return cls(rig, grids_of(modules), modules[0].headlight.matrix.values, exposures - 1)

    def start(self) -> tuple[None, Arrivals]:
        """Initial state: nothing is lit."""
        return None, Arrivals(time.monotonic(), samples=self.rig.ego.samples(self.like))

    def show(self, state: None, exposure: Exposure) -> tuple[None, Arrivals]:
        """Show an exposure for at least its duration, until a frame of its light alone has arrived or counts as lost."""
        pictures = tuple(_picture(light, grid) for light, grid in zip(exposure.lights, self.grids, strict=True))
        limited_light, rig_frame = self.rig.expose(Shine(exposure.number, pictures, exposure.commands), exposure.duration_s)
        if rig_frame.image is None:
            frame = Frame(exposure.number, math.nan, math.nan, None)
        else:
            taken_s = max(rig_frame.sent_s, rig_frame.arrived_s - self.rig.params.timing.latency_s)
            shown = None
            if not limited_light.whole:  # the safety limits changed the exposure
                lit = zip(limited_light.shine.pictures, exposure.lights, strict=True)
                lights = tuple(Utilisation(torch.from_numpy(u.ravel()).to(each.u)) for u, each in lit)
                shown = replace(exposure, lights=lights, commands=limited_light.shine.commands)
            frame = Frame(exposure.number, taken_s, rig_frame.arrived_s, torch.from_numpy(rig_frame.image).to(self.like), shown)
        self.look(exposure, frame.image)
        if exposure.number == self.last:
            self.rig.keeper.dark("the run has ended")
        samples = self.rig.ego.samples(self.like)
        return state, Arrivals(time.monotonic(), (frame,), samples)


def _picture(light: Utilisation, grid: tuple[int, int]) -> Image:
    """Utilisations `[rows, columns]` in 0..1; light below 0 would count against other pixels in the limits."""
    return light.u.detach().to("cpu", torch.float32).nan_to_num(0.0).clamp(0, 1).numpy().reshape(grid)


LAST = 10  # pairs of frames


class RigEvaluator:
    """Metrics of a run's last frames, computed after its end so that they delay no step."""

    def __init__(self, symbols: Mapping[str, ControlledSymbol], camera: CameraParams, mark: MarkParams | None = None) -> None:
        """symbols: held symbols by name. camera: the scenario's. mark: in the light, left out of the evaluation."""
        self._camera, self._mark = camera, mark
        self._goals = {name: _goal(each, camera) for name, each in symbols.items()}
        self._on: tuple[Exposure, Tensor] | None = None
        self._pairs = {name: deque[tuple[int, Tensor, Tensor]](maxlen=LAST) for name in symbols}

    def look(self, exposure: Exposure, image: Tensor | None) -> None:
        """Store the frame of an exposure, None if lost; frames of consecutive exposures form a pair."""
        before, self._on = self._on, None if image is None else (exposure, image)
        if before is None or image is None or before[0].number + 1 != exposure.number:
            return
        for name in before[0].projections.keys() - exposure.projections.keys():
            self._pairs[name].append((exposure.number, before[1], image))

    def summary(self) -> dict[str, Any]:
        """By symbol: IoU and centroid error (None if nothing is lit) of the last pair of frames, number of its exposure, and mean IoU of
        the last ten pairs.
        """
        found = {}
        for name, pairs in self._pairs.items():
            if not pairs:
                continue
            metrics = [evaluate(self._luminance(on) - self._luminance(off), *self._goals[name]) for _, on, off in pairs]
            ious, off = [float(each.iou) for each in metrics], metrics[-1].centroid_percent.tolist()
            found[name] = {
                "exposure": pairs[-1][0],
                "iou_final": ious[-1],
                "iou_mean": sum(ious) / len(ious),
                "centroid_error_percent": off if all(map(math.isfinite, off)) else None,
                "pairs": len(ious),
            }
        return found

    def _luminance(self, image: Tensor) -> Tensor:
        """Luminance `[height, width]` of a frame in cd/m^2, 0 around the mark."""
        if self._mark is not None:
            image = image.clone()
            image[mark_surroundings(self._mark)] = 0
        return luminance_of(image, self._camera)


def _goal(symbol: ControlledSymbol, camera: CameraParams) -> tuple[BirdsEye, Target]:
    """Bird's-eye view of the assumed road, and the symbol at its target there, as the camera would see it."""
    held, projector = symbol.function.held, symbol.projector
    region = region_around(held.x_m, held.y_m, held.length_m, held.width_m, CELL_M)
    flat = symbol.sensor.model.luminance(projector.light(projector.target))
    plane = birds_eye(region, camera_view(camera)).to(flat.device)
    return plane, target(flat, plane, held.length_m, held.width_m)
