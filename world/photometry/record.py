"""What a photometric file says besides its intensities."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from luxloop.world.photometry.distribution import Distribution


@dataclass(frozen=True, eq=False)
class Tilt:
    """How the output of a lamp falls with its tilt: offered, never applied to the candela."""

    geometry: int  # 1 base up or down at nadir, 2 lamp stays horizontal, 3 lamp tilts with the luminaire
    angles_deg: NDArray[np.float64]
    factors: NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Photometry:
    """A photometric file, read."""

    path: Path
    format: str  # "LM-63-2002", "EULUMDAT"
    distribution: Distribution
    luminaire: str = ""
    lamps: int = 1
    lumens_per_lamp: float | None = None  # None: absolute photometry, the candela are as measured
    watts: float = 0.0
    size_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # width, length, height of the opening; negative where round
    feet: bool = False  # the file's own unit of length
    multiplier: float = 1.0  # of the candela, already applied, as is the ballast factor
    ballast_factor: float = 1.0  # until 1991 with the ballast-lamp factor
    field_12: float = 1.0  # LM-63's number after the ballast factor: until 1991 the ballast-lamp factor, later not applied
    tilt: str = "NONE"
    tilt_factors: Tilt | None = None
    keywords: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def absolute(self) -> bool:
        return self.lumens_per_lamp is None
