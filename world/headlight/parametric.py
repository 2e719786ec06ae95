"""Matrix modules from a few numbers: Gaussian pixels and blurred rectangles on a grid, as headlight matrices (T 2.4, 5.2).

Angles are those along the texture's axes, atan(y) and atan(z), in deg, left and up positive, so that every pixel is a product of a
profile down the rows and one along the columns. A texel holds the mean over its width, exactly, so that light is kept on any texture.
"""

from typing import Annotated, Literal, Self

import numpy as np
import scipy  # loads its parts on first use
import scipy.sparse as sp
import torch
from numpy.typing import NDArray
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.world.files import afford
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.params import Params, in_order
from luxloop.world.spmv import Csr
from luxloop.world.texels import TexelGrid

Floats = NDArray[np.float64]
Matrix = tuple[sp.csr_array, int, int]
Spacing = Literal["angle", "tangent"]

MOST_PIXELS = 4096  # along a side
BYTES_AN_ENTRY = 15  # of a headlight matrix while it is made
BRIGHTEST_CD = 1e9  # of a pixel
SHARP_DEG = 1e-6  # a smaller blur counts as none


PixelCount = Annotated[int, Field(gt=0, le=MOST_PIXELS)]
Border = Annotated[float, Field(gt=-80, lt=80)]  # deg
InField = Annotated[float, Field(ge=-80, le=80)]  # deg


class _Pixels(Params):
    columns: PixelCount = Field(description="pixels per row", examples=[64])
    left_deg: Border = Field(description="left border of the pixel field, left positive", examples=[12.0])
    right_deg: Border = Field(description="right border of the pixel field", examples=[-12.0])
    widening: float = Field(0.0, description="relative extra width of the outermost column over the middle one", ge=0, le=10)
    cut: float = Field(0.01, description="share of a pixel's peak below which its light is dropped, which limits overlap", ge=0, lt=1)

    _left_of_right = in_order("right_deg", "left_deg")

    def _columns(self, left: float, right: float) -> tuple[Floats, Floats]:
        """Borders `[columns + 1]` from the left and intensities `[columns]` of the columns: a wider pixel is dimmer by as much."""
        s = np.linspace(-1.0, 1.0, self.columns + 1)
        share = 0.5 + 0.5 * (s + self.widening * s**3 / 3) / (1 + self.widening / 3)
        middle = 0.5 * (s[1:] + s[:-1])
        return left + share * (right - left), 1 / (1 + self.widening * middle**2)


