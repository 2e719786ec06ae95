"""Light on surfaces: `E_v = I_v cos / d^2` with shadows (T eq. 2.1.5), plain on a G-buffer or folded into one sparse matrix."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from luxloop.world.caches import keeping
from luxloop.world.frames import inverse, transform, unit
from luxloop.world.headlight import Headlight
from luxloop.world.materials.brdf import luminance_factor
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.rendering.raycast import sees
from luxloop.world.scene.triangles import Triangles
from luxloop.world.spmv import Csr, multiply, row_of_entries, segment_bounds, span_of
from luxloop.world.texels import bilinear

KEPT_TEXTURES: Final = 2  # of an on and an off exposure


def lux_per_cd(away: Tensor, normal: Tensor | None = None) -> Tensor:
    """Illuminance in lx of points `[..., N]` by a lamp of 1 cd, `E_v / I_v = cos / d^2` (T eq. 2.1.5), 0 behind the surface.

    away: `[..., 3, N]` m, from the points to the lamp. normal: unit, broadcastable to it; None for surfaces that face the lamp.
    """
    d2 = (away * away).sum(-2)
    return 1 / d2 if normal is None else ((normal * away).sum(-2) / d2.sqrt()).clamp(min=0) / d2


@dataclass(frozen=True)
class LitSurface:
    """The part of a G-buffer that the light of a lamp reaches, M pixels in image order.

    index: `[M]` int64, flat image index. texel: `[4, M]` int64 and weight: `[4, M]`, bilinear neighbours in the light texture.
    factor: `[M]`, cos / d^2 in 1/m^2, less what the air takes. luminance_factor: `[M]`, albedo of the Lambertian surface that would look
    as bright through clear air.
    """

    index: Tensor
    texel: Tensor
    weight: Tensor
    factor: Tensor
    luminance_factor: Tensor


def lit_surface(
    gbuffer: GBuffer,
    headlight: Headlight,
    T_world_headlight: Tensor,
    triangles: Triangles | None = None,
    texels: tuple[slice, slice] | None = None,
) -> LitSurface:
    """The part of a G-buffer that the lamp at `T_world_headlight` `[4, 4]` can light, with its geometry factors.

    triangles: of bodies that cast shadows, tested by a ray from the lamp to each point; None: no shadows. texels: rows and columns outside
    of which the light texture is dark; None: all may be lit. The light texture is interpolated bilinearly, clamped within its outer half
    texel and zero beyond its border.
    """
    position, normal = gbuffer.position.flatten(1), gbuffer.normal.flatten(1)
    x, y, z = transform(inverse(T_world_headlight).to(position), position)
    row, col = headlight.texel_of(y / x, z / x)
    inside = (x > 0) & (gbuffer.object_id.flatten() >= 0)
    for place, n, span in zip((row, col), (headlight.rows, headlight.cols), texels or (slice(None), slice(None)), strict=True):
        start, stop, _ = span.indices(n)
        inside &= (place >= max(start - 1, 0)) & (place <= min(stop + 1, n))  # a texel's light ends at its neighbours' centres
    index = torch.nonzero(inside)[:, 0]
    away = T_world_headlight[:3, 3:].to(position) - position.index_select(1, index)  # [3, M]
    factor = lux_per_cd(away, normal.index_select(1, index))
    lit = torch.nonzero(factor > 0)[:, 0]
    if triangles is not None:
        lit = lit[sees(triangles, T_world_headlight[:3, 3], position[:, index[lit]])]
    index, away, factor = index[lit], away.index_select(1, lit), factor[lit]
    texel, weight = bilinear(headlight, row[index], col[index])
    beta = luminance_factors(gbuffer, index, away)
    if (haze := gbuffer.haze) is not None:
        factor = factor * haze.medium.transmittance(away)
        beta = beta * haze.transmittance.flatten()[index]
    return LitSurface(index, texel, weight, factor, beta)


def luminance_factors(gbuffer: GBuffer, index: Tensor, away: Tensor) -> Tensor:
    """Luminance factor `[M]` of the pixels at flat image index `[M]`, lit from `away` `[3, M]` in m, seen from the view's eye."""
    factor = gbuffer.albedo.flatten()[index]
    if gbuffer.finish is None:
        return factor
    position, normal, material = gbuffer.position.flatten(1), gbuffer.normal.flatten(1), gbuffer.finish.material.flatten()[index]
    eye = gbuffer.finish.eye.view(3, -1)
    for number, each in enumerate(gbuffer.finish.materials):
        part = torch.nonzero(material == number)[:, 0]
        if each.lambertian or not len(part):
            continue
        pixel = index[part]
        to_eye = (eye if eye.shape[1] == 1 else eye[:, pixel]).to(position) - position[:, pixel]
        to_lamp, to_eye = (unit(ray) for ray in (away[:, part], to_eye))
        factor[part] = luminance_factor(each, factor[part], normal[:, pixel], to_lamp, to_eye, gbuffer.finish.lobes)
    return factor


