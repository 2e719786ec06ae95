"""A projector with 1.3 million micromirrors."""

from luxloop.world.headlight import Headlight
from luxloop.world.headlight.parametric import BlurredRectangles
from luxloop.world.presets.modules import headlight
from luxloop.world.texels import TexelGrid

NOTES = """Published (Driving Vision News, January 2025, of the first such module): 1.3 million mirrors on 14 x 7 deg, 50 kcd at most.
Guessed: 1152 x 1152 mirrors, twice as wide as high, from 2 deg up to 5 deg down, even light, sharp edges."""

PIXELS = BlurredRectangles(
    rows=1152, columns=1152, left_deg=7, right_deg=-7, bottom_deg=-5, top_deg=2, blur_deg=0, peak_cd=50_000, spacing="tangent"
)


def light(chromatic_shift: float = 0.0) -> Headlight:
    return headlight("dmd-1m3", PIXELS, TexelGrid.from_degrees(2304, 1152, 7, -7, -5, 2), chromatic_shift)
