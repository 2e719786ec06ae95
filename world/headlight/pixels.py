"""From the distributions of single pixels to a headlight matrix on a light texture (T 5.2)."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # loads its parts on first use
import scipy.sparse as sp
from numpy.typing import NDArray

from luxloop.world.errors import LuxloopError
from luxloop.world.files import BUDGET_BYTES, afford
from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.photometry.distribution import EDGE_DEG, Aim, Array, Distribution, directions_of
from luxloop.world.photometry.texture import PROBES, Window, light_texture, solid_angles, squared_error
from luxloop.world.texels import LARGEST_ANGLE_DEG, TexelGrid

CUTOFF = 1e-4  # share of a pixel's peak below which its light is dropped, to save entries
MOST_TEXELS = 2048  # along a side, unless a user wants more
FEWEST_TEXELS = 255  # along a side of a single pixel, whose table may be coarse; an odd number has a texel on the axis
TEXELS_A_PIXEL = 4  # along a side at least, since symbols need rays between pixels
SAMPLED = 8  # pixels, evenly spread, from which the entries of all are estimated
BYTES_AN_ENTRY = 64  # of the matrix while it is assembled and sorted, at the peak
BYTES_OF_COLOUR = 60  # of an entry besides, where it has one
AFFORDABLE = 0.8  # share of the budget for a proposed size, as other pixels may be wider than the sampled ones
MOST_CUTOFF = 0.1  # largest cutoff to propose; a larger one would change the shape of a pixel
FEWEST_PROBES = 1024  # least number of directions in which each of many pixels is compared with its source
AZIMUTHS_DEG = 15.0  # steps in which a distribution is scanned about its axis


@dataclass(frozen=True, eq=False)
class Pixel:
    """One pixel at full utilisation.

    turn: `[3, 3]`, rotates the distribution's frame into the headlight frame; None: identity. rgb: the linear sRGB channels of the
    distribution in cd, None for one colour.
    """

    distribution: Distribution
    turn: Array | None = None
    rgb: tuple[Distribution, Distribution, Distribution] | None = None


@dataclass(frozen=True, eq=False)
class PixelArray:
    """All pixels of a module, row-major, row 0 on top and column 0 on the left. aim: see Distribution."""

    pixels: Sequence[Pixel]
    rows: int
    columns: int
    aim: Aim = "beam"


@dataclass(frozen=True, eq=False)
class PixelMatrix:
    """A headlight matrix and its errors against the source.

    matrix: `[n_texels, n_p]` cd. chroma: `[3, nnz]` or None, as Headlight has it. dropped: share of all light that was cut off. flux, peak:
    of all textures and the brightest, as shares of those of the sources. rmse_cd: root mean square difference of pixels and their sources
    over the sources' solid angles (see world.photometry.texture.rmse); rmse: relative to the brightest source.
    """

    matrix: sp.csr_array
    chroma: Array | None
    dropped: float
    flux: float
    peak: float
    rmse_cd: float
    rmse: float


def assemble(
    array: PixelArray, grid: TexelGrid, cutoff: float = CUTOFF, on_progress: Callable[[int, int], None] | None = None
) -> PixelMatrix:
    """Resample every pixel onto the texture.

    Each pixel is a light texture (see world.photometry.texture), restricted to the texels that it can light. on_progress: called with the
    pixels done and their number.

    Raises: LuxloopError if no pixel lights the texture, or, before the work starts, if all pixels together exceed the memory budget.
    """

    def light_of(distribution: Distribution, turn: Array | None) -> tuple[NDArray[np.intp], Array]:
        """Flat indices of the texels that a distribution may light, and its cd there."""
        axis, reach = _cap(distribution, array.aim)
        window = _window(grid, axis if turn is None else turn @ axis, reach)
        texel = (window[0][:, None] * grid.cols + window[1]).ravel()
        return texel, light_texture(distribution, grid, array.aim, turn, window).ravel() if len(texel) else np.empty(0)

    sampled = [array.pixels[k] for k in sorted({int((i + 0.5) * len(array.pixels) / SAMPLED) for i in range(SAMPLED)})]
    _check_entries([light_of(pixel.distribution, pixel.turn)[1] for pixel in sampled], array, grid, cutoff)
    probes = max(PROBES // len(array.pixels), FEWEST_PROBES)
    rows: list[NDArray[np.intp]] = []
    values: list[Array] = []
    chroma: list[Array] = []
    texture = np.zeros(grid.n_texels)
    lost = total = squares = solid = peak = flux = flux_of_sources = brightest = 0.0
    solid_angle = solid_angles(grid).ravel()
    entries = 0
    for number, pixel in enumerate(array.pixels, 1):
        texel, light = light_of(pixel.distribution, pixel.turn)
        bright = light > cutoff * light.max(initial=0)
        total += float(light.sum())
        lost += float(light[~bright].sum())
        entries += int(bright.sum())
        afford("its pixels", _bytes_an_entry(array) * entries, "give a coarser texture")
        rows.append(texel[bright].astype(np.int32))
        values.append(light[bright])
        if pixel.rgb is not None:
            chroma.append(_chroma(np.stack([_at(texel[bright], *light_of(each, pixel.turn), grid) for each in pixel.rgb])))
        texture[texel[bright]] = light[bright]
        error, over = squared_error(pixel.distribution, grid, texture, array.aim, pixel.turn, probes)
        texture[texel] = 0
        squares, solid = squares + error, solid + over
        peak = max(peak, float(pixel.distribution.candela.max()))
        brightest = max(brightest, float(light.max(initial=0)))
        flux += float(light[bright] @ solid_angle[texel[bright]])
        flux_of_sources += pixel.distribution.luminous_flux
        if on_progress:
            on_progress(number, len(array.pixels))
    if total == 0:
        raise LuxloopError(f"no pixel shines onto the texture ({describe(grid)}); widen it, or look at `aim`")
    indptr = np.cumsum([0, *map(len, rows)], dtype=np.int32)
    columns = sp.csc_array((np.arange(1.0, indptr[-1] + 1), np.concatenate(rows), indptr), shape=(grid.n_texels, len(array.pixels)))
    matrix = columns.tocsr()
    entry = matrix.data.astype(np.int64) - 1
    matrix.data = np.concatenate(values)[entry]
    rmse_cd = math.sqrt(squares / solid)
    return PixelMatrix(
        matrix=matrix,
        chroma=np.concatenate(chroma, axis=1)[:, entry] if chroma else None,
        dropped=lost / total,
        flux=flux / flux_of_sources,
        peak=brightest / peak,
        rmse_cd=rmse_cd,
        rmse=rmse_cd / peak,
    )


def _check_entries(lights: Sequence[Array], array: PixelArray, grid: TexelGrid, cutoff: float) -> None:
    """Estimate the number of entries from the light (cd a texel) of sampled pixels; refuse too many and propose sizes that fit."""
    shares = np.concatenate([light / max(light.max(initial=0), np.finfo(float).tiny) for light in lights])
    each = len(array.pixels) / len(lights)  # that a sample stands for
    entries, most = each * np.count_nonzero(shares > cutoff), BUDGET_BYTES / _bytes_an_entry(array)
    if entries <= most:
        return
    most *= AFFORDABLE
    rows, cols = (int(number * math.sqrt(most / entries)) for number in (grid.rows, grid.cols))
    faint = float(-np.partition(-shares, int(most / each))[int(most / each)])
    remedies = [f"texture.rows = {rows} and texture.columns = {cols}"] if rows >= array.rows and cols >= array.columns else []
    remedies += [f"cutoff = {_rounded_up(faint):g}"] if faint < MOST_CUTOFF else []
    afford(
        f"its {len(array.pixels):,} pixels, {entries / grid.n_texels:,.0f} on each of {grid.rows} x {grid.cols} texels by estimate,",
        _bytes_an_entry(array) * entries,
        f"set {', or '.join(remedies)}" if remedies else "give fewer or narrower pixels",
    )


def _bytes_an_entry(array: PixelArray) -> int:
    return BYTES_AN_ENTRY + (BYTES_OF_COLOUR if any(pixel.rgb is not None for pixel in array.pixels) else 0)


def _rounded_up(share: float) -> float:
    digit = 10.0 ** math.floor(math.log10(share))
    return math.ceil(share / digit) * digit


def default_grid(array: PixelArray) -> TexelGrid:
    """A texture that covers all light, with texels twice as fine as the source's angles and at least four to a pixel along each side.

    Light beyond LARGEST_ANGLE_DEG of the beam axis is left out.
    """
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    farthest = math.radians(LARGEST_ANGLE_DEG)
    for pixel in array.pixels:
        directions, _, lit = _nodes(pixel.distribution, array.aim)
        x, y, z = directions[:, lit] if pixel.turn is None else np.tensordot(pixel.turn, directions[:, lit], 1)
        aside = np.hypot(y, z)
        angle = np.arctan2(aside, x)  # from the beam axis
        if (angle < farthest).any():
            near = angle < farthest + math.radians(_widest(pixel.distribution))  # and what lies between a node in the field and one beyond
            tangent = np.tan(np.minimum(angle, farthest)) / np.maximum(aside, np.finfo(float).tiny)
            at = np.stack([y, z])[:, near] * tangent[near]
            low, high = np.minimum(low, at.min(1)), np.maximum(high, at.max(1))
    if not (low < high).all():
        raise LuxloopError(f"no pixel shines within {LARGEST_ANGLE_DEG:g} deg of the beam axis; look at `aim`")
    (right, bottom), (left, top) = low, high
    down, across = _steps(array)
    rows = affordable(2 * (top - bottom) / math.radians(down), array.rows)
    cols = affordable(2 * (left - right) / math.radians(across), array.columns)
    if len(array.pixels) == 1:
        rows, cols = (max(number, FEWEST_TEXELS) | 1 for number in (rows, cols))
    return TexelGrid(rows=rows, cols=cols, left=float(left), right=float(right), bottom=float(bottom), top=float(top))


def border_share(distribution: Distribution) -> float:
    """Greatest intensity at the border of the measured angles, as a share of the peak; 0 if the measurement covers the full circle."""
    v, h, candela = distribution.full_table
    all_round = (v[0] <= -90 if distribution.type != "C" else v[0] <= 0, v[-1] >= (180 if distribution.type == "C" else 90))
    borders = [candela[:, end] for end, closed in zip((0, -1), all_round, strict=True) if not closed]
    if distribution.type != "C":
        borders += [candela[end] for end, angle in ((0, -h[0]), (-1, h[-1])) if angle < 90]
    peak = float(candela.max())
    return max((float(each.max()) for each in borders), default=0.0) / peak if peak else 0.0


def affordable(texels: float, pixels: int) -> int:
    """Number of texels along a side: at least some per pixel, otherwise limited by memory."""
    fewest = TEXELS_A_PIXEL * pixels
    return min(max(math.ceil(texels), fewest), max(MOST_TEXELS, fewest))


def describe(grid: TexelGrid) -> str:
    """A texture's borders in words."""
    left, right, bottom, top = grid.borders_deg
    return f"{left:+.4g} to {right:+.4g} deg across, {bottom:+.4g} to {top:+.4g} deg up"


