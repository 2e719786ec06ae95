"""Lamps that come with luxloop; notes and comments tell published numbers from guesses."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Literal

import numpy as np
import scipy.sparse as sp

from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, Module
from luxloop.world.headlight.parametric import BlurredRectangles, GaussianPixels, headlight
from luxloop.world.lamps.fitting import FittedBeams
from luxloop.world.spmv import Csr
from luxloop.world.texels import TexelGrid

FLANK = 0.2  # half the width of a pixel's sloping edge, in pixel pitches

IDEAL_NOTES = """Published (thesis, T 9.4.3): 332 x 1024 pixels, +-10 deg by +1.5 to -3.5 deg, minimal overlap.
Guessed: 50 kcd over the whole field, pixels of equal pitch on the texture's plane, linear edges 0.2 pitches to either side."""
HD84_NOTES = """Published (thesis, T 2.4, 8.4): 3 x 28 pixels, +-20 x +-5 deg, rows of unequal height, pixels like Gaussians.
Guessed: all else; widths of the Gaussians by calibration."""
SSL_HD_NOTES = """\
Published (thesis, T 2.2, 5.1, 8.4): modules LoRes and HiRes of 64 x 256 pixels each, +-20 x +-5 deg and half of it, 0.156 and
0.078 deg a pixel, pixels like blurred rectangles that overlap their neighbours and widen slightly to the sides; six LEDs more for courtesy
light and auxiliary high beam; a static cornering light; the HiRes module lights the road from 15.3 m at 0.75 m (-3 deg).
Published (auto motor und sport, December 2022): up to 45 lx (LoRes) and 120 lx (HiRes), read as at 25 m, courtesy light +-45 deg.
Guessed: blur and overlap (by calibration), widening, the three small modules, where they sit in the lamp, how far they turn."""
HYBRID_NOTES = """\
Published: pixel count and field of LoRes as of ssl-hd; pixel count, extent and minimal overlap of the module HD as of the idealised lamp
(T 9.4.3).
Guessed: their combination, since lamps with micromirrors have coarser modules for the rest of the beam; 1.7 times the light of LoRes, for
a high beam of class B; that HD only draws what lighting functions ask for; its 75 kcd, as HiRes has; its field from +1 deg to -4 deg,
which lights the road from 9.4 m at 0.66 m; where both sit in the lamp."""
DMD_NOTES = """Published (Driving Vision News, January 2025, of the first such module): 1.3 million mirrors on 14 x 7 deg, 50 kcd at most.
Guessed: 1152 x 1152 mirrors, twice as wide as high, from 2 deg up to 5 deg down, even light, sharp edges."""

HD84 = GaussianPixels(
    columns=28,
    left_deg=20,
    right_deg=-20,
    widening=1.0,
    column_sigma=0.45,
    row_centres_deg=(2.3, 0.1, -2.2),
    row_sigmas_deg=(1.0, 0.6, 1.0),
    peak_cd=(20_000, 40_000, 20_000),
)
DMD = BlurredRectangles(
    rows=1152, columns=1152, left_deg=7, right_deg=-7, bottom_deg=-5, top_deg=2, blur_deg=0, peak_cd=50_000, spacing="tangent"
)


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


def _row(columns: int, left_deg: float, right_deg: float, v_deg: float, height_deg: float, width: float, peak_cd: float) -> GaussianPixels:
    """One row of Gaussians about v_deg; height_deg: their vertical standard deviation, width: the horizontal one in columns."""
    return GaussianPixels(
        columns=columns,
        left_deg=left_deg,
        right_deg=right_deg,
        row_centres_deg=(v_deg,),
        row_sigmas_deg=(height_deg,),
        column_sigma=width,
        peak_cd=(peak_cd,),
    )


