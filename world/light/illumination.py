"""Light on surfaces: `E_v = I_v cos / d^2` with shadows (T eq. 2.1.5), plain on a G-buffer or folded into one sparse matrix."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from world.frames import inverse, transform, unit
from world.headlight import Headlight
from world.materials.brdf import luminance_factor
from world.rendering.gbuffer import GBuffer
from world.rendering.raycast import sees
from world.scene.triangles import Triangles
from world.spmv import Csr, multiply, row_of_entries, segment_bounds
from world.texels import bilinear


@dataclass(frozen=True)
class LitSurface:
    """The part of a G-buffer that the light of a lamp reaches, M pixels in image order.

    index: `[M]` int64, flat image index. texel: `[4, M]` int64 and weight: `[4, M]`, bilinear neighbours in the light texture.
    factor: `[M]`, cos / d^2 in 1/m^2. luminance_factor: `[M]`, albedo of the Lambertian surface that would look as bright.
    """

    index: Tensor
    texel: Tensor
    weight: Tensor
    factor: Tensor
    luminance_factor: Tensor


def reach(gbuffer: GBuffer, headlight: Headlight, T_world_headlight: Tensor, triangles: Triangles | None = None) -> LitSurface:
    """Find what of a G-buffer the lamp at `T_world_headlight` `[4, 4]` can light, and with which geometry.

    triangles: what may throw shadows, by a ray from the lamp to each point; nothing does where it is None.
    The light texture is interpolated bilinearly, clamped within its outer half texel and zero beyond its border.
    """
    position, normal = gbuffer.position.flatten(1), gbuffer.normal.flatten(1)
    local = transform(inverse(T_world_headlight).to(position), position)
    x = local[0]
    row, col = headlight.texel_of(local[1] / x, local[2] / x)
    away = T_world_headlight[:3, 3:].to(position) - position  # [3, height * width]
    d2 = (away * away).sum(0)
    cos = (normal * away).sum(0) / d2.sqrt()  # cos / d^2 of T eq. 2.1.5
    inside = (x > 0) & (row >= 0) & (row <= headlight.rows) & (col >= 0) & (col <= headlight.cols)
    index = torch.nonzero(inside & (cos > 0) & (gbuffer.object_id.flatten() >= 0))[:, 0]
    factor = cos[index] / d2[index]
    if triangles is not None:
        lit = sees(triangles, T_world_headlight[:3, 3], position[:, index])
        index, factor = index[lit], factor[lit]
    texel, weight = bilinear(headlight, row[index], col[index])
    return LitSurface(index, texel, weight, factor, _luminance_factor(gbuffer, index, away[:, index]))


def _luminance_factor(gbuffer: GBuffer, index: Tensor, away: Tensor) -> Tensor:
    """Luminance factor `[M]` of the pixels at flat image index `[M]`, lit from `away` `[3, M]` in m, seen from the view's eye."""
    factor = gbuffer.albedo.flatten()[index]
    if gbuffer.finish is None:
        return factor
    position, normal, material = gbuffer.position.flatten(1), gbuffer.normal.flatten(1), gbuffer.finish.material.flatten()[index]
    for number, each in enumerate(gbuffer.finish.materials):
        part = torch.nonzero(material == number)[:, 0]
        if each.lambertian or not len(part):
            continue
        pixel = index[part]
        to_eye = gbuffer.finish.eye[:, None].to(position) - position[:, pixel]
        to_lamp, to_eye = (unit(ray) for ray in (away[:, part], to_eye))
        factor[part] = luminance_factor(each, factor[part], normal[:, pixel], to_lamp, to_eye)
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
    """Light transport from pixellights to camera pixels: camera sampling times headlight matrix, as long as nothing moves.

    matrix: `[M, n_p]`, cd/m^2 at full utilisation. index: `[M]` int64, flat image index, ascending.
    first, last: `[n_p]` int64, first and last of the M pixels that pixellight j reaches.
    """

    matrix: Csr
    index: Tensor
    first: Tensor
    last: Tensor

    def luminance(self, utilisation: Tensor, band: slice | None = None) -> tuple[Tensor, Tensor]:
        """Luminance `[..., m]` in cd/m^2 and flat image index `[m]` of the camera pixels that the pixellights of `band` can reach.

        utilisation: `[..., n_p]`. Without a band all pixellights count; with one the host learns its size (CPU only).
        """
        if band is None:
            return multiply(self.matrix, utilisation), self.index
        if band.stop <= band.start:
            return utilisation.new_zeros(*utilisation.shape[:-1], 0), self.index[:0]
        start = min(int(self.first[band].min()), self.matrix.n_rows)
        stop = max(int(self.last[band].max()) + 1, start)
        return multiply(self.matrix.band(start, stop), utilisation), self.index[start:stop]

    def within(self, start: int, stop: int) -> "Transport":
        """The part to the camera pixels of flat image index start to stop, which count from start."""
        low, high = torch.searchsorted(self.index, self.index.new_tensor([start, stop])).tolist()
        first, last = (self.first - low).clamp(min=0), (self.last - low).clamp(max=high - low - 1)
        return Transport(self.matrix.band(low, high), self.index[low:high] - start, first, last)


