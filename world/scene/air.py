"""Air with droplets: fog, rain and snow as one homogeneous medium, and the sizes of the drops and flakes that fall in it."""

import math
from dataclasses import dataclass
from typing import Final

import torch
from pydantic import Field
from torch import Tensor

from luxloop.world.params import NotNegative, Params

CONTRAST: Final = 0.05  # that a black object keeps at the meteorological optical range
NEAR_M: Final = 15.0  # up to which drops can be drawn one by one
LEAST_MM, LEAST_AT_M = 1.0, 5.0  # width of the least drop that is drawn, at a distance: about the noise of a camera at night


@dataclass(frozen=True)
class Precipitation:
    """Drops or flakes that fall, whose sizes are those D in mm of the drops that they are or melt into: `N(D) = number exp(-slope D)`.

    number_m3_mm, slope_mm: of that distribution, in 1/(m^3 mm) and 1/mm. width: a and b of their width `a D^b` in mm. fall: u, v, w of
    their speed `u - v exp(-w D)` in m/s. asymmetry: as of `Medium`.
    """

    number_m3_mm: float
    slope_mm: float
    width: tuple[float, float]
    fall: tuple[float, float, float]
    asymmetry: float

    @classmethod
    def rain(cls, rate_mm_h: float) -> "Precipitation":
        """Spheres of water. Sizes: Marshall and Palmer 1948. Speed: Atlas, Srivastava and Sekhon 1973 (Gunn and Kinzer's). Asymmetry: by
        which Henyey and Greenstein's function scatters straight back what a large sphere of refractive index 1.33 reflects in geometrical
        optics, `(0.02 + 0.98^2 * 0.02 * (1.33 / 0.67)^2) / 8 pi` of the extinction.
        """
        return cls(8000.0, 4.1 * rate_mm_h**-0.21, (1.0, 1.0), (9.65, 10.3, 0.6), 0.84)

    @classmethod
    def snow(cls, rate_mm_h: float) -> "Precipitation":
        """Dry aggregates. Sizes: Gunn and Marshall 1958. Width: of a density of `0.178 / width^0.922` g/cm^3 (Brandes et al. 2007). Speed:
        within 12 % of `0.8 width^0.16` (Locatelli and Hobbs 1974). Asymmetry: assumed.
        """
        width = 0.178 ** (-1 / 2.078), 3 / 2.078  # mass: D^3 = 0.178 width^(3 - 0.922)
        return cls(3800.0 * rate_mm_h**-0.87, 2.55 * rate_mm_h**-0.48, width, (1.4, 0.65, 0.4), 0.65)

    @property
    def extinction_per_m(self) -> float:
        """Twice the cross-section in a volume, since they are much larger than a wavelength; rain: `0.365 R^0.63` 1/km (Atlas 1953)."""
        a, b = self.width
        return math.pi / 2 * 1e-6 * self.number_m3_mm * a**2 * math.gamma(2 * b + 1) / self.slope_mm ** (2 * b + 1)

    def least_mm(self, range_m: Tensor) -> Tensor:
        """Size D `[...]` of the least that is drawn at a distance `[...]` m from an eye, since brightness falls with the distance."""
        a, b = self.width
        return (LEAST_MM / a) ** (1 / b) * (range_m / LEAST_AT_M) ** (1.5 / b)

    def drawn_per_m(self, range_m: Tensor) -> Tensor:
        """Extinction `[...]` by those that are drawn, at a distance `[...]` m from an eye."""
        order = torch.full_like(range_m, 2 * self.width[1] + 1)
        share = torch.special.gammaincc(order, self.slope_mm * self.least_mm(range_m))
        return self.extinction_per_m * share * (range_m < NEAR_M)


@dataclass(frozen=True)
class Medium:
    """Homogeneous air with droplets; asymmetry: mean cosine of the angle by which it scatters, -1 < g < 1, forward positive.

    falling: drops and flakes whose mean is part of the medium. drawn_only: whether it scatters by those alone that are drawn.
    """

    scattering_per_m: float
    extinction_per_m: float
    asymmetry: float = 0.8
    falling: tuple[Precipitation, ...] = ()
    drawn_only: bool = False

    @classmethod
    def fog(cls, visibility_m: float) -> "Medium":
        """Droplets that absorb nothing; visibility_m: meteorological optical range, `-ln 0.05 / extinction` (Koschmieder)."""
        extinction = -math.log(CONTRAST) / visibility_m
        return cls(extinction, extinction)

    def with_falling(self, *falling: Precipitation) -> "Medium":
        """The medium with drops and flakes in it that absorb nothing."""
        scattering = self.scattering_per_m, *(each.extinction_per_m for each in falling)
        asymmetry = self.asymmetry, *(each.asymmetry for each in falling)
        mean = sum(g * each for g, each in zip(asymmetry, scattering, strict=True)) / sum(scattering)
        return Medium(sum(scattering), self.extinction_per_m + sum(scattering[1:]), mean, falling)

    def scattering_at(self, range_m: Tensor) -> Tensor | float:
        """Scattering coefficient in 1/m at a distance `[...]` m from an eye."""
        if not self.drawn_only:
            return self.scattering_per_m
        return sum((each.drawn_per_m(range_m) for each in self.falling), torch.zeros_like(range_m))

    def transmittance(self, path: Tensor) -> Tensor:
        """Share `[...]` of light that passes straight paths `[3, ...]` in m (Lambert, Beer)."""
        return (path * path).sum(0).sqrt_().mul_(-self.extinction_per_m).exp_()  # far faster than `norm`

    def horizon(self, ambient_lx: float) -> float:
        """Luminance in cd/m^2 of an endless horizontal ray under an even sky (Koschmieder).

        Half of the light that is scattered into it comes from above, whatever the asymmetry: from a sky of luminance `E / pi`.
        """
        return self.scattering_per_m / self.extinction_per_m * ambient_lx / (2 * math.pi)


class AirParams(Params):
    """Fog, rain and snow from one time on."""

    time_s: NotNegative = Field(0.0, description="start of this air, which holds until the next entry")
    visibility_m: float | None = Field(
        None,
        ge=10,
        le=100_000,
        examples=[100.0],
        description="meteorological optical range of the fog, at which a black object keeps 5 % of its contrast; left out: no fog",
    )
    rain_mm_h: float = Field(0.0, ge=0, le=200, description="rain; 2: light, 5: moderate, 20: heavy")
    snow_mm_h: float = Field(0.0, ge=0, le=10, description="dry snow, as the water that it melts into; 1: light, 3: heavy")

    @property
    def medium(self) -> Medium | None:
        """None for clear air."""
        rates = (Precipitation.rain, self.rain_mm_h), (Precipitation.snow, self.snow_mm_h)
        falling = [kind(rate) for kind, rate in rates if rate > 0]
        fog = None if self.visibility_m is None else Medium.fog(self.visibility_m)
        return (fog or Medium(0.0, 0.0)).with_falling(*falling) if falling else fog
