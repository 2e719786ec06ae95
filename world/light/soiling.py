"""Dirt or ice on glass before a camera or a lamp: what passes straight, and what of the rest is scattered."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from luxloop.world.headlight import Headlight
from luxloop.world.params import Params, Seed, Share
from luxloop.world.spmv import row_of_entries
from luxloop.world.texels import resample

CELLS = 512  # of a map's side
SPREAD = 0.25  # of a spot's size, by which its edge is out of focus
COVER = 1.0  # tangent of the greatest angle, up and aside, of directions on a lamp's cover


class SoilingParams(Params):
    """Spots of dirt or ice on glass."""

    coverage: Share = Field(0.0, description="share of the glass that they cover")
    transmission: Share = Field(0.3, description="share of light that passes straight through where they cover it")
    absorption: Share = Field(
        0.7, description="share of the other light that is lost, scattered past the image, too; the rest is scattered within"
    )
    spot: float = Field(0.05, ge=0.005, le=1, description="size of the spots, as a share of the glass")
    seed: Seed = Field(0, description="seed of the spots")

    def through(self, luminance: Tensor) -> Tensor:
        """Luminance `[..., height, width]` in cd/m^2 of a whole image behind the glass.

        With the share s that does not pass straight, `(1 - s) L + (1 - absorption) s <L>`, `<L>` being the mean over the image by weight s:
        light is scattered from soiled directions into soiled ones. Without absorption the image keeps its light, and an even one does not
        change.
        """
        if self.coverage == 0 or self.transmission == 1:
            return luminance
        height, width = luminance.shape[-2:]
        passing = self._map(height, width, 0).to(luminance)
        lost = 1 - passing
        mean = (lost * luminance).sum((-2, -1), keepdim=True) / lost.sum()
        return passing * luminance + (1 - self.absorption) * lost * mean

    def cover(self, headlight: Headlight, number: int) -> Headlight:
        """A module behind the soiled cover of its lamp, which takes from each direction its share and scatters nothing into the texture.

        number: of the lamp, whose modules share a cover.
        """
        if self.coverage == 0:
            return headlight
        y, z = headlight.tangents(torch.float32)
        across, down = (-y / COVER).expand(len(z), -1), (-z / COVER)[:, None].expand(-1, len(y))
        passing = resample(self._map(CELLS, CELLS, number)[None, None], across[None], down[None], "border")[0, 0]
        matrix = headlight.matrix
        return replace(headlight, matrix=matrix.with_values(matrix.values * passing.flatten().to(matrix.values)[row_of_entries(matrix)]))

    def _map(self, height: int, width: int, number: int) -> Tensor:
        return transmission(self.coverage, self.transmission, self.spot, height, width, self.seed, number)


@lru_cache(8)
def transmission(coverage: float, through: float, spot: float, height: int, width: int, *seed: int) -> Tensor:
    """Share of light that passes glass straight, `[height, width]` float32: smooth noise over a threshold, blurred; opposite edges match.

    Its mean is `1 - coverage (1 - through)`, to a pixel.
    """
    noise = np.random.default_rng(seed).standard_normal((height, width))
    smooth = _blur(noise, spot * width / 2)
    covered = (smooth > np.quantile(smooth, 1 - coverage)) if coverage < 1 else np.ones_like(smooth)
    return torch.from_numpy(1 - (1 - through) * _blur(covered, SPREAD * spot * width)).clamp(0, 1).float()


def _blur(image: np.ndarray, sigma_px: float) -> np.ndarray:
    """A periodic Gaussian blur, which keeps the mean."""
    frequency = np.hypot(np.fft.fftfreq(image.shape[0])[:, None], np.fft.rfftfreq(image.shape[1])[None])
    return np.fft.irfft2(np.fft.rfft2(image) * np.exp(-2 * (np.pi * sigma_px * frequency) ** 2), image.shape)