def transport(surface: LitSurface, headlight: Headlight, width: int, oversampling: int = 1) -> Transport:
    """Fold sampling, geometry, reflection and the headlight matrix into one sparse matrix (M x n_p).

    width: of the image in px. oversampling: image rows of the G-buffer that a camera pixel takes the mean of.
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


class Shadows:
    """Which points `[3, N]` m a lamp at `[3]` m lights past all triangles: a ray is cast to each when it is first asked for."""

    def __init__(self, points: Tensor, lamp_m: Tensor, triangles: Triangles) -> None:
        self.points, self.lamp_m, self.triangles = points, lamp_m, triangles
        self._asked, self._lit = (torch.zeros(points.shape[1], dtype=torch.bool, device=points.device) for _ in range(2))

    def spare(self, index: Tensor) -> Tensor:
        """`[m]` bool, of points at index `[m]`."""
        asked = index[~self._asked[index]]
        if len(asked):
            self._lit[asked] = sees(self.triangles, self.lamp_m, self.points[:, asked])
            self._asked[asked] = True
        return self._lit[index]


@dataclass(frozen=True)
class DirectTransport:
    """The same without a matrix: the light texture is made and sampled each time, which pays where a view is lit a few times only, or where
    illuminance is asked for.

    surface: M samples, those in shadow included. index: `[M]` int64, flat image index of the camera pixel that takes the mean of
    `oversampling` samples. central: `[M]` bool, which of them stands for the pixel's centre. shadows: on all samples of the view.
    """

    surface: LitSurface
    index: Tensor
    central: Tensor
    oversampling: int
    headlight: Headlight
    shadows: Shadows

    @classmethod
    def of(
        cls, gbuffer: GBuffer, headlight: Headlight, T_world_headlight: Tensor, shadows: Shadows, width: int, oversampling: int = 1
    ) -> "DirectTransport":
        """Parameters as of `reach` and `transport`; shadows: in the light from where the headlight is, on the whole G-buffer."""
        surface = reach(gbuffer, headlight, T_world_headlight)
        central = surface.index // width % oversampling == oversampling // 2
        return cls(surface, _camera_pixel(surface.index, width, oversampling), central, oversampling, headlight, shadows)

    def illuminance(self, utilisation: Tensor) -> tuple[Tensor, Tensor]:
        """Illuminance `[..., m]` in lx of samples `[m]`, the others are dark.

        utilisation: `[..., n_p]`. Shadows are looked for only where the light texture is not dark, and everywhere if it has a gradient.
        """
        lx = illuminance(self.surface, self.headlight.light_texture(utilisation))
        lit = torch.arange(len(self.index), device=lx.device)
        if not lx.requires_grad:
            lit = lit[torch.atleast_2d(lx).flatten(0, -2).any(0)]
        lit = lit[self.shadows.spare(self.surface.index[lit])]
        return lx[..., lit], lit

    def luminance(self, utilisation: Tensor, band: slice | None = None) -> tuple[Tensor, Tensor]:
        """Luminance `[..., m]` in cd/m^2 that samples add to the camera pixel at flat image index `[m]`; see `illuminance`.

        band: nothing is lit if it is empty; else it changes nothing.
        """
        if band is not None and band.stop <= band.start:
            return utilisation.new_zeros(*utilisation.shape[:-1], 0), self.index[:0]
        return self.reflected(*self.illuminance(utilisation))

    def reflected(self, lx: Tensor, samples: Tensor) -> tuple[Tensor, Tensor]:
        """The luminance that `illuminance` makes, and where; see `luminance`."""
        return lx * self.surface.luminance_factor[samples] / (math.pi * self.oversampling), self.index[samples]


def _camera_pixel(index: Tensor, width: int, oversampling: int) -> Tensor:
    return index // (width * oversampling) * width + index % width


class LightTransport(Protocol):
    """From one module's utilisation `[..., n_p]` to luminances `[..., m]` in cd/m^2 and the flat image indices `[m]` that they add to."""

    def luminance(self, utilisation: Tensor, band: slice | None = None) -> tuple[Tensor, Tensor]: ...


class Light(Protocol):
    """Utilisations u `[..., n_p]` in 0..1; band: all pixellights outside of it are dark, None where that is not known."""

    @property
    def u(self) -> Tensor: ...

    @property
    def band(self) -> slice | None: ...


def added_light(transports: Sequence[LightTransport], lights: Sequence[Light], base: Tensor) -> Tensor:
    """Luminance `[..., height, width]` in cd/m^2 of a camera's pixels: that of one light a transport on top of a base `[height, width]`."""
    image = base.to(lights[0].u).expand(*lights[0].u.shape[:-1], *base.shape).flatten(-2).clone()
    for transport_, light in zip(transports, lights, strict=True):
        luminance, index = transport_.luminance(light.u, light.band)
        image.index_add_(-1, index, luminance)
    return image.unflatten(-1, base.shape)
