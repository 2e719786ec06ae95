"""A scene in any light."""

from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.loop.studies.training.light import luminance
from luxloop.loop.studies.training.scenes import CAMERA, DarkScene, SceneObject
from luxloop.perception.camera import expose
from luxloop.perception.noise import FrameNoise


@dataclass(frozen=True)
class Lit:
    """A scene that no detector was trained on."""

    scene: DarkScene

    def frame(self, lx: float) -> Tensor:
        """Where every surface that faces the lamps gets so many lx, noise and all, `[1, height, width]` in 0..1."""
        return expose(luminance(self.scene, lx), CAMERA, FrameNoise(1))[None] / (2**CAMERA.bits - 1)

    @property
    def clear(self) -> list[SceneObject]:
        """Those that are easily seen."""
        return [each for each in self.scene.objects if each.visible > 0.9 and each.inside > 0.9 and each.height > 40]

    def boxes(self, label: int) -> Tensor:
        """Of those that are easily seen, of a class."""
        return torch.tensor([each.box for each in self.clear if each.label == label])
