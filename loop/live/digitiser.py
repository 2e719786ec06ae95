"""From a picture of the screen to the light texture of a module (T 4.3): where each texel's light falls is known from the calibration."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, Self

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from loop.calibration.files import Calibration
from loop.calibration.geometry import Geometry, on_plane
from loop.calibration.intrinsics import brightness
from world.errors import LuxloopError
from world.headlight.matrix import LUMINANCE
from world.texels import TexelGrid

Picture = NDArray[Any]
SEEN: Final = 0.5  # least share of the texels that the camera has to see
ONE_FORMAT: Final = "camera: gives pictures in grey and in colour by turns; set it to one of them"
SATURATED: Final = 0.98  # of the largest digital number, from which on a pixel counts as saturated


@dataclass(frozen=True, eq=False)
class Digitiser:
    """Reads a camera's picture at the places where the light of the texels falls on the screen, and makes candela of it.

    u, v: `[rows, cols]` float32, these places in px, pixel centres at whole numbers. candela: `[rows, cols]` float32, cd of the
    light that saturates the camera there, 0 where it does not see the screen. curve: `[levels + 1]` float32, light of a digital number as
    a share of that. shape: height and
    width of the picture in px. dark: light without the lamp in the part of the picture that is read, as `light` gives it, or 0.
    """

    u: NDArray[np.float32]
    v: NDArray[np.float32]
    candela: NDArray[np.float32]
    curve: NDArray[np.float32]
    shape: tuple[int, int]
    dark: NDArray[np.float32] | float = 0.0

    @classmethod
    def of(cls, calibration: Calibration, module: str, grid: TexelGrid) -> Self:
        """grid: of the module's light texture. Raises LuxloopError where the calibration lacks the module or its scale, or where the camera
        sees less than half of the texels.
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
        """Share of the texels whose light the camera sees."""
        return float((self.candela > 0).mean())

    def without(self, pictures: Picture) -> Self:
        """The same that subtracts the light of pictures `[n, height, width]` or `[n, height, width, 3]` without the lamp."""
        return replace(self, dark=np.mean([self.light(each) for each in pictures], 0, np.float32))

    def light(self, picture: Picture) -> NDArray[np.float32]:
        """Light of digital numbers in the part of the picture that is read.

        Raises LuxloopError where the picture has another size or larger numbers than the calibration's camera.
        """
        if picture.shape[:2] != self.shape:
            raise LuxloopError(f"is of {self.shape[1]} x {self.shape[0]} px, but the camera has {picture.shape[1]} x {picture.shape[0]} px")
        part = picture[self._part]
        try:
            return self.curve[part if part.dtype.kind == "u" else part.astype(np.uint16)]
        except IndexError as error:
            raise LuxloopError(f"has the response of numbers up to {len(self.curve) - 1}, but the camera gives {part.max():.0f}") from error

    def saturated(self, picture: Picture) -> float:
        """Share of the pixels of the part that is read which are saturated."""
        return float((picture[self._part] >= SATURATED * (len(self.curve) - 1)).mean())

    def texture(self, picture: Picture) -> Tensor:
        """Light texture `[rows, cols]` in cd of a grey picture `[height, width]`, `[3, rows, cols]` in linear sRGB of a colour one
        `[height, width, 3]` (blue, green, red). Raises as `light`.
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
        """u and v in that part."""
        rows, cols = self._part
        return self.u - np.float32(cols.start), self.v - np.float32(rows.start)


def luminous(texture: Tensor) -> Tensor:
    """Light texture `[rows, cols]` in cd of one in linear sRGB `[3, rows, cols]`, or as it is where it has no colour."""
    return texture if texture.ndim == 2 else torch.tensordot(texture.new_tensor(LUMINANCE), texture, 1)


def _falling(geometry: Geometry, y: NDArray[np.floating], z: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Where the light of texels at tangents y `[cols]` and z `[rows]` falls on the screen, `[rows * cols, 3]` m in the camera's frame, and
    cd for each lx there, `[rows * cols]`: `I = E d^2 / cos` (T eq. 2.1.5); 0 where it falls nowhere.
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
