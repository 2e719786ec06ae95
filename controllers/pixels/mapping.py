"""Mapping of ray setpoints to pixels, and the sums of the reduction (T 7.4.1): by matrix-image products, or entry by entry."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.controllers.pixels.pixel_major import MrpcParams, PixelMajor
from luxloop.controllers.pixels.primitives import E_V, HEAVIEST, I_V, U_ABS, U_REL
from luxloop.controllers.pixels.rthc import RayBatch, Setpoints, Stroke, expand
from luxloop.world.spmv import Csr, multiply, row_of_entries, span_of
from luxloop.world.texels import TexelGrid, Window

MOST = 0.7  # share of all pixels above which a part of the matrix costs more than it saves


@dataclass(frozen=True)
class Sums:
    """Sums of each pixel in a band, `[..., band]` each.

    weighted_u, weight: numerator and denominator of T eq. 7.4.5 over rays of finite weight; weight is None if it is 1. forced_u,
    forced_weight: the same over rays of infinite weight, None if there are none. lit: number of lit setpoints. ruled_from: weights from
    here on stand for an infinite weight of a zero setpoint; None if infinite weights are summed separately.
    """

    weighted_u: Tensor
    weight: Tensor | None
    forced_u: Tensor | None = None
    forced_weight: Tensor | None = None
    lit: Tensor | None = None
    ruled_from: float | None = None


@dataclass(frozen=True)
class Band:
    """A contiguous range of pixels that reach some texture rows, and all texture rows that these pixels reach."""

    pixels: slice
    rows: slice

    @classmethod
    def of_window(cls, pixels: PixelMajor, w: Window) -> "Band":
        """The band of pixels that reach the texture rows of a window."""
        grid = pixels.grid
        if w.empty:
            return cls(slice(0, 0), slice(0, 0))
        if (w.v_start, w.v_stop) == (0, grid.rows):
            return cls(slice(0, grid.n_pixels), slice(0, grid.rows))
        low, high = span_of(*pixels.pixels_of_rows, slice(w.v_start, w.v_stop))
        first = min(low, grid.n_pixels)
        band = slice(first, max(high + 1, first))
        if band.stop - band.start > MOST * grid.n_pixels:
            return cls(slice(0, grid.n_pixels), slice(0, grid.rows))
        if band.stop == band.start:
            return cls(band, slice(w.v_start, w.v_stop))
        low, high = span_of(*pixels.rows_of_pixels, band)
        return cls(band, slice(min(low, w.v_start), max(high + 1, w.v_stop)))

    def blank(self, like: Tensor, batch: tuple[int, ...], grid: TexelGrid, filled: float) -> Tensor:
        """A constant image `[..., rows, cols]` of the texture; rows outside the band are undefined and never read."""
        texture = like.new_empty(*batch, grid.rows, grid.cols)
        texture[..., self.rows, :].fill_(filled)  # three times as fast as an assignment
        return texture

    def texture(self, image: Tensor, w: Window, grid: TexelGrid, beside: float = 0.0) -> Tensor:
        """Texels `[..., rows * cols]` of an image on a window, with a constant outside it."""
        texture = self.blank(image, tuple(image.shape[:-2]), grid, beside)
        texture[..., *w.slices] = image
        return texture.flatten(-2)


RULING = 1e36  # stands for an infinite weight of a zero setpoint; no sum of finite weights comes near it
RULED = 2 * HEAVIEST  # sums from here on contain an infinite weight; sums of finite weights are smaller


Image = Tensor | float  # a number for all rays


@dataclass(frozen=True)
class _Piece:
    """Setpoints of the rays of a window: of all rays, or of those where hit is 1. The other fields are images, numbers that hold for all
    rays, or None if not needed.

    missed: 1 where no primitive is hit. relative, in_cd: 1 where the value is a share of the default or an intensity.
    """

    window: Window
    hit: Tensor | None
    value: Image
    finite: Image | None
    forced: Image | None
    missed: Image
    in_cd: Image
    relative: Image


def _pieces(asked: Setpoints | RayBatch) -> Iterator[_Piece]:
    if isinstance(asked, Setpoints):
        in_cd, relative = asked.portion(asked.in_cd, I_V, E_V), asked.portion(asked.relative, U_REL)
        yield _Piece(asked.window, None, asked.value, asked.finite, asked.forced, 1 - asked.cover, in_cd, relative)
        return
    weights = asked.primitives.weight.tolist() if None not in asked.is_mask else []
    for stroke in asked.strokes():
        finite: Image = stroke.finite
        forced: Image = stroke.forced
        if weights and not stroke.finite.requires_grad:  # a number saves a pass over the window
            weight = weights[stroke.primitive]
            finite, forced = (0.0, 1.0) if weight == torch.inf else (min(weight, HEAVIEST), 0.0)
        value = 0.0 if asked.is_mask[stroke.primitive] else stroke.value
        yield _Piece(stroke.window, stroke.hit, value, finite, forced, 0.0, *_kinds(stroke))


def _kinds(stroke: Stroke) -> tuple[float, float]:
    """`in_cd` and `relative` of a stroke."""
    return float(stroke.quantity < U_ABS), float(stroke.quantity == U_REL)


def stroke_light(stroke: Stroke, pixels: PixelMajor) -> Image:
    """Mapped utilisation `[..., rows, cols]` of a stroke of finite weight over dark pixels, broadcastable (T eq. 7.4.1, 7.4.2)."""
    in_cd, relative = _kinds(stroke)
    return _utilisation(_Piece(stroke.window, stroke.hit, stroke.value, 1.0, 0.0, 0.0, in_cd, relative), pixels) * (1 - relative)


def sums_by_products(
    asked: Setpoints | RayBatch, pixels: PixelMajor, params: MrpcParams, default: Tensor, dark: bool, place: Band, batch: tuple[int, ...]
) -> Sums:
    """Sums over a band of pixels (T eq. 7.4.5); default: `[n_p]`. dark: whether the default is zero. batch: batch dimensions of the
    setpoints.

    Images of the texture by name: weight: finite weights, 1 without a hit. light: weight times utilisation; of_default: the same for shares
    of the default. missed: 1 without a hit. forced, forced_u, forced_of_default: as the first three, over infinite weights. lit,
    lit_of_default: 1 where a setpoint is not zero.
    """
    unit, finite = (asked.finite is None, asked.forced is None) if isinstance(asked, Setpoints) else (asked.unit, asked.finite)
    ruling = asked.masking and not finite and pixels.weight is pixels.full
    of_default = U_REL in asked.quantities and not dark
    apart = not finite and not ruling
    wanted = {
        "light": True,
        "of_default": of_default,
        "weight": ruling or not unit,  # unit weights without infinite ones add up to 1, so no sum is needed
        "missed": not dark,
        "forced": apart,
        "forced_u": apart and not asked.masking,
        "forced_of_default": apart and not asked.masking and of_default,
        "lit": params.a_ac > 0,
        "lit_of_default": params.a_ac > 0 and of_default,
    }
    beside = {name: float(name in ("weight", "missed")) for name, needed in wanted.items() if needed}
    images = {name: place.blank(pixels.share, batch, pixels.grid, value) for name, value in beside.items()}
    painted: dict[str, list[Window]] = {name: [] for name in images}
    for piece in _pieces(asked):
        cut = (..., *piece.window.slices)
        for name, image in _contributions(piece, pixels, ruling, images).items():
            if isinstance(image, float) and image == beside[name] and not any(map(piece.window.meets, painted[name])):
                continue  # already filled so
            painted[name].append(piece.window)
            if piece.hit is None:
                images[name][cut] = image
            else:
                images[name][cut].lerp_(expand(image, piece.hit), piece.hit)
    return _sums(images, ruling, pixels, default, place)


def _contributions(piece: _Piece, pixels: PixelMajor, ruling: bool, wanted: Collection[str]) -> dict[str, Image]:
    """The contribution of a piece to each of the images by name."""
    absolute = utilisation = _utilisation(piece, pixels)
    of_default: Image = 0.0
    if isinstance(piece.relative, Tensor) or piece.relative:
        of_default = _times(utilisation, piece.relative)
        absolute = utilisation - of_default
    made: dict[str, Image] = {"missed": piece.missed}
    if piece.finite is None:
        made |= {"light": absolute, "of_default": of_default}
    else:
        made |= {"light": _times(absolute, piece.finite), "of_default": _times(of_default, piece.finite), "weight": piece.finite}
        if ruling and piece.forced is not None:
            made["weight"] = piece.finite + RULING * piece.forced
    if "forced" in wanted and piece.forced is not None:
        made |= {
            "forced": piece.forced,
            "forced_u": _times(absolute, piece.forced),
            "forced_of_default": _times(of_default, piece.forced),
        }
    if "lit" in wanted:
        made |= {"lit": _positive(absolute), "lit_of_default": _positive(of_default)}
    return {name: image for name, image in made.items() if name in wanted}


def _utilisation(piece: _Piece, pixels: PixelMajor) -> Image:
    """Mapped utilisation, the same for all pixels of a texel, `[..., rows, cols]` or broadcastable (T eq. 7.4.1, 7.4.2)."""
    cut, size = piece.window.slices, (pixels.grid.rows, pixels.grid.cols)
    if not isinstance(piece.value, Tensor):
        return piece.value
    asked = piece.value
    if isinstance(piece.in_cd, Tensor):
        asked = torch.lerp(asked, asked * pixels.share.view(size)[cut], piece.in_cd)  # u = share_i I_s,i (T eq. 7.4.1)
    elif piece.in_cd:
        asked = asked * pixels.share.view(size)[cut]
    if pixels.darkening is not None:
        asked = asked * pixels.darkening.view(size)[cut]  # T eq. 7.4.2
    return asked.clamp(0, 1)  # 0 <= I_s,ij <= I_m,ij


def _times(a: Image, b: Image) -> Image:
    """a * b; a factor of 1 costs no pass over the image."""
    if isinstance(b, float) and b in (0.0, 1.0):
        return a if b else 0.0
    return a * b


def _positive(a: Image) -> Image:
    return (a > 0).to(a) if isinstance(a, Tensor) else float(a > 0)


def _sums(images: dict[str, Tensor], ruling: bool, pixels: PixelMajor, default: Tensor, place: Band) -> Sums:
    band = place.pixels
    default = default[band]

    def summed(matrix: Csr, *names: str) -> dict[str, Tensor]:
        there = [name for name in names if name in images]
        flat = [images[name].flatten(-2) for name in there]
        at_once = torch.stack(flat) if len(flat) > 1 else flat[0][None]  # [images, ..., n_t]: one pass over the matrix, and no copy of one
        return dict(zip(there, multiply(matrix.band(band.start, band.stop), at_once), strict=True))  # [images, ..., band]

    finite, infinite = ("light", "of_default", "missed", "weight"), ("forced", "forced_u", "forced_of_default")
    if pixels.weight is pixels.full:
        sums = summed(pixels.full, *finite, *infinite)
    else:
        sums = summed(pixels.weight, *finite) | (summed(pixels.full, *infinite) if "forced" in images else {})
    light, forced_u, forced_weight, lit = sums["light"], None, sums.get("forced"), None
    for name in ("of_default", "missed"):
        if name in sums:
            light = light + default * sums[name]  # terms of T eq. 7.4.5 with the factor u_def,j, [..., band]
    if forced_weight is not None:
        forced_u = sums.get("forced_u", torch.zeros_like(forced_weight))
        if "forced_of_default" in sums:
            forced_u = forced_u + default * sums["forced_of_default"]
    if "lit" in images:
        counts = summed(pixels.ones, "lit", "missed", "lit_of_default")
        lit = counts.pop("lit") + sum((default > 0) * count for count in counts.values())  # misses and shares are lit where u_def,j > 0
    return Sums(light, sums.get("weight"), forced_u, forced_weight, lit, RULED if ruling else None)


def sums_by_entries(setpoints: Setpoints, pixels: PixelMajor, params: MrpcParams, default: Tensor, place: Band) -> Sums:
    """The sums of T eq. 7.4.5 over the entries of a band of pixels, mapped by T eq. 7.4.1 to 7.4.3. default: `[n_p]`."""
    band = place.pixels
    entries = pixels.entries.band(band.start, band.stop)
    pixel, texel, I_m = row_of_entries(entries), entries.indices.long(), entries.values
    own = slice(None)
    if entries is not pixels.entries:
        own = slice(int(pixels.entries.indptr[band.start]), int(pixels.entries.indptr[band.stop]))

    def of_entries(image: Tensor, beside: float = 0.0) -> Tensor:
        return place.texture(image, setpoints.window, pixels.grid, beside)[..., texel]

    value, cover = of_entries(setpoints.value), of_entries(setpoints.cover)
    in_cd, relative = (
        portion if isinstance(portion, float) else of_entries(portion)
        for portion in (setpoints.portion(setpoints.in_cd, I_V, E_V), setpoints.portion(setpoints.relative, U_REL))
    )
    weight = None if setpoints.finite is None else of_entries(setpoints.finite, 1.0)
    forced = None if setpoints.forced is None else of_entries(setpoints.forced)
    shared = value * pixels.share[texel]  # utilisations [..., nnz] of T eq. 7.4.1
    shared = shared if pixels.potential is None else shared * pixels.potential[own]
    mapped = _blend(_blend(value, value * default[band][pixel], relative), shared, in_cd)  # u_abs, u_rel or cd (T 7.2.1), [..., nnz]
    if pixels.darkening is not None:
        mapped = mapped * pixels.darkening[texel]  # T eq. 7.4.2
    if params.lower_cd:
        masked = torch.zeros_like(cover, dtype=torch.bool) if forced is None else (forced > 0) & (value == 0)
        mapped = torch.where(masked, 0.0, mapped.maximum(params.lower_cd / I_m))  # the user's lower bound (T 7.4.1)
    if params.upper_cd is not None:
        mapped = mapped.minimum(params.upper_cd / I_m)  # the user's upper bound (T 7.4.1)
    mapped = torch.where(cover > 0, mapped.clamp(0, 1), default[band][pixel])  # 0 <= I_s,ij <= I_m,ij; u_def,j without a hit
    kept = pixels.kept[own]
    if params.a_x and params.exclusion == "printed":
        kept = torch.where(mapped * I_m <= params.a_x * pixels.peak[band][pixel], 0.0, kept)  # T eq. 7.4.3 as printed

    def summed(terms: Tensor) -> Tensor:
        zeros = torch.zeros(*mapped.shape[:-1], entries.n_rows, dtype=terms.dtype, device=terms.device)
        return zeros.index_add(-1, pixel, terms.expand(*mapped.shape[:-1], -1))

    lit = summed((mapped > 0).to(mapped)) if params.a_ac else None
    finite = kept if weight is None else weight * kept  # w_ij I_m,ij^a_r of T eq. 7.4.5, [..., nnz]
    forced_u = forced_weight = None
    if forced is not None:
        alone = forced * pixels.full.values[own]
        forced_u, forced_weight = summed(alone * mapped), summed(alone)  # T eq. 7.4.5 over infinite weights, [..., band]
    return Sums(summed(finite * mapped), summed(finite), forced_u, forced_weight, lit)


def _blend(a: Tensor, b: Tensor, portion: Tensor | float) -> Tensor:
    """a where portion is 0, b where portion is 1."""
    if isinstance(portion, float):
        return b if portion else a
    return torch.lerp(a, b, portion)