def illuminance(surface: LitSurface, light_texture: Tensor) -> Tensor:
    """Illuminance `[..., M]` in lx of the reached pixels from a light texture `[..., rows, cols]` in cd (T eq. 2.1.5)."""
    intensity = (light_texture.flatten(-2)[..., surface.texel] * surface.weight).sum(-2)
    return intensity * surface.factor


def luminance(surface: LitSurface, light_texture: Tensor) -> Tensor:
    """Luminance `[..., M]` in cd/m^2 of the reached pixels: `L_v = beta E_v / pi` (T 2.1), beta being the luminance factor."""
    return illuminance(surface, light_texture) * surface.luminance_factor / math.pi


@dataclass(frozen=True)
class Transport:
    """Light transport from pixellights to camera pixels of a static scene: camera sampling times headlight matrix.

    matrix: `[M, n_p]`, cd/m^2 at full utilisation. index: `[M]` int64, flat image index, ascending.
    first, last: `[n_p]` int64, first and last of the M pixels that pixellight j reaches.
    """

    matrix: Csr
    index: Tensor
    first: Tensor
    last: Tensor

    def luminance(self, utilisation: Tensor, band: slice | None = None, within: slice | None = None) -> tuple[Tensor, Tensor]:
        """Luminance `[..., m]` in cd/m^2 and flat image index `[m]` of the camera pixels that the pixellights of `band` can reach.

        utilisation: `[..., n_p]`. Without a band all pixellights count; with one the host learns its size (CPU only). within: of the flat
        image, None for all of it.
        """
        if band is not None and band.stop <= band.start:
            return utilisation.new_zeros(*utilisation.shape[:-1], 0), self.index[:0]
        start, stop = (0, self.matrix.n_rows) if within is None else self._rows(within)
        if band is not None:
            low, high = span_of(self.first, self.last, band)
            start, stop = max(start, low), min(stop, high + 1)
        start = min(start, self.matrix.n_rows)
        stop = max(start, stop)
        return multiply(self.matrix.band(start, stop), utilisation), self.index[start:stop]

    def onto(self, crop: tuple[slice, slice], width: int, pixels: Tensor) -> Csr:
        """The part `[h * w, m]` from pixellights `[m]` int64, ascending, to a crop `[h, w]` of an image of this width, in px."""
        (v, u), (low, high) = crop, self._rows(slice(crop[0].start * width, crop[0].stop * width))
        row, column = self.index[low:high] // width - v.start, self.index[low:high] % width - u.start
        inside = torch.nonzero((column >= 0) & (column < u.stop - u.start))[:, 0]
        place = (row * (u.stop - u.start) + column)[inside]
        part = self.matrix.band(low, high).part(inside, pixels)
        begin = torch.searchsorted(place, torch.arange((v.stop - v.start) * (u.stop - u.start) + 1, device=place.device))
        return Csr(part.indptr[begin], part.indices, part.values, part.n_cols)

    def _rows(self, within: slice) -> tuple[int, int]:
        """First row of the matrix and the row after the last whose camera pixels lie within a part of the flat image."""
        low, high = torch.searchsorted(self.index, self.index.new_tensor([within.start, within.stop])).tolist()
        return low, high


