"""A photometric file as a lamp in its far field, without a light texture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from luxloop.world.headlight.lamp import Lamp
from luxloop.world.headlight.pixel_sources import FileSource
from luxloop.world.lampfiles.modules import warn_of_oddities
from luxloop.world.photometry import Distribution


@dataclass(frozen=True, kw_only=True)
class MeasuredLamp(Lamp):
    """A lamp of one pixel whose intensity is its file's, interpolated between the file's own angles; it has no module to render.

    mirrored: the lamp of the right side, whose light is that of the left one mirrored.
    """

    distribution: Distribution
    mirrored: bool = False

    def beam(self, name: str) -> tuple[Tensor, ...]:
        """As of Lamp, `full` or `off`: the utilisation `[1]` of the pixel."""
        return (torch.ones(1) if name == "full" else torch.zeros(1),) if name in ("full", "off") else super().beam(name)

    def lit(self, utilisations: Sequence[Tensor]) -> Callable[[Tensor], Tensor]:
        """As of Lamp."""
        share, sides = float(utilisations[0]), np.array([1.0, -1.0 if self.mirrored else 1.0, 1.0])
        return lambda directions: share * torch.from_numpy(self.distribution.intensity(directions.double().numpy() * sides[:, None]))


def measured_lamp(path: Path, side: str) -> MeasuredLamp:
    """The lamp of a photometric file. Raises LuxloopError where it cannot be read; warns of what is odd in it."""
    source = FileSource(path=path)
    array = source.pixels()
    warn_of_oddities(source, array)
    return MeasuredLamp(path.stem, (), distribution=array.pixels[0].distribution, mirrored=side == "right")
