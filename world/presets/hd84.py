"""The HD84 module: 84 Gaussian pixels in three unequal rows."""

from luxloop.world.headlight import Headlight
from luxloop.world.headlight.parametric import GaussianPixels
from luxloop.world.presets.modules import headlight
from luxloop.world.texels import TexelGrid

NOTES = """Published (thesis, T 2.4, 8.4): 3 x 28 pixels, +-20 x +-5 deg, rows of unequal height, pixels like Gaussians.
Guessed: all else; widths of the Gaussians by calibration."""

PIXELS = GaussianPixels(
    columns=28,
    left_deg=20,
    right_deg=-20,
    widening=1.0,
    column_sigma=0.45,
    row_centres_deg=(2.3, 0.1, -2.2),
    row_sigmas_deg=(1.0, 0.6, 1.0),
    peak_cd=(20_000, 40_000, 20_000),
)


def light(chromatic_shift: float = 0.0) -> Headlight:
    return headlight("hd84", PIXELS, TexelGrid.from_degrees(128, 512, 23, -23, -6.5, 6.5), chromatic_shift)
