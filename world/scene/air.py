"""Air with droplets: fog, haze and spray as one homogeneous medium."""

import math
from dataclasses import dataclass
from typing import Final

from pydantic import Field
from torch import Tensor

from luxloop.world.params import NotNegative, Params

CONTRAST: Final = 0.05  # that a black object keeps at the meteorological optical range


@dataclass(frozen=True)
class Medium:
    """Homogeneous air with droplets; asymmetry: mean cosine of the angle by which it scatters, -1 < g < 1, forward positive."""

    scattering_per_m: float
    extinction_per_m: float
    asymmetry: float = 0.8

    @classmethod
    def fog(cls, visibility_m: float) -> "Medium":
        """Droplets that absorb nothing; visibility_m: meteorological optical range, `-ln 0.05 / extinction` (Koschmieder)."""
        extinction = -math.log(CONTRAST) / visibility_m
        return cls(extinction, extinction)

    def transmittance(self, path: Tensor) -> Tensor:
        """Share `[...]` of light that passes straight paths `[3, ...]` in m (Lambert, Beer)."""
        return (path * path).sum(0).sqrt_().mul_(-self.extinction_per_m).exp_()  # far faster than `norm`

    def horizon(self, ambient_lx: float) -> float:
        """Luminance in cd/m^2 of an endless horizontal ray under an even sky (Koschmieder).

        Half of the light that is scattered into it comes from above, whatever the asymmetry: from a sky of luminance `E / pi`.
        """
        return self.scattering_per_m / self.extinction_per_m * ambient_lx / (2 * math.pi)


class AirParams(Params):
    """Visibility from one time on."""

    time_s: NotNegative = Field(0.0, description="start of this visibility, which holds until the next entry")
    visibility_m: float | None = Field(
        None,
        ge=10,
        le=100_000,
        examples=[100.0],
        description="meteorological optical range, at which a black object keeps 5 % of its contrast; left out: clear air",
    )
