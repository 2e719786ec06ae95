"""The SSL|HD lamp: two HD modules of 64 x 256 pixels, an auxiliary high beam, a courtesy light and a static cornering light."""

from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Module
from luxloop.world.headlight.parametric import BlurredRectangles, GaussianPixels
from luxloop.world.presets.modules import headlight
from luxloop.world.texels import TexelGrid

NOTES = """Published (thesis, T 2.2, 5.1, 8.4): modules LoRes and HiRes of 64 x 256 pixels each, +-20 x +-5 deg and half of it, 0.156 and
0.078 deg a pixel, pixels like blurred rectangles that overlap their neighbours and widen slightly to the sides; six LEDs more for courtesy
light and auxiliary high beam; a static cornering light; the HiRes module lights the road from 15.3 m at 0.75 m (-3 deg).
Published (auto motor und sport, December 2022): up to 45 lx (LoRes) and 120 lx (HiRes), read as at 25 m, courtesy light +-45 deg.
Guessed: blur and overlap (by calibration), widening, the three small modules, where they sit in the lamp, how far they turn."""


def _hd_pixels(half_width_deg: float, peak_cd: float) -> BlurredRectangles:
    """One chip behind two lenses: blur and overlap are calibrated on the wide one and scale with the field."""
    return BlurredRectangles(
        rows=64,
        columns=256,
        left_deg=half_width_deg,
        right_deg=-half_width_deg,
        bottom_deg=-half_width_deg / 4,
        top_deg=half_width_deg / 4,
        widening=0.15,
        blur_deg=0.008 * half_width_deg,
        overlap=0.5,
        cut=0.02,
        peak_cd=peak_cd,
    )


# Peaks: 45 and 120 lx at 25 m.
LORES, HIRES = _hd_pixels(20, 28_000), _hd_pixels(10, 75_000)
AUXILIARY = GaussianPixels(
    columns=3, left_deg=9, right_deg=-9, row_centres_deg=(0.8,), row_sigmas_deg=(1.6,), column_sigma=0.5, peak_cd=(25_000,)
)
COURTESY = GaussianPixels(
    columns=3, left_deg=45, right_deg=-45, row_centres_deg=(-6.0,), row_sigmas_deg=(1.5,), column_sigma=0.4, peak_cd=(4_000,)
)
CORNERING = GaussianPixels(
    columns=1, left_deg=65, right_deg=25, row_centres_deg=(-5.0,), row_sigmas_deg=(1.5,), column_sigma=0.3, peak_cd=(5_000,)
)


def lores(chromatic_shift: float = 0.0) -> Headlight:
    return headlight("ssl-hd-lores", LORES, TexelGrid.from_degrees(216, 800, 20.75, -20.75, -5.6, 5.6), chromatic_shift)


def hires(chromatic_shift: float = 0.0) -> Headlight:
    return headlight("ssl-hd-hires", HIRES, TexelGrid.from_degrees(216, 800, 10.375, -10.375, -2.8, 2.8), chromatic_shift)


def modules(chromatic_shift: float = 0.0) -> tuple[Module, ...]:
    """The modules of the left lamp."""
    bending, levelling = (-7.0, 15.0), (-1.0, 2.5)
    auxiliary = headlight("ssl-hd-auxiliary", AUXILIARY, TexelGrid.from_degrees(96, 256, 18, -18, -4.5, 6.0))
    courtesy = headlight("ssl-hd-courtesy", COURTESY, TexelGrid.from_degrees(96, 384, 66, -66, -12, -0.5))
    cornering = headlight("ssl-hd-cornering", CORNERING, TexelGrid.from_degrees(64, 192, 77, 5, -10, -0.5))
    return (
        Module("lores", lores(chromatic_shift), pose_from_degrees((0.0, 0.05, -0.04)), bending, levelling),
        Module("hires", hires(chromatic_shift), pose_from_degrees((0.0, -0.05, -0.04), pitch_deg=0.5), bending, levelling),
        Module("auxiliary", auxiliary, pose_from_degrees((0.0, 0.05, 0.04)), level_deg=levelling),
        Module("courtesy", courtesy, pose_from_degrees((0.0, -0.05, 0.04)), level_deg=levelling),
        Module("cornering", cornering, pose_from_degrees((0.0, 0.12, 0.0)), level_deg=levelling),
    )