# Name, pixels, and rows, columns and borders in deg (left, right, bottom, top) of its texture.
_MATRICES: dict[str, tuple[GaussianPixels | BlurredRectangles, tuple[int, int, float, float, float, float]]] = {
    "hd84": (HD84, (128, 512, 23, -23, -6.5, 6.5)),
    "dmd-1m3": (DMD, (2304, 1152, 7, -7, -5, 2)),
    "ssl-hd-lores": (_hd_pixels(20, 28_000), (216, 800, 20.75, -20.75, -5.6, 5.6)),  # 45 lx at 25 m
    "ssl-hd-hires": (_hd_pixels(10, 75_000), (216, 800, 10.375, -10.375, -2.8, 2.8)),  # 120 lx
    "ssl-hd-auxiliary": (_row(3, 9, -9, 0.8, 1.6, 0.5, 25_000), (96, 256, 18, -18, -4.5, 6.0)),
    "ssl-hd-courtesy": (_row(3, 45, -45, -6.0, 1.5, 0.4, 4_000), (96, 384, 66, -66, -12, -0.5)),
    "ssl-hd-cornering": (_row(1, 65, 25, -5.0, 1.5, 0.3, 5_000), (64, 192, 77, 5, -10, -0.5)),
}


def matrix(name: str, chromatic_shift: float = 0.0) -> Headlight:
    """The light of a module of the shipped lamps. chromatic_shift: as of `lamp`."""
    pixels, grid = _MATRICES[name]
    return headlight(name, pixels, TexelGrid.from_degrees(*grid), chromatic_shift)


def _profile(pixels: int, texels_per_pixel: int) -> sp.csr_array:
    """Trapezoid profile of a line of pixels, `[pixels * texels_per_pixel, pixels]`; the profiles of neighbours add up to one."""
    texel = (np.arange(pixels * texels_per_pixel) + 0.5) / texels_per_pixel
    beside = np.abs(texel[:, None] - np.arange(pixels) - 0.5)
    return sp.csr_array(np.clip((0.5 + FLANK - beside) / (2 * FLANK), 0, 1))


def idealised(
    pixel_rows: int = 332,
    pixel_cols: int = 1024,
    texels_per_pixel: tuple[int, int] = (4, 2),
    half_width_deg: float = 10.0,
    top_deg: float = 1.5,
    bottom_deg: float = -3.5,
    intensity_cd: float = 50_000.0,
) -> Headlight:
    """The thesis' idealised lamp (T 9.4.3): 332 x 1024 pixels, +-10 deg, +1.5 to -3.5 deg, minimal overlap.

    Published: the pixel count, the angles, "minimal overlap". Guessed: 50 kcd over the whole field (about 1.5 klm), pixels of equal
    pitch on the texture's plane, and overlap as linear edges FLANK pitches to either side of a pixel's border, so that a texel has
    1.5 entries. pixel_rows, pixel_cols: their number.
    texels_per_pixel: (rows, columns); at 17 m the symbol spans only 40 pixel rows, so rows are sampled
    four times.
    """
    vertical = _profile(pixel_rows, texels_per_pixel[0])
    horizontal = _profile(pixel_cols, texels_per_pixel[1])
    return Headlight(
        **vars(TexelGrid.from_degrees(vertical.shape[0], horizontal.shape[0], half_width_deg, -half_width_deg, bottom_deg, top_deg)),
        name=f"idealised-{pixel_rows}x{pixel_cols}",
        matrix=Csr.from_scipy(intensity_cd * sp.kron(vertical, horizontal, format="csr")),
        pixel_rows=pixel_rows,
        pixel_cols=pixel_cols,
    )


def _ideal(chromatic_shift: float) -> tuple[Module, ...]:
    if chromatic_shift:
        raise LuxloopError("the idealised lamp has no coloured edges: leave chromatic_shift at 0")
    return (Module("matrix", idealised()),)


def _hybrid_hd(chromatic_shift: float) -> tuple[Module, ...]:
    if chromatic_shift:
        raise LuxloopError("the lamp hybrid-hd has no coloured edges: leave chromatic_shift at 0")
    light = idealised(texels_per_pixel=(2, 1), top_deg=1.0, bottom_deg=-4.0, intensity_cd=75_000)
    return (
        Module("lores", matrix("ssl-hd-lores").scale(1.7), pose_from_degrees((0.0, 0.05, -0.04))),
        Module("hd", light, pose_from_degrees((0.0, -0.05, -0.04)), draws_only=True),
    )