class GaussianPixels(_Pixels):
    """Pixels whose light falls off as a Gaussian on every side; rows of unequal height, brightness and distance."""

    kind: Literal["gaussian"] = "gaussian"
    row_centres_deg: tuple[InField, ...] = Field(
        description="centre of each pixel row, top row first, up positive", examples=[[-6.0]], min_length=1, max_length=MOST_PIXELS
    )
    row_sigmas_deg: tuple[Annotated[float, Field(ge=1e-3, le=90)], ...] = Field(
        description="vertical standard deviation of each pixel row", examples=[[1.5]]
    )
    column_sigma: float = Field(description="horizontal standard deviation, in column widths", examples=[0.5], ge=1e-3, le=100)
    peak_cd: tuple[Annotated[float, Field(ge=0, le=BRIGHTEST_CD)], ...] = Field(
        description="peak intensity of the middle pixel of each row", examples=[[4000.0]]
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        rows = len(self.row_centres_deg)
        for name in ("row_sigmas_deg", "peak_cd"):
            if len(getattr(self, name)) != rows:
                raise ValueError(f"{name} has {len(getattr(self, name))} values for the {rows} rows of row_centres_deg: give one a row")
        return self

    def matrix(self, grid: TexelGrid, magnification: float = 1.0) -> Matrix:
        """Headlight matrix `[n_texels, n_p]` in cd, float64, and its pixel rows and columns.

        magnification: of the image of the pixels about the beam axis.
        """
        z, y = (axis / magnification for axis in _texel_borders(grid, "angle"))
        borders, dimming = self._columns(self.left_deg, self.right_deg)
        vertical = _gaussian(z, np.array(self.row_centres_deg), np.array(self.row_sigmas_deg))
        horizontal = _gaussian(y, 0.5 * (borders[1:] + borders[:-1]), self.column_sigma * np.abs(np.diff(borders)))
        peak = np.outer(self.peak_cd, dimming)
        return _product(vertical, horizontal, peak, self.cut), *peak.shape


class BlurredRectangles(_Pixels):
    """Adjacent rectangles, each convolved with a Gaussian; with all pixels on they form an even field with soft borders."""

    kind: Literal["blurred_rectangles"] = "blurred_rectangles"
    rows: PixelCount = Field(description="pixel rows", examples=[16])
    bottom_deg: Border = Field(description="lower border of the pixel field, up positive", examples=[-4.0])
    top_deg: Border = Field(description="upper border of the pixel field", examples=[2.0])
    row_heights: tuple[Annotated[float, Field(ge=1e-3, le=1e3)], ...] = Field(
        (), description="relative heights of the rows, top row first; equal if empty"
    )
    blur_deg: float = Field(description="standard deviation of the Gaussian that softens the edges", examples=[0.15], ge=0, le=90)
    overlap: float = Field(0.0, description="relative excess of a pixel's width and height over its cell of the grid", ge=0, le=10)
    peak_cd: float = Field(description="intensity in the centre of the field with all pixels on", examples=[40000.0], ge=0, le=BRIGHTEST_CD)
    spacing: Spacing = Field(
        "angle", description="pixels of equal angle, or of equal size on the plane of the texture (a distortion-free lens)"
    )

    _top_above_bottom = in_order("bottom_deg", "top_deg")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.row_heights and len(self.row_heights) != self.rows:
            raise ValueError(f"row_heights has {len(self.row_heights)} values for {self.rows} rows: give one a row, or none")
        return self

    def matrix(self, grid: TexelGrid, magnification: float = 1.0) -> Matrix:
        """Headlight matrix `[n_texels, n_p]` in cd, float64, and its pixel rows and columns.

        magnification: of the image of the pixels about the beam axis.
        """
        z, y = (axis / magnification for axis in _texel_borders(grid, self.spacing))
        left, right, bottom, top = _along_axis(np.array([self.left_deg, self.right_deg, self.bottom_deg, self.top_deg]), self.spacing)
        columns, dimming = self._columns(left, right)
        heights = np.array(self.row_heights or [1.0] * self.rows)
        rows = top - np.concatenate([[0.0], heights.cumsum() / heights.sum()]) * (top - bottom)
        peak = np.broadcast_to(self.peak_cd * dimming, (self.rows, self.columns))
        vertical, horizontal = (_rectangle(axis, borders, self.blur_deg, self.overlap) for axis, borders in ((z, rows), (y, columns)))
        return _product(vertical, horizontal, peak, self.cut), self.rows, self.columns


def _along_axis(angle_deg: Floats, spacing: Spacing) -> Floats:
    """Angles as they are, or as they lie on the plane x = 1, in degrees of its middle."""
    return angle_deg if spacing == "angle" else np.degrees(np.tan(np.radians(angle_deg)))


def _texel_borders(grid: TexelGrid, spacing: Spacing) -> tuple[Floats, Floats]:
    """Borders of the texels' rows `[rows + 1]` from the top and columns `[cols + 1]` from the left."""
    tangents = (np.linspace(grid.top, grid.bottom, grid.rows + 1), np.linspace(grid.left, grid.right, grid.cols + 1))
    vertical, horizontal = (np.degrees(np.arctan(axis) if spacing == "angle" else axis) for axis in tangents)
    return vertical, horizontal


def _gaussian(axis: Floats, centres: Floats, sigmas: Floats) -> Floats:
    """Means over texels `[T, P]` of Gaussians of height 1. axis: borders `[T + 1]`, falling."""
    primitive = np.sqrt(2 * np.pi) * sigmas * scipy.special.ndtr((axis[:, None] - centres) / sigmas)
    return np.diff(primitive, axis=0) / np.diff(axis)[:, None]


def _rectangle(axis: Floats, borders: Floats, blur: float, overlap: float) -> Floats:
    """Means over texels `[T, P]` of blurred rectangles about falling borders `[P + 1]`; all together they are one on average."""
    spread = 0.5 * overlap * (borders[:-1] - borders[1:])
    upper, lower = borders[:-1] + spread, borders[1:] - spread
    primitive = _ramp(axis[:, None] - lower, blur) - _ramp(axis[:, None] - upper, blur)
    return np.diff(primitive, axis=0) / np.diff(axis)[:, None] / (1 + overlap)


def _ramp(x: Floats, blur: float) -> Floats:
    """The ramp max(x, 0) convolved with a Gaussian: twice differentiated it is the Gaussian itself."""
    if blur < SHARP_DEG:
        return np.maximum(x, 0.0)
    return x * scipy.special.ndtr(x / blur) + blur / np.sqrt(2 * np.pi) * np.exp(-0.5 * (x / blur) ** 2)


def affordable_entries(entries: float) -> None:
    """Raises LuxloopError where a headlight matrix would have more entries than the memory's budget allows."""
    remedy = "give texture.rows and texture.columns for a coarser texture, cut off more faint light, or let pixels overlap less"
    afford(f"its {entries / 1e6:,.0f} million texels that pixels light", BYTES_AN_ENTRY * entries, remedy)


def _product(vertical: Floats, horizontal: Floats, peak: Floats, cut: float) -> sp.csr_array:
    """Pixels `[T, P]` from profiles of rows and columns and peaks `[rows, columns]`; entries below `cut` of a pixel's maximum are
    dropped.
    """
    factors = []
    for profile in (vertical, horizontal):
        top = profile.max(axis=0)
        share = profile / np.where(top > 0, top, 1.0)
        factors.append((sp.csr_array(np.where(share > cut, share, 0.0)), top))
    (rows, row_top), (columns, column_top) = factors
    affordable_entries(rows.nnz * columns.nnz)
    matrix = sp.csr_array(sp.kron(rows, columns, format="csr"))
    matrix.data[matrix.data <= cut] = 0.0
    matrix.eliminate_zeros()
    matrix.data *= (peak * np.outer(row_top, column_top)).ravel()[matrix.indices]
    return matrix


def headlight(name: str, model: GaussianPixels | BlurredRectangles, grid: TexelGrid, chromatic_shift: float = 0.0) -> Headlight:
    """A module's light on a texture.

    chromatic_shift: lateral chromatic aberration about the beam axis, by which the lens images blue larger than red, as a share: a pixel's
    outer edge turns bluish, its inner edge yellowish (T 5.1). Zero: one colour.
    """
    matrix, pixel_rows, pixel_cols = model.matrix(grid)
    chroma = None
    if chromatic_shift:
        channels = [model.matrix(grid, 1 + 0.5 * share * chromatic_shift)[0] for share in (-1, 0, 1)]
        matrix, chroma = _luminance_and_chroma(channels)
    light = Csr.from_scipy(matrix)
    return Headlight(**vars(grid), name=name, matrix=light, pixel_rows=pixel_rows, pixel_cols=pixel_cols, chroma=chroma)


def _luminance_and_chroma(channels: list[sp.csr_array]) -> tuple[sp.csr_array, Tensor]:
    """Luminance matrix of three channels, and the chroma `[3, nnz]` of its entries."""
    luminance = sp.csr_array(sum(weight * channel for weight, channel in zip(LUMINANCE, channels, strict=True)))
    luminance.sort_indices()
    number = sp.csr_array((np.arange(1.0, luminance.nnz + 1), luminance.indices, luminance.indptr), luminance.shape)
    chroma = np.zeros((3, luminance.nnz))
    for share, channel in zip(chroma, channels, strict=True):
        ones = sp.csr_array((np.ones(channel.nnz), channel.indices, channel.indptr), channel.shape)
        entry = sp.csr_array(number.multiply(ones))
        entry.sort_indices()
        channel.sort_indices()
        where = entry.data.astype(np.int64) - 1
        share[where] = channel.data / luminance.data[where]
    return luminance, torch.from_numpy(chroma).float()
