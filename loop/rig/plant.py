"""The rig as a plant of the loop: it shows exposures, and assigns pictures to them."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.limits import Limited
from luxloop.loop.rig.rig import Rig
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame
from luxloop.loop.simulation.truth import LampModule


@dataclass(frozen=True, eq=False)
class RigPlant:
    """Shows light on a rig. It has no state, since hardware cannot return to an earlier one, and does not know the truth.

    Its clock is `time.monotonic`. grids: rows and columns of the modules' pixels. like: gives dtype and device of frames. last: number of
    the exposure after which the lamp is dark. look: gets each exposure with its image, None if it is lost.
    """

    rig: Rig
    grids: tuple[tuple[int, int], ...]
    like: Tensor
    last: int
    look: Callable[[Exposure, Tensor | None], None] = lambda exposure, image: None

    @classmethod
    def of(cls, rig: Rig, modules: Sequence[LampModule], exposures: int) -> "RigPlant":
        """The plant of an open rig. modules: of the scenario's lamps. exposures: number of exposures of the run."""
        return cls(rig, grids_of(modules), modules[0].headlight.matrix.values, exposures - 1)

    def start(self) -> tuple[None, Arrivals]:
        """The initial state: nothing is lit."""
        return None, Arrivals(time.monotonic(), samples=self.rig.ego.samples(self.like))

    def show(self, state: None, exposure: Exposure) -> tuple[None, Arrivals]:
        """Show an exposure, at least for its duration, until a frame of its light alone has arrived or counts as lost."""
        pictures = tuple(_picture(light, grid) for light, grid in zip(exposure.lights, self.grids, strict=True))
        given, taken = self.rig.expose(Shine(exposure.number, pictures, exposure.commands), exposure.duration_s)
        if taken.image is None:
            frame = Frame(exposure.number, math.nan, math.nan, None)
        else:
            taken_s = max(taken.sent_s, taken.arrived_s - self.rig.params.timing.latency_s)
            image = torch.from_numpy(taken.image).to(self.like)
            frame = Frame(exposure.number, taken_s, taken.arrived_s, image, None if given.whole else self._shown(exposure, given))
        self.look(exposure, frame.image)
        if exposure.number == self.last:
            self.rig.dark("the run has ended")
        samples = self.rig.ego.samples(self.like)
        return state, Arrivals(time.monotonic(), (frame,), samples)

    def _shown(self, exposure: Exposure, given: Limited) -> Exposure:
        """The exposure as the limits let it be."""
        lights = tuple(
            Utilisation(torch.from_numpy(u.ravel()).to(each.u)) for u, each in zip(given.shine.pictures, exposure.lights, strict=True)
        )
        return replace(exposure, lights=lights, commands=given.shine.commands)


def grids_of(modules: Sequence[Any]) -> tuple[tuple[int, int], ...]:
    """Rows and columns of the pixels of each module."""
    return tuple((each.headlight.pixel_rows, each.headlight.pixel_cols) for each in modules)


def _picture(light: Utilisation, grid: tuple[int, int]) -> np.ndarray:
    """What can be shown of it: the limits would count light below 0 against that of other pixels."""
    return light.u.detach().to("cpu", torch.float32).nan_to_num(0.0).clamp(0, 1).numpy().reshape(grid)