def _alone(module: str, name: str) -> Callable[[float], tuple[Module, ...]]:
    return lambda chromatic_shift: (Module(module, matrix(name, chromatic_shift)),)


def _ssl_hd(chromatic_shift: float) -> tuple[Module, ...]:
    bending, levelling = (-7.0, 15.0), (-1.0, 2.5)
    small = {"auxiliary": (0.0, 0.05, 0.04), "courtesy": (0.0, -0.05, 0.04), "cornering": (0.0, 0.12, 0.0)}
    return (
        Module("lores", matrix("ssl-hd-lores", chromatic_shift), pose_from_degrees((0.0, 0.05, -0.04)), bending, levelling),
        Module("hires", matrix("ssl-hd-hires", chromatic_shift), pose_from_degrees((0.0, -0.05, -0.04), pitch_deg=0.5), bending, levelling),
        *(Module(name, matrix(f"ssl-hd-{name}"), pose_from_degrees(at), level_deg=levelling) for name, at in small.items()),
    )


# Summary, modules of the left lamp for a chromatic shift, and notes on their origin.
_LAMPS: dict[str, tuple[str, Callable[[float], tuple[Module, ...]], str]] = {
    "idealised-332x1024": ("the thesis' idealised lamp: 332 x 1024 pixels on 20 x 5 deg that hardly overlap", _ideal, IDEAL_NOTES),
    "hd84": ("84 Gaussian pixels in three unequal rows on 40 x 10 deg", _alone("matrix", "hd84"), HD84_NOTES),
    "ssl-hd-lores": (
        "64 x 256 blurred pixels on 40 x 10 deg",
        _alone("lores", "ssl-hd-lores"),
        f"The module LoRes alone, of the lamp of which the rest tells.\n{SSL_HD_NOTES}",
    ),
    "ssl-hd-hires": (
        "64 x 256 blurred pixels on 20 x 5 deg",
        _alone("hires", "ssl-hd-hires"),
        f"The module HiRes alone, of the lamp of which the rest tells.\n{SSL_HD_NOTES}",
    ),
    "ssl-hd": ("the lamp around both: LoRes, HiRes, auxiliary high beam, courtesy light, cornering light", _ssl_hd, SSL_HD_NOTES),
    "hybrid-hd": ("64 x 256 blurred pixels for the beams, 332 x 1024 on 20 x 5 deg for symbols", _hybrid_hd, HYBRID_NOTES),
    "dmd-1m3": ("1.3 million micromirrors on 14 x 7 deg", _alone("matrix", "dmd-1m3"), DMD_NOTES),
}
NAMES = tuple(_LAMPS)
SUMMARIES: Mapping[str, str] = MappingProxyType({name: summary for name, (summary, _, _) in _LAMPS.items()})


@lru_cache(maxsize=4)
def lamp(name: str, side: Literal["left", "right"] = "left", chromatic_shift: float = 0.0) -> Lamp:
    """A lamp by name, one of NAMES; its beams are fitted when they are first asked for.

    side: of the car; the right lamp is the left one's mirror image. chromatic_shift: by what share the lenses of the HD modules image
    blue larger than red, 0 for one colour. Raises: LuxloopError for an unknown name or side.
    """
    if name not in _LAMPS:
        raise LuxloopError(f"there is no lamp {name!r}; {did_you_mean(name, NAMES)}")
    if side not in ("left", "right"):
        raise LuxloopError(f"a lamp's side is 'left' or 'right', not {side!r}")
    _, build, notes = _LAMPS[name]
    mirrored = side == "right"
    modules = (module.mirror() for module in lamp(name, "left", chromatic_shift).modules) if mirrored else build(chromatic_shift)
    bare = Lamp(name, tuple(modules), notes=notes)
    return replace(bare, beams=FittedBeams(bare))
