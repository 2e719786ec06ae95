"""From a picture of the screen to the light texture of a module (T 4.3), by the geometry of the calibration."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, Self

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.loop.rig.calibration.files import Calibration
from luxloop.loop.rig.calibration.geometry import Geometry, on_plane
from luxloop.loop.rig.calibration.intrinsics import brightness
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.texels import TexelGrid

Picture = NDArray[Any]
SEEN: Final = 0.5  # least share of the texels that the camera has to see
ONE_FORMAT: Final = "camera: gives pictures in grey and in colour by turns; set it to one of them"
SATURATED: Final = 0.98  # of the largest digital number, from which on a pixel counts as saturated


@dataclass(frozen=True, eq=False)
class Digitiser:
    """Samples a camera's picture where the light of the texels falls on the screen, and converts it to luminous intensity.

    u, v: `[rows, cols]` float32, these positions in px, pixel centres at integers. candela: `[rows, cols]` float32, intensity in cd that
    saturates the camera there, 0 where the camera does not see the screen. curve: `[levels + 1]` float32, light of a digital number
    relative to saturation. shape: height and width of the picture in px. dark: light without the lamp in the part of the picture that is
    read, as `light` returns it, or 0.
    """

    u: NDArray[np.float32]
    v: NDArray[np.float32]
    candela: NDArray[np.float32]
    curve: NDArray[np.float32]
    shape: tuple[int, int]
    dark: NDArray[np.float32] | float = 0.0

    @classmethod
    def of(cls, calibration: Calibration, module: str, grid: TexelGrid) -> Self:
        """module: its name in the calibration. grid: of its light texture. Raises LuxloopError if the calibration lacks the module or the
        scale, or if the camera sees less than half of the texels.
        """
        if calibration.lux is None:
            raise LuxloopError("has no scale; run `luxloop rig calibrate` again with a reading of a luxmeter, --lux LUX@U,V")
        geometry, camera = calibration.geometry(module), calibration.camera
        y, z = (each.numpy() for each in grid.tangents(torch.float64, torch.device("cpu")))
        places, candela = _falling(geometry, y, z)
        u, v = camera.project(places).T.reshape(2, grid.rows, grid.cols) - 0.5  # OpenCV's maps count from pixels' centres
        ahead = (places[:, 2] > 0).reshape(grid.rows, grid.cols) & np.isfinite(u) & np.isfinite(v)
        seen = ahead & (u >= 0) & (v >= 0) & (u <= camera.width - 1) & (v <= camera.height - 1)
        if seen.mean() < SEEN:
            raise LuxloopError(
                f"by it the camera sees {seen.mean():.0%} of the light of {module!r} on the screen; calibrate with a camera that sees all"
            )
        shade = brightness(calibration.vignetting, camera.height, camera.width).astype(np.float32)
        u, v = (np.where(seen, each, 0).astype(np.float32) for each in (u, v))
        factor = calibration.lux * candela.reshape(seen.shape) / cv2.remap(shade, u, v, cv2.INTER_LINEAR)
        return cls(u, v, np.where(seen, factor, 0).astype(np.float32), calibration.response.curve, (camera.height, camera.width))

    @property
    def seen(self) -> float:
        """Share of the texels whose light the camera sees, 0..1."""
        return float((self.candela > 0).mean())

    def without(self, pictures: Picture) -> Self:
        """A digitiser that also subtracts the mean light of pictures `[n, height, width]` or `[n, height, width, 3]` without the lamp."""
        return replace(self, dark=np.mean([self.light(each) for each in pictures], 0, np.float32))

    def light(self, picture: Picture) -> NDArray[np.float32]:
        """Linear light of digital numbers in the part of the picture that is read, relative to saturation.

        Raises LuxloopError if the picture has another size or larger numbers than the calibration's camera.
        """
        if picture.shape[:2] != self.shape:
            raise LuxloopError(f"is of {self.shape[1]} x {self.shape[0]} px, but the camera has {picture.shape[1]} x {picture.shape[0]} px")
        part = picture[self._part]
        try:
            return self.curve[part if part.dtype.kind == "u" else part.astype(np.uint16)]
        except IndexError as error:
            raise LuxloopError(f"has the response of numbers up to {len(self.curve) - 1}, but the camera gives {part.max():.0f}") from error

    def saturated(self, picture: Picture) -> float:
        """Share of saturated pixels in the part that is read, 0..1."""
        return float((picture[self._part] >= SATURATED * (len(self.curve) - 1)).mean())

    def texture(self, picture: Picture) -> Tensor:
        """Light texture `[rows, cols]` in cd of a grey picture `[height, width]`, or `[3, rows, cols]` in linear sRGB of a colour picture
        `[height, width, 3]` (blue, green, red). Raises LuxloopError as `light`, and if the dark pictures had another number of channels.
        """
        if isinstance(self.dark, np.ndarray) and self.dark.ndim != picture.ndim:
            raise LuxloopError(ONE_FORMAT)
        lit = cv2.remap(self.light(picture) - self.dark, *self._maps, cv2.INTER_LINEAR).clip(0)  # noise has no sign in the dark
        if lit.ndim == 2:
            return torch.from_numpy(lit * self.candela)
        return torch.from_numpy(lit).flip(2).permute(2, 0, 1) * torch.from_numpy(self.candela)

    @cached_property
    def _part(self) -> tuple[slice, slice]:
        """Rows and columns of the picture that are read."""
        seen = self.candela > 0
        spans = ((each[seen].min(), each[seen].max(), n) for each, n in zip((self.v, self.u), self.shape, strict=True))
        v, u = (slice(int(low), min(int(high) + 2, n)) for low, high, n in spans)
        return v, u

    @cached_property
    def _maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """u and v, counted from the start of that part."""
        rows, cols = self._part
        return self.u - np.float32(cols.start), self.v - np.float32(rows.start)


def luminous(texture: Tensor) -> Tensor:
    """Light texture `[rows, cols]` in cd of a colour texture `[3, rows, cols]` in linear sRGB; a grey texture is returned unchanged."""
    return texture if texture.ndim == 2 else torch.tensordot(texture.new_tensor(LUMINANCE), texture, 1)


def _falling(geometry: Geometry, y: NDArray[np.floating], z: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Points on the screen lit by the texels at tangents y `[cols]` and z `[rows]`, `[rows * cols, 3]` m in the camera's frame, and cd per
    lx there, `[rows * cols]`, from `I = E d^2 / cos` (T eq. 2.1.5); 0 where the light does not meet the screen.
    """
    lamp, screen = geometry.lamp, geometry.screens[0]
    zz, yy = np.meshgrid(z, y, indexing="ij")
    rays = np.stack([np.ones(yy.size), yy.ravel(), zz.ravel()], -1) @ lamp.rotation.T
    places = on_plane(rays, lamp.place, screen)
    away = places - lamp.place
    distance = np.linalg.norm(away, axis=1)
    cos = np.abs(away @ screen.rotation[:, 2]) / distance
    falls = (away * rays).sum(1) > 0
    return places, np.where(falls, distance**2 / cos, 0.0)
