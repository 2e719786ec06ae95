"""The human eye: veil of disability glare, and pictures on a display by exposure, tone curve and smooth edges."""

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample, pad

from luxloop.world.frames import View, unit
from luxloop.world.headlight.matrix import LUMINANCE

CORE_DEG = 0.1  # least angle of the CIE's equation
PIGMENT = 0.5  # of brown eyes; 0 black, 1.2 light blue
SATURATION_CD_M2 = 1.2  # luminance in cd/m^2 that saturates an image at EV 0 (ISO 12232)
BRIGHT = 0.98  # share of the first picture that its exposure does not saturate
DARKEST = 1e-3  # luminance in cd/m^2, of a moonless night
EDGE = 0.06  # least contrast of an edge that is smoothed, of the picture's white


def veil_per_lux(theta_deg: Tensor, age_years: float) -> Tensor:
    """Veiling luminance in cd/m^2 for each lux at the eye from a point source at an angle from where it looks:
    `10/θ³ + (5/θ² + 0.1p/θ)(1 + (A/62.5)⁴) + 0.0025p`, θ in deg (CIE 146:2002, general disability glare). age_years: A.
    """
    theta = theta_deg.clamp(min=CORE_DEG)
    older = 1 + (age_years / 62.5) ** 4
    return 10 / theta**3 + (5 / theta**2 + 0.1 * PIGMENT / theta) * older + 0.0025 * PIGMENT


def veil(view: View, sources: Tensor, eye_lx: Tensor, age_years: float) -> Tensor:
    """Veiling luminance `[height, width]` in cd/m^2 about point sources.

    sources: `[3, n]` m, world. eye_lx: `[n]`, illuminance at the eye from each. age_years: as of `veil_per_lux`.
    """
    rays = unit(view.rays().flatten(1).float())
    total = rays.new_zeros(rays.shape[1])
    for source, lx in zip(unit(sources - view.origin[:, None]).float().T, eye_lx.tolist(), strict=True):
        theta = torch.rad2deg(2 * torch.asin(((rays - source[:, None]).square().sum(0).sqrt() / 2).clamp(max=1)))
        total += lx * veil_per_lux(theta, age_years)
    return total.view(view.height, view.width)


def threshold_increment(veil_cd_m2: float, adaptation_cd_m2: float) -> float:
    """Increase in % of the contrast at which an object is just seen, `TI = 65 L_v / L^0.8` (CIE 31, EN 13201-3) for an adaptation
    luminance L of 0.05 to 5 cd/m^2.
    """
    return 65 * veil_cd_m2 / adaptation_cd_m2**0.8


PROBABILITY = 2.6  # Adrian's factor k, for a probability of detection of 99.9 %
SCOTOPIC, MESOPIC = 0.00418, 0.6  # cd/m^2, limits of the ranges of Adrian's fits


def threshold_difference(background: Tensor, size_arcmin: Tensor, darker: Tensor, age_years: float = 25.0, seen_s: float = 0.2) -> Tensor:
    """Luminance difference in cd/m^2 at which a target is just seen, in the shape of its arguments (W. Adrian, "Visibility of targets:
    model for calculation", Lighting Research and Technology 21, 1989): `k (sqrt(Phi) / size + sqrt(L))^2` by Ricco's and Weber's laws, with
    factors for targets darker than their background (0.5 in the scotopic range, as in IES RP-8), for the time that they are seen, and for
    the age.

    background: luminance that the eye is adapted to, from 1e-4 cd/m^2 on, with the veil. size_arcmin: below 60. darker: bool. age_years: 23
    to 64.
    """
    log = background.log10()
    day, night = background >= MESOPIC, background <= SCOTOPIC
    ricco = torch.where(night, 0.028 + 0.173 * log, -0.072 + 0.3372 * log + 0.0866 * log**2)
    ricco = torch.where(day, (4.1925 * background**0.1556).log10() + 0.1684 * background**0.5867, 10**ricco)
    weber = torch.where(night, -0.891 + 0.5275 * log + 0.0227 * log**2, -1.256 + 0.319 * log)
    weber = torch.where(day, 0.05946 * background**0.466, 10**weber)
    brighter = PROBABILITY * (ricco / size_arcmin + weber) ** 2
    polarity = 10 ** -(10 ** -(torch.where(background >= 0.1, 0.125, 0.075) * (log + 1) ** 2 + 0.0245))
    polarity = 1 - polarity * size_arcmin ** (-0.6 * background**-0.1488) / (2.4 * brighter)
    polarity = polarity.where(background > SCOTOPIC, 0.5)
    size, level = size_arcmin.log10() + 0.523, log + 6
    of_size = 0.36 - 0.0972 * size**2 / (size**2 - 2.513 * size + 2.7895)
    of_level = 0.355 - 0.1217 * level**2 / (level**2 - 10.4 * level + 52.28)
    time = 1 + (of_size**2 + of_level**2).sqrt() / (2.1 * seen_s)
    age = (age_years - 19) ** 2 / 2160 + 0.99
    return age * time * torch.where(darker, polarity * brighter, brighter)


def exposure_of(light: Tensor) -> float:
    """Exposure value at which nearly all of light `[3, H, W]` in cd/m^2 keeps its contrast."""
    bright = np.quantile((light.movedim(0, -1) @ light.new_tensor(LUMINANCE)).cpu().numpy(), BRIGHT)
    return math.log2(max(float(bright), DARKEST) / SATURATION_CD_M2)


def develop(light: Tensor, exposure_ev: float) -> Tensor:
    """sRGB picture `[3, H, W]` in 0..1 of light `[3, H, W]` in cd/m^2, linear sRGB.

    Each colour's largest channel goes through the curve `x / (1 + x)` (Reinhard et al. 2002), x being 1 at the exposure's saturation: no
    edge shows where a glare becomes too bright for the display, and hue is kept.
    """
    exposed = light.clamp(min=0) / (SATURATION_CD_M2 * 2**exposure_ev)
    linear = exposed / (1 + exposed.amax(0))
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clamp(min=1e-9) ** (1 / 2.4) - 0.055)


def smooth(picture: Tensor) -> Tensor:
    """A picture `[3, H, W]` whose stairs along edges are blended, square to the gradient (after FXAA, Lottes 2009)."""
    grey = (picture.new_tensor(LUMINANCE)[:, None, None] * picture).sum(0)
    around = pad(grey[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]
    nw, ne, sw, se = around[:-2, :-2], around[:-2, 2:], around[2:, :-2], around[2:, 2:]
    along = torch.stack([sw + se - nw - ne, nw + sw - ne - se])  # (du, dv) along the edge
    corners = torch.stack([nw, ne, sw, se, grey])
    contrast = corners.amax(0) - corners.amin(0)
    along = (along / along.abs().amin(0).clamp(min=0.03)).clamp(-4, 4) * (contrast > EDGE)
    height, width = grey.shape
    v, u = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    blended = torch.zeros_like(picture)
    for share in (-0.5, -1 / 6, 1 / 6, 0.5):
        places = torch.stack([2 * (u + share * along[0]) / width - 1, 2 * (v + share * along[1]) / height - 1], -1)
        blended += grid_sample(picture[None], places[None], padding_mode="border", align_corners=False)[0] / 4
    return blended
