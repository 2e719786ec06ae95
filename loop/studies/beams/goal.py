"""The objective of a beam optimisation (T fig. 9.3): a detector's confidence or an image metric, less the cost of light."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.simulation.world import LitScene
from luxloop.perception.camera import expose, luminance_of, noise_std
from luxloop.perception.detection.detector import SAME, Detector, overlaps
from luxloop.perception.detection.network import Network, NetworkDetector, boxes_of, middles, network_input
from luxloop.perception.metrics import edge_definition, unevenness, weber_contrast
from luxloop.perception.noise import FrameNoise
from luxloop.world.errors import LuxloopError
from luxloop.world.params import Params

Metric = Literal["detector", "weber_contrast", "edges"]
FAINTEST = 1e-6  # of a score, so that its logarithm stays finite
DAZZLING_LX = 1.0  # illuminance on eyes above which it counts as glare
SEEN = 0.3  # least visible share of an object that counts
LEAST_PX = 60


class BeamGoal(Params):
    """Weights of the loss: the negative mean logarithm of the objects' scores plus the cost of light."""

    metric: Metric = Field("detector", description="metric of the objects to maximise")
    energy: float = Field(2.0, ge=0, description="weight of the lamps' flux, as a share of all pixels on")
    unevenness: float = Field(0.0, ge=0, description="weight of the unevenness of light on objects: standard deviation over mean")
    glare: float = Field(0.1, ge=0, description="weight of each lx above 1 lx on heads and windscreens")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Effect of a light. scores: `[n]` of the objects; loss: total, with the scores' logarithm; share: flux as share of all pixels on."""

    scores: Tensor
    loss: Tensor
    share: Tensor
    luminance: Tensor


@dataclass(frozen=True, eq=False)
class BeamEvaluator:
    """A still scene in which beams are evaluated. detector: None for image metrics."""

    simulation: Simulation
    goal: BeamGoal
    detector: Detector | None
    scene: LitScene

    @classmethod
    def prepare(cls, simulation: Simulation, goal: BeamGoal, detector: Detector | None) -> "BeamEvaluator":
        """The scene at a simulation's start. Raises LuxloopError if no object that counts is in view."""
        evaluator = cls(simulation, goal, detector, simulation.world.lit(0.0))
        if not evaluator.masks:
            raise LuxloopError("objects: none with a category that counts is in the camera's view at the start; put one there")
        return evaluator

    @cached_property
    def masks(self) -> dict[str, Tensor]:
        """Pixels of the objects that count, by name: in sight, and of a class that the detector has."""
        ids, classes = self.scene.surfaces.object_id, None if self.detector is None else self.detector.classes
        return {
            each.name: ids == each.object_id
            for each in self.scene.objects
            if each.visible >= SEEN and each.pixels >= LEAST_PX and (classes is None or each.category in classes)
        }

    def frame(self, luminance: Tensor, step: int, quantise: bool = False) -> Tensor:
        """Digital numbers as a share of the largest, with the noise of a step."""
        camera, seed = self.simulation.scenario.camera, self.simulation.scenario.seed
        return expose(luminance, camera, FrameNoise.of(seed, step, 0), quantise=quantise) / (2**camera.bits - 1)

    def evaluate(self, lights: Sequence[Tensor], step: int = 0) -> Evaluation:
        """Differentiable in the utilisations `[n_p]`, one a module, if the metric is or the detector is the network."""
        illuminance, luminance = self.scene.light(lights)
        luminance = luminance + self.scene.base
        scores = self.scores(luminance, step)
        share = sum((u * module.flux).sum() for u, module in zip(lights, self.simulation.modules, strict=True)) / self._most_lm
        loss = -scores.clamp(min=FAINTEST).log().mean() + self.goal.energy * share
        if self.goal.unevenness:
            loss = loss + self.goal.unevenness * torch.stack([unevenness(illuminance, mask, 1.0) for mask in self.masks.values()]).mean()
        if self.goal.glare and bool(self.scene.eyes.any()):
            loss = loss + self.goal.glare * (illuminance[self.scene.eyes] - DAZZLING_LX).clamp(min=0).mean()
        return Evaluation(scores, loss, torch.as_tensor(share), luminance)

    def scores(self, luminance: Tensor, step: int) -> Tensor:
        """Of the objects, `[n]`."""
        camera = self.simulation.scenario.camera
        if self.goal.metric != "detector":
            measure: Callable[[Tensor, Tensor, float], Tensor] = weber_contrast if self.goal.metric == "weber_contrast" else edge_definition
            seen = luminance_of(expose(luminance.clone(), camera, quantise=False), camera)
            black = float(noise_std(torch.zeros(1), camera))
            return torch.stack([measure(seen, mask, black) for mask in self.masks.values()])
        if isinstance(self.detector, NetworkDetector) and luminance.requires_grad:
            return self._likeliest(self.detector.network, self.frame(luminance, step))
        return self.confidences(self.frame(luminance.detach(), step, quantise=True))

    def confidences(self, frame: Tensor) -> Tensor:
        """The detector's confidence in the objects, `[n]`: the best score of their class among boxes on them, 0 without one."""
        assert self.detector is not None
        found = self.detector.detect(frame[None])[0]
        boxes, scores = found.boxes.double().cpu(), found.scores.double().cpu()
        shows = overlaps(self.boxes, boxes) >= SAME
        of_class = scores[:, self._labels].T
        return torch.where(shows, of_class, 0.0).amax(1) if len(boxes) else torch.zeros(len(self.masks), dtype=torch.float64)

    def _likeliest(self, network: Network, frame: Tensor) -> Tensor:
        """The confidence before suppression, differentiable: the best score of cells whose boxes lie on an object."""
        logits, sides = network(network_input(frame[None]))
        scores = logits[0].flatten(1).sigmoid()
        boxes = boxes_of(sides)[0].flatten(1).T.detach().double().cpu()
        shows = overlaps(self.boxes, boxes) >= SAME
        rows, columns = logits.shape[-2:]
        x, y = middles(rows, columns, boxes.device).flatten(1)
        left, top, right, bottom = self.boxes.T[..., None]
        within = (x >= left) & (x <= right) & (y >= top) & (y <= bottom)  # cells inside an object that no box shows yet
        shows = torch.where(shows.any(1, keepdim=True), shows, within).to(scores.device)
        return torch.where(shows, scores[self._labels.to(scores.device)], 0.0).amax(1)

    @cached_property
    def boxes(self) -> Tensor:
        """Of the objects that count, `[n, 4]` px."""
        return torch.stack([box for each, box in zip(self.scene.objects, self.scene.boxes, strict=True) if each.name in self.masks])

    @cached_property
    def _labels(self) -> Tensor:
        assert self.detector is not None
        classes = list(self.detector.classes)
        return torch.tensor([classes.index(each.category) for each in self.scene.objects if each.category and each.name in self.masks])

    @cached_property
    def _most_lm(self) -> float:
        return float(sum(module.flux.sum() for module in self.simulation.modules))
