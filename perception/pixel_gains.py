"""Gains of a lamp's pixels, estimated from what the camera sees of the own light on the road.

In a pair of frames each pixel is brighter in one and darker in the other, by a code of its own. The ratio of both frames hardly
depends on the road's albedo and slope, and the codes of neighbours are orthogonal, so that pixels are distinguished whose light overlaps.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor
from torch.nn.functional import unfold

from luxloop.perception.camera import CameraParams, luminance_of, noise_std, saturation_luminance
from luxloop.world.frames import View, inverse, transform
from luxloop.world.headlight import Headlight
from luxloop.world.light.illumination import lux_per_cd
from luxloop.world.params import Params
from luxloop.world.rendering.gbuffer import flat_road
from luxloop.world.spmv import Csr, multiply
from luxloop.world.texels import resample

WIDE: Final = 6  # rows and columns of pixels after which codes repeat, farther than a pixel's light
MODULES, PERIOD = 14, 512  # modules, and steps, after which they repeat
NEAREST_M, FARTHEST_M = 5.0, 60.0  # of road that counts
SATURATED: Final = 0.01  # below the greatest luminance, where frames do not count
LEAST_LIGHT: Final = 0.1  # of the expected luminance, below which something else than the road is seen
ROAD: Final = 0.05  # standard deviation of the ratio of both frames by the road between them
STRIPE_DEG, STRIPE_LIGHTS = 0.25, 24.0  # height, and width in pixels' lights, of surroundings whose mean is taken off: slopes across
OUTLIER: Final = 5.0  # standard deviations at which a pixel counts half
NEIGHBOURS: Final = (5, 25)  # rows and columns of pixels whose median response is that of a good one
LEAST: Final = 5  # of these that must be seen
KNOWN: Final = 0.15  # largest standard deviation of a gain that counts as known
DEAD: Final = 0.25  # relative response of a dead pixel, since the mean that is taken off holds a part of it
WORN: Final = 0.8  # relative response below which a pixel has worn
SURE: Final = 3.0  # standard deviations
ROUNDS: Final = 3
TEXELS: Final = 6  # across the light of a pixel


class PixelGainParams(Params):
    """Estimation of what each pixel still gives, and compensation by others."""

    swing: float = Field(
        0.3, gt=0, le=0.5, description="share of its light by which a pixel is brighter in one frame of a pair and darker in the other"
    )
    update_s: float = Field(10.0, gt=0, le=3600, description="time from one compensation for the estimated gains to the next")


@dataclass(frozen=True, eq=False)
class Sight:
    """A frame and its light. image: digital numbers `[height, width]`. view: of the camera, T_ground_headlights: poses `[4, 4]` of the
    modules, both in the ground frame of that time. lights: utilisations `[n_p]`, one a module.
    """

    image: Tensor
    view: View
    T_ground_headlights: Sequence[Tensor]
    lights: Sequence[Tensor]


@dataclass(frozen=True, eq=False)
class PixelGains:
    """Gains of a module's pixels, all `[n_p]`: light relative to that of a new pixel.

    response: sum of measured gains times their information. information: 1 / variance if the noise were that of the camera alone.
    light: sum of the utilisations times the information.
    gain: 1 for pixels that have not worn or are not known. std: standard deviation, infinite where the road does not show a pixel.
    """

    response: Tensor
    information: Tensor
    light: Tensor
    gain: Tensor
    std: Tensor

    @classmethod
    def unknown(cls, headlight: Headlight) -> "PixelGains":
        """Nothing is known, all pixels count as new."""
        nothing = torch.zeros(headlight.n_pixels).to(headlight.matrix.values)
        return cls(nothing, nothing, nothing, nothing + 1, nothing + torch.inf)

    @property
    def known(self) -> Tensor:
        """Pixels with a known gain, `[n_p]` bool."""
        return self.std <= KNOWN

    @property
    def worn(self) -> Tensor:
        """Pixels that have lost light for sure, `[n_p]` bool."""
        return self.gain < 1


def code(headlight: Headlight, module: int, step: int) -> Tensor:
    """1 or -1 for each pixel `[n_p]`: whether it is brighter in the first or the second frame of a step.

    Walsh functions: over PERIOD steps all pixels of a block of WIDE x WIDE are orthogonal, and those of MODULES modules; of the first three
    over a quarter of it.
    """
    row, column = np.divmod(np.arange(headlight.n_pixels), headlight.pixel_cols)
    word = 1 + WIDE**2 * (module % MODULES) + row % WIDE * WIDE + column % WIDE & step % PERIOD
    for half in (8, 4, 2, 1):
        word ^= word >> half
    return 1 - 2 * torch.from_numpy(word & 1).to(headlight.matrix.values)


def swing(u: Tensor, codes: Tensor, share: float) -> tuple[Tensor, Tensor]:
    """Utilisations `[n_p]` of both frames of a pair, with the mean u."""
    change = codes * torch.minimum(share * u, 1 - u)
    return u + change, u - change


class GainEstimator:
    """Estimates the gains of modules, which share a camera."""

    def __init__(self, headlights: Sequence[Headlight], camera: CameraParams) -> None:
        self.headlights, self.camera = tuple(each.coarsen(TEXELS) for each in headlights), camera
        widths = [each.pixel_extent[1] * (each.left - each.right) / each.cols for each in self.headlights]
        self._stripe = math.radians(STRIPE_DEG), STRIPE_LIGHTS * max(widths)
        self._squares: list[Csr] = [each.matrix.with_values(each.matrix.values.square()).transpose for each in self.headlights]

    def look(self, gains: Sequence[PixelGains], first: Sight, second: Sight, T_first_second: Tensor) -> tuple[PixelGains, ...]:
        """Gains with what one pair of frames tells of them. T_first_second: `[4, 4]`, second ground frame in the first."""
        means, changes = zip(*(((a + b) / 2, (a - b) / 2) for a, b in zip(first.lights, second.lights, strict=True)), strict=True)
        road = flat_road(first.view, 1.0)
        ahead = road.position[0].flatten()
        pixel = torch.nonzero((ahead > NEAREST_M) & (ahead < FARTHEST_M))[:, 0]
        place, normal = (each.flatten(1)[:, pixel].to(first.image.device) for each in (road.position, road.normal))
        pixel = pixel.to(first.image.device)
        then = transform(inverse(T_first_second).to(place), place)  # the same points in the second ground frame
        reach = self._reach(place, normal, first), self._reach(then, normal, second)
        seen = luminance_of(first.image, self.camera).flatten()[pixel]
        seen_then = self._at(luminance_of(second.image, self.camera), then, second.view)
        mean, mean_then = (self._light(each, means) for each in reach)
        one, other = seen / mean, seen_then / mean_then  # by what surfaces reflect; infinite or NaN out of the light
        most = (1 - SATURATED) * saturation_luminance(self.camera)
        reached = (mean > 0) & (mean_then > 0) & (seen_then > 0) & (seen < most) & (seen_then < most)
        if not bool(reached.any()):
            return tuple(gains)
        valid = reached & (one + other > LEAST_LIGHT * (one + other)[reached].median())
        expected = (self._light(reach[0], changes) / mean + self._light(reach[1], changes) / mean_then) / 2
        residual = self._without_stripes(torch.where(valid, (one - other) / (one + other) - expected, 0.0), valid, pixel, first.view)
        variance = ROAD**2 + (noise_std(seen, self.camera) / seen).square() / 2
        spread = (residual.square() / variance)[valid].median() / 0.455  # median of a standard normal number's square
        far = residual.square() / (OUTLIER**2 * spread * variance)
        weight = torch.where(valid, 1 / (variance * spread * (1 + far)), 0.0)
        return tuple(
            self._update(k, each, (means[k], changes[k]), texel, torch.where(valid, factor / mean, 0.0), weight, residual)
            for k, (each, (texel, factor)) in enumerate(zip(gains, reach[0], strict=True))
        )

    def _update(
        self, k: int, gains: PixelGains, lights: tuple[Tensor, Tensor], texel: Tensor, share: Tensor, weight: Tensor, residual: Tensor
    ) -> PixelGains:
        """Gains with one pair. lights: mean utilisations and their changes `[n_p]`."""
        light, (u, change) = self.headlights[k], lights
        empty = share.new_zeros(light.n_texels)
        correlation = change * multiply(light.matrix.transpose, empty.index_add(0, texel, share * weight * residual))
        information = change.square() * multiply(self._squares[k], empty.index_add(0, texel, share.square() * weight))
        return replace(
            gains,
            response=gains.response + correlation + information,
            information=gains.information + information,
            light=gains.light + information * u,
        )

    def _reach(self, place: Tensor, normal: Tensor, sight: Sight) -> list[tuple[Tensor, Tensor]]:
        """For each module the nearest texel `[N]` of points `[3, N]` of the road, and `cos / d^2` `[N]`, 0 out of its reach."""
        found = []
        for light, T in zip(self.headlights, sight.T_ground_headlights, strict=True):
            x, y, z = transform(inverse(T).to(place), place)
            row, column = (each.nan_to_num(-1.0, -1.0, -1.0).floor() for each in light.texel_of(y / x, z / x))
            inside = (x > 0) & (row >= 0) & (row < light.rows) & (column >= 0) & (column < light.cols)
            texel = torch.where(inside, row * light.cols + column, 0.0).long()
            found.append((texel, inside * lux_per_cd(T[:3, 3:].to(place) - place, normal)))
        return found

    def _light(self, reach: Sequence[tuple[Tensor, Tensor]], lights: Sequence[Tensor]) -> Tensor:
        """Illuminance `[N]` of points by all modules. lights: utilisations or their changes `[n_p]`, one a module."""
        parts = zip(self.headlights, reach, lights, strict=True)
        return torch.stack([factor * light.light_texture(u).flatten()[texel] for light, (texel, factor), u in parts]).sum(0)

    @staticmethod
    def _at(image: Tensor, place: Tensor, view: View) -> Tensor:
        """An image `[height, width]` at points `[3, N]`, 0 beyond its border."""
        (u, v), depth = view.project(place.double())
        u, v = (torch.where(depth > 0, 2 * each / n - 1, 2.0).to(image) for each, n in ((u, view.width), (v, view.height)))
        return resample(image[None, None], u[None, None], v[None, None])[0, 0, 0]

    def _without_stripes(self, residual: Tensor, valid: Tensor, pixel: Tensor, view: View) -> Tensor:
        """Residuals `[N]` less the mean of their valid surroundings. pixel: `[N]`, flat image index."""
        high, wide = (2 * round(min(each * view.fx, view.width) / 2) + 1 for each in self._stripe)
        image = residual.new_zeros(view.height * view.width, 2).index_copy(0, pixel, torch.stack([residual, valid.to(residual)], -1))
        shape = view.height, view.width, 2
        mean = cv2.blur(image.view(shape).cpu().numpy(), (wide, high), borderType=cv2.BORDER_CONSTANT)
        total, count = torch.from_numpy(mean).to(residual).flatten(0, 1)[pixel].unbind(-1)
        return torch.where(valid, residual - total / count.clamp(min=1e-9), 0.0)


def decide(headlight: Headlight, gains: PixelGains) -> PixelGains:
    """Gains and their standard deviations from all responses so far.

    A response is relative to the light around it, of which worn pixels lack their part; most pixels nearby are good.
    """
    known = gains.information > 0
    raw = torch.where(known, gains.response / gains.information.where(known, 1.0), 1.0)
    u = torch.where(known, gains.light / gains.information.where(known, 1.0), 0.0)
    nominal = gains.information.clamp(min=1e-12).rsqrt()
    new, transposed = headlight.light_texture(u).flatten(), headlight.matrix.transpose
    of_pixel = multiply(transposed, torch.ones_like(new)).clamp(min=1e-9)
    usable, gain = known & (u > 0), torch.ones_like(raw)
    noisier = (nominal / _local_median(nominal.where(usable, torch.nan), headlight)).clamp(min=1)  # than the pixels around
    for _ in range(ROUNDS):
        left = headlight.light_texture(gain * u).flatten() / new.clamp(min=1e-9)
        around = multiply(transposed, left.where(new > 0, 1.0)) / of_pixel
        good = raw * around
        relative = good / _local_median(good.where(usable, torch.nan), headlight).clamp(min=1e-3)
        scatter = 1.4826 * _local_median((relative - 1).abs().where(usable, torch.nan), headlight)
        std = (scatter * noisier).maximum(nominal).where(usable, torch.nan).nan_to_num(torch.inf)
        worn = (std <= KNOWN) & (relative < WORN) & (1 - relative > SURE * std)
        gain = torch.where(worn, ((relative - DEAD) / (1 - DEAD)).clamp(0, 1), 1.0)
    return replace(gains, gain=gain, std=std)


def _local_median(values: Tensor, headlight: Headlight) -> Tensor:
    """Median `[n_p]` of the pixels around each that are not NaN, of fewer in lamps of few, whose rows differ; NaN for less than LEAST."""
    rows, columns = min(NEIGHBOURS[0], headlight.pixel_rows // 16 * 2 + 1), min(NEIGHBOURS[1], headlight.pixel_cols // 6 * 2 + 1)
    grid = values.view(1, 1, headlight.pixel_rows, headlight.pixel_cols)
    around = unfold(torch.nn.functional.pad(grid, (columns // 2, columns // 2, rows // 2, rows // 2), value=torch.nan), (rows, columns))[0]
    return around.nanmedian(0).values.where((~around.isnan()).sum(0) >= LEAST, torch.nan)
