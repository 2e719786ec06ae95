"""The HD84 module: 84 Gaussian pixels in three unequal rows."""

from world.headlight import Headlight
from world.lamp import Module
from world.parametric import GaussianPixels
from world.presets.modules import headlight
from world.texels import TexelGrid

NOTES = """Published (thesis, T 2.4, 8.4): 3 x 28 pixels, +-20 x +-5 deg, rows of unequal height, pixels like Gaussians.
Guessed: all else; widths of the Gaussians by calibration."""

PIXELS = GaussianPixels(
    columns=28,
    left_deg=20,
    right_deg=-20,
    widening=1.0,
    row_centres_deg=(3.2, 0.5, -2.6),
    row_sigmas_deg=(1.3, 0.7, 1.3),
    column_sigma=0.6,
    peak_cd=(12_000, 30_000, 12_000),
)


def module(chromatic_shift: float = 0.0) -> Headlight:
    return headlight("hd84", PIXELS, TexelGrid.from_degrees(128, 512, 23, -23, -6.5, 6.5), chromatic_shift)


def modules(chromatic_shift: float = 0.0) -> tuple[Module, ...]:
    return (Module("matrix", module(chromatic_shift)),)