def transport(surface: LitSurface, headlight: Headlight, width: int, oversampling: int = 1) -> Transport:
    """Fold sampling, geometry, reflection and the headlight matrix into one sparse matrix (M x n_p).

    width: of the image in px. oversampling: rows of the G-buffer that are averaged to a camera pixel.
    """
    values = (surface.weight * (surface.factor * surface.luminance_factor / (math.pi * oversampling))).T.cpu().numpy()
    pixel = _camera_pixel(surface.index, width, oversampling).cpu().numpy()
    index, row = np.unique(pixel, return_inverse=True)
    entries = (values.ravel(), (np.repeat(row, 4), surface.texel.T.cpu().numpy().ravel()))
    sampling = sp.csr_matrix(entries, shape=(len(index), headlight.rows * headlight.cols))
    device = surface.index.device
    matrix = Csr.from_scipy(sampling @ headlight.matrix.to_scipy(), headlight.matrix.values.dtype).to(device)
    first, last = segment_bounds(matrix.indices, row_of_entries(matrix), headlight.n_pixels)
    return Transport(matrix, torch.from_numpy(index).to(device), first, last)


class TextureSource(Protocol):
    """Gives a module's light texture for a utilisation: its headlight matrix, or the measured light of a real lamp."""

    def light_texture(self, utilisation: Tensor, band: slice | None = None) -> Tensor:
        """Luminous intensity `[..., rows, cols]` in cd of a utilisation `[..., n_p]` in 0..1; band: as of `Headlight.light_texture`."""
        ...


class LastTextures:
    """Cache of a headlight's last light textures, since one exposure is used in several places."""

    def __init__(self, headlight: Headlight) -> None:
        self._headlight = headlight
        self._kept = keeping(KEPT_TEXTURES, self._texture)

    def light_texture(self, utilisation: Tensor, band: slice | None = None) -> Tensor:
        """As `Headlight.light_texture`."""
        if band is not None or utilisation.requires_grad:
            return self._headlight.light_texture(utilisation, band)
        return self._kept(utilisation)

    def _texture(self, utilisation: Tensor) -> Tensor:
        if bool(utilisation.any()):
            return self._headlight.light_texture(utilisation)
        return utilisation.new_zeros(*utilisation.shape[:-1], self._headlight.rows, self._headlight.cols)


class Shadows:
    """Shadow test of points `[3, N]` m for a lamp at `[3]` m; a shadow ray is cast when a point is first asked for."""

    def __init__(self, points: Tensor, lamp_m: Tensor, triangles: Triangles) -> None:
        self.points, self.lamp_m, self.triangles = points, lamp_m, triangles
        self._asked, self._lit = (torch.zeros(points.shape[1], dtype=torch.bool, device=points.device) for _ in range(2))

    def lit(self, index: Tensor) -> Tensor:
        """Whether the lamp sees the points at index `[m]`, `[m]` bool."""
        asked = index[~self._asked[index]]
        if len(asked):
            self._lit[asked] = sees(self.triangles, self.lamp_m, self.points.index_select(1, asked))
            self._asked[asked] = True
        return self._lit[index]