def _window(grid: TexelGrid, axis: Array, reach: float) -> Window:
    """Texel rows and columns that a cone crosses; all, if the cone reaches far from the beam axis."""
    found = []
    for along, first, last, n in ((axis[2], grid.top, grid.bottom, grid.rows), (axis[1], grid.left, grid.right, grid.cols)):
        middle, flat = math.atan2(along, axis[0]), math.hypot(along, axis[0])  # of the cone seen from the side or from above
        half = math.asin(math.sin(reach) / flat) if reach < math.asin(min(flat, 1.0)) else math.pi
        ends = np.array([middle + half, middle - half])
        if np.abs(ends).max() < math.pi / 2:
            low, high = (np.tan(ends) - first) / (last - first) * n
            found.append(np.arange(max(math.floor(low), 0), min(math.ceil(high), n)))
        else:
            found.append(np.arange(n))
    return found[0], found[1]


@lru_cache(maxsize=4)
def _nodes(distribution: Distribution, aim: Aim) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Directions `[3, V, H]` of a distribution's measured angles, its cd `[V, H]`, and a mask of the nodes that shine or have a neighbour
    that does.
    """
    v, h, _ = distribution.full_table
    if distribution.type == "C":  # one plane may stand for all
        h = np.union1d(h, h[0] + np.arange(0.0, h[-1] - h[0], AZIMUTHS_DEG))
    v_at, h_at = np.meshgrid(v, h, indexing="ij")
    candela = distribution.at(v_at, h_at)
    lit = scipy.ndimage.maximum_filter(candela, 3, mode=("nearest", "wrap" if distribution.type == "C" else "nearest")) > 0
    return directions_of(distribution.type, v_at, h_at, aim), candela, lit


@lru_cache(maxsize=4)
def _cap(distribution: Distribution, aim: Aim) -> tuple[Array, float]:
    """The axis `[3]` of a cone that holds all light of a distribution, and its half angle in rad."""
    directions, _, lit = _nodes(distribution, aim)
    if not lit.any():
        return np.array([1.0, 0.0, 0.0]), 0.0
    inside = directions[:, lit]
    axis = inside.mean(1)
    axis /= max(float(np.linalg.norm(axis)), np.finfo(float).tiny)
    return axis, min(math.acos(max(float((axis @ inside).min()), -1.0)) + math.radians(_widest(distribution)), math.pi)


def _widest(distribution: Distribution) -> float:
    """The widest step of a distribution's angles in deg."""
    return max(float(np.diff(angles).max(initial=0)) for angles in distribution.full_table[:2])


def _steps(array: PixelArray) -> tuple[float, float]:
    """The finest steps down and across in deg in which the pixels were measured."""
    distributions = {pixel.distribution for pixel in array.pixels}
    down = min(_finest(each.vertical_deg) for each in distributions)
    across = min((_finest(each.horizontal_deg) for each in distributions if each.type != "C"), default=math.inf)
    return down, across if math.isfinite(across) else down


def _finest(angles_deg: Array) -> float:
    steps = np.diff(angles_deg)
    return float(steps[steps > EDGE_DEG].min(initial=math.inf))


def _at(wanted: NDArray[np.intp], texel: NDArray[np.intp], light: Array, grid: TexelGrid) -> Array:
    """Light at the `wanted` texels, zero where a texel has none."""
    texture = np.zeros(grid.n_texels)
    texture[texel] = light
    return texture[wanted]


def _chroma(channels: Array) -> Array:
    """Linear sRGB `[3, N]` at luminance 1; white where there is no light."""
    luminance = np.array(LUMINANCE) @ channels
    dark = luminance <= 0
    return np.where(dark, 1.0, channels / np.where(dark, 1.0, luminance))
