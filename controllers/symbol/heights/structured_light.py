"""The road from structured light (T 3.5.2): Gray codes over the lamp's pixel rows tell each camera pixel which of them lights it."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.symbol.heights.forward_model import ForwardModel
from luxloop.controllers.symbol.heights.height_map import HeightMap
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import Observation
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.perception.birdseye import Region

CELL_M = (0.15, 0.1)
HIGHEST_M = 0.2  # farther up or down is a wrong code
SMOOTHING = ((1.0, 1.5), (1e-3, 8.0))  # weight and standard deviation in cells: what is seen, and what fills its gaps


@dataclass(frozen=True)
class StructuredLightState:
    """next: number of the pattern that is shown. seen: contrast `[h, w]` in cd/m^2 of each pattern, None where it is still missing."""

    next: int
    seen: tuple[Tensor | None, ...]

    @property
    def complete(self) -> bool:
        """Whether every pattern was seen."""
        return all(each is not None for each in self.seen)


class StructuredLight:
    """Shows each pattern and its inverse once, with the first module that draws, and triangulates."""

    def __init__(self, sensor: SymbolSensor, region: Region) -> None:
        modules = sensor.projector.modules
        self.headlight = modules[0].pixel_controller.headlight
        self.forward_model = ForwardModel.prepare(sensor, region, CELL_M, 2, 1)
        rows = self.headlight.pixel_rows
        codes = cv2.structured_light.GrayCodePattern.create(1, rows).generate()[1]
        others = tuple(each.pixel_controller.default for each in modules[1:])
        stripes = [self._stripes(code) for code in codes]
        self.patterns = tuple(ProjectionCommand(sensor.projector.target, raw=(u, *others)) for u in stripes)
        whole = stripes[0] + stripes[1] - 2 * modules[0].pixel_controller.default
        self.lit = (
            self.headlight.light_texture(whole),
            *(each.pixel_controller.headlight.light_texture(0 * each.pixel_controller.default) for each in modules[1:]),
        )

    def start(self) -> StructuredLightState:
        """Nothing seen."""
        return StructuredLightState(0, (None,) * len(self.patterns))

    def projection(self, state: StructuredLightState) -> ProjectionCommand:
        """The pattern that is shown next."""
        return self.patterns[state.next]

    def step(self, state: StructuredLightState, observation: Observation) -> StructuredLightState:
        """Keep what the frames show; go round what is still missing, since frames may be late or lost."""
        seen = list(state.seen)
        for k, pattern in enumerate(self.patterns):
            if observation.frames is not None and observation.shown.projection.shows(pattern):
                seen[k] = self.forward_model.observe(observation.frames)[0]
        after = [(state.next + 1 + k) % len(seen) for k in range(len(seen))]
        return replace(state, seen=tuple(seen), next=next((k for k in after if seen[k] is None), state.next))

    def relief(self, state: StructuredLightState) -> HeightMap:
        """The road that a complete survey has found."""
        contrasts = torch.stack([each for each in state.seen if each is not None])
        bits = (contrasts[0::2] > contrasts[1::2]).long()
        binary = bits.cumsum(0) % 2  # from Gray code
        row = (binary * (2 ** torch.arange(len(bits) - 1, -1, -1, device=bits.device))[:, None, None]).sum(0)
        lamp, forward_model = self.forward_model.lamps[0], self.forward_model
        rise = self._rise(row)
        height = (rise * lamp.on_plane[0] - lamp.on_plane[2]) / (lamp.per_m[2] - rise * lamp.per_m[0])
        lit = contrasts[0] + contrasts[1]
        usable = (height.abs() < HIGHEST_M) & (lit > 0.2 * lit.median()) & (forward_model.inside > 0)
        heights = self._smooth(torch.where(usable, height, 0.0), usable.to(height))
        expected = forward_model.luminance(self.lit, forward_model.on_pixels(heights.flatten())[None])[0] * usable
        return HeightMap(forward_model.region, forward_model.eye, heights, self._smooth(lit * usable, expected))

    def _smooth(self, values: Tensor, weights: Tensor) -> Tensor:
        """Sum of values over sum of weights, both `[h, w]`, around each node: `[rows, cols]`."""
        from kornia.filters import gaussian_blur2d

        found = self.forward_model.on_nodes(torch.stack([values, weights])).view(1, 2, self.forward_model.rows, self.forward_model.cols)
        parts = [
            share * gaussian_blur2d(found, (2 * int(3 * sigma) + 1,) * 2, (sigma, sigma), border_type="replicate")[0]
            for share, sigma in SMOOTHING
        ]
        above, below = torch.stack(parts).sum(0)
        return above / below.clamp(min=1e-12)

    def _stripes(self, code: np.ndarray) -> Tensor:
        like = self.headlight.matrix.values
        lit = torch.from_numpy(code[:, 0] > 0).to(like)
        return lit[:, None].expand(-1, self.headlight.pixel_cols).flatten()

    def _rise(self, row: Tensor) -> Tensor:
        """z over x in the lamp's frame of the light of pixel rows `[h, w]`, by where their light is in its texture."""
        light = self.headlight
        number = torch.arange(light.pixel_rows).to(light.matrix.values)[:, None].expand(-1, light.pixel_cols).flatten()
        weighted, whole = (light.light_texture(u).sum(-1).cpu() for u in (number, torch.ones_like(number)))
        mean = (weighted / whole.clamp(min=1e-9))[whole > 0]
        texel = torch.arange(light.rows)[whole > 0] + 0.5
        rise = light.top + (light.bottom - light.top) * texel / light.rows
        order = mean.argsort()
        return torch.from_numpy(np.interp(row.cpu().numpy(), mean[order].numpy(), rise[order].numpy())).to(self.forward_model.inside)