@dataclass(frozen=True)
class DirectTransport:
    """Light transport without a matrix: the light texture is computed and sampled each time, which is faster if a view is lit a few times
    only or illuminance is needed.

    gbuffer: with `oversampling` rows for each of the image. shadows: of the headlight, for all samples. width: of the image in px.
    textures: source of light textures on the headlight's texels, None for the headlight.
    """

    gbuffer: GBuffer
    headlight: Headlight
    T_world_headlight: Tensor
    shadows: Shadows
    width: int
    oversampling: int = 1
    textures: TextureSource | None = None

    @cached_property
    def surface(self) -> LitSurface:
        """All samples that the lamp reaches, those in shadow included."""
        return lit_surface(self.gbuffer, self.headlight, self.T_world_headlight)

    def illuminance(self, utilisation: Tensor, band: slice | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Illuminance `[..., m]` in lx of the lit samples, their flat index `[m]` in the G-buffer and luminance factor `[m]`.

        utilisation: `[..., n_p]`. band: all pixels outside of it are dark. Shadows are tested only where the light texture is not dark,
        everywhere if it has a gradient.
        """
        texture = (self.textures or self.headlight).light_texture(utilisation, band)
        if not (texture.requires_grad or bool(texture.any())):
            nothing = texture.new_empty(0)
            return texture.new_empty(*texture.shape[:-2], 0), nothing.long(), nothing
        surface = self.surface if band is None or texture.requires_grad else self._part_of_surface(texture)
        lx = illuminance(surface, texture)
        lit = torch.arange(len(surface.index), device=lx.device)
        if not lx.requires_grad:
            lit = lit[torch.atleast_2d(lx).flatten(0, -2).any(0)]
        lit = lit[self.shadows.lit(surface.index[lit])]
        return lx[..., lit], surface.index[lit], surface.luminance_factor[lit]

    def luminance(self, utilisation: Tensor, band: slice | None = None, within: slice | None = None) -> tuple[Tensor, Tensor]:
        """Luminance `[..., m]` in cd/m^2 that samples add to the camera pixel at flat image index `[m]`; see `illuminance`.

        within: of the flat image, None for all of it.
        """
        if band is not None and band.stop <= band.start:
            return utilisation.new_zeros(*utilisation.shape[:-1], 0), torch.empty(0, dtype=torch.int64, device=utilisation.device)
        lx, samples, factor = self.illuminance(utilisation, band)
        luminance, pixels = self.reflect(lx, factor), self.pixel(samples)
        if within is None:
            return luminance, pixels
        kept = (pixels >= within.start) & (pixels < within.stop)
        return luminance[..., kept], pixels[kept]

    def reflect(self, lx: Tensor, luminance_factor: Tensor) -> Tensor:
        """Luminance `[..., m]` in cd/m^2 that lit samples add to their pixels. lx: `[..., m]`."""
        return lx * luminance_factor / (math.pi * self.oversampling)

    def pixel(self, samples: Tensor) -> Tensor:
        """Flat image index `[m]` of the camera pixels that take the mean of samples `[m]`."""
        return _camera_pixel(samples, self.width, self.oversampling)

    def central(self, samples: Tensor) -> Tensor:
        """Which samples `[m]` stand for their pixel's centre, `[m]` bool."""
        return samples // self.width % self.oversampling == self.oversampling // 2

    def _part_of_surface(self, texture: Tensor) -> LitSurface:
        """The samples in reach of the lit part of a light texture `[..., rows, cols]`."""
        lit = (texture != 0).view(-1, *texture.shape[-2:]).any(0)
        ends = (torch.nonzero(lit.any(dim))[:, 0].tolist() or [0] for dim in (1, 0))
        rows, cols = (slice(each[0], each[-1] + 1) for each in ends)
        return lit_surface(self.gbuffer, self.headlight, self.T_world_headlight, texels=(rows, cols))


def _camera_pixel(index: Tensor, width: int, oversampling: int) -> Tensor:
    return index // (width * oversampling) * width + index % width


LightTransport = Transport | DirectTransport


class PixelUtilisation(Protocol):
    """Utilisations u `[..., n_p]` in 0..1; band: all pixellights outside of it are dark, None where that is not known."""

    @property
    def u(self) -> Tensor: ...

    @property
    def band(self) -> slice | None: ...


def added_light(
    transports: Sequence[LightTransport], lights: Sequence[PixelUtilisation], base: Tensor, rows: slice | None = None
) -> Tensor:
    """Luminance `[..., height, width]` in cd/m^2 of a camera's pixels: a base `[height, width]` plus one light for each transport.

    rows: of the image, which alone are returned and computed; None for all of them.
    """
    within = rows and slice(rows.start * base.shape[1], rows.stop * base.shape[1])
    base = base if rows is None else base[rows]
    image = base.to(lights[0].u).expand(*lights[0].u.shape[:-1], *base.shape).flatten(-2).clone()
    for transport_, light in zip(transports, lights, strict=True):
        luminance, index = transport_.luminance(light.u, light.band, within)
        image.index_add_(-1, index if within is None else index - within.start, luminance)
    return image.unflatten(-1, base.shape)
