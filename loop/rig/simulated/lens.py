"""The lens: direction of each pixel, and blur, scattered light and vignetting."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from luxloop.loop.rig.arrays import Array, Image
from luxloop.loop.rig.simulated.faults import LensParams
from luxloop.perception.camera import CameraParams
from luxloop.world.errors import LuxloopError

MARGIN_PX = 2
LARGEST = 3.0  # largest pinhole picture for the lens' field, as a multiple of the camera's picture
MOST_ERROR_PX = 0.01  # of an inverted distortion
INVERSION = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)  # of the distortion: steps, error
RED_GREEN_BLUE = ((1, 0.25), (0, 0.5), (-1, 0.25))  # sign of the magnification, share of a grey pixel's light
VEIL_SCALE = 8  # factor of the coarser picture for widely scattered light


@dataclass(frozen=True, eq=False)
class Lens:
    """A lens, as a mapping of a pinhole picture.

    camera: pinhole camera with the lens' whole field. width, height: px of the lens' picture. maps: for each colour the position in the
    pinhole picture of each pixel, `[height, width]` twice, and its share of the light; empty without distortion. falloff: `[height,
    width]`, transmission by vignetting.
    """

    params: LensParams
    camera: CameraParams
    width: int
    height: int
    maps: tuple[tuple[Image, Image, float], ...]
    falloff: Image | None

    @classmethod
    def of(cls, params: LensParams, camera: CameraParams) -> "Lens":
        """Lens of a camera. Raises LuxloopError if the coefficients fold the picture, or the field is too wide."""
        width, height, focal = camera.width_px, camera.height_px, camera.focal_px
        centre = np.array([width / 2 + params.centre_px[0], height / 2 + params.centre_px[1]])
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        radius = np.hypot(u - centre[0], v - centre[1])
        falloff = (1 - params.vignetting * (radius / radius.max()) ** 2).astype(np.float32) if params.vignetting else None
        if not (any(params.coefficients) or any(params.centre_px) or params.chromatic_percent):
            return cls(params, camera, width, height, (), falloff)
        seen = (np.stack([u.ravel(), v.ravel()], 1) - centre) / focal
        colours = [(0, 1.0)] if params.chromatic_percent == 0 else RED_GREEN_BLUE
        straight = [(undistort(params, seen / (1 + sign * params.chromatic_percent / 100), focal), share) for sign, share in colours]
        reach = [np.abs(places).max(0) for places, _ in straight]
        half_width, half_height = (math.ceil(float(each) * focal) + MARGIN_PX for each in np.max(reach, 0))
        if half_width > LARGEST * width / 2 or half_height > LARGEST * height / 2:
            raise LuxloopError(
                f"lens: it sees {2 * half_width} x {2 * half_height} px of a straight picture, more than {LARGEST:g} times the camera's "
                f"{width} x {height}; give weaker coefficients or a smaller centre_px"
            )
        wide = {"width_px": 2 * half_width, "height_px": 2 * half_height, "hfov_deg": math.degrees(2 * math.atan(half_width / focal))}
        corner = np.array([half_width, half_height]) - 0.5  # OpenCV counts from a pixel's centre
        maps = []
        for places, share in straight:
            x, y = (places * focal + corner).astype(np.float32).reshape(height, width, 2).transpose(2, 0, 1)
            maps.append((np.ascontiguousarray(x), np.ascontiguousarray(y), share))
        return cls(params, camera.model_copy(update=wide), width, height, tuple(maps), falloff)

    def image(self, luminance: Image) -> Image:
        """Image on the sensor, `[height, width]`, of a pinhole picture in cd/m^2."""
        seen: Any = luminance
        params = self.params
        if self.maps:
            seen = sum(np.float32(share) * cv2.remap(luminance, x, y, cv2.INTER_LINEAR) for x, y, share in self.maps)
        if params.blur_px:
            seen = cv2.GaussianBlur(seen, (0, 0), params.blur_px)
        if params.veil:
            coarse = cv2.resize(seen, (-(-self.width // VEIL_SCALE), -(-self.height // VEIL_SCALE)), interpolation=cv2.INTER_AREA)
            scattered = cv2.resize(cv2.GaussianBlur(coarse, (0, 0), params.veil_px / VEIL_SCALE), (self.width, self.height))
            seen = cv2.addWeighted(seen, 1 - params.veil, scattered, params.veil, 0)
        falling: Image = seen if self.falloff is None else seen * self.falloff
        return falling

    @property
    def matrix(self) -> Array:
        """The camera matrix `[3, 3]` in px; pixel centres are at integer + 0.5."""
        focal = self.camera.focal_px
        u, v = self.width / 2 + self.params.centre_px[0], self.height / 2 + self.params.centre_px[1]
        return np.array([[focal, 0, u], [0, focal, v], [0, 0, 1]])


def undistort(params: LensParams, seen: Array, focal: float) -> Array:
    """Pinhole positions of lens positions `seen`, both `[N, 2]` at focal length 1.

    focal: in px, for the permitted error. Raises LuxloopError if the coefficients fold the picture.
    """
    if not any(params.coefficients) and params.model != "fisheye":
        return seen
    with np.errstate(all="ignore"):
        if params.model == "division":
            straight = seen / (1 + params.k[0] * (seen**2).sum(1, keepdims=True))
        elif params.model == "fisheye":
            straight = cv2.fisheye.undistortPoints(seen[:, None], np.eye(3), params.k, criteria=INVERSION)[:, 0]
        else:
            straight = cv2.undistortPoints(seen[:, None], np.eye(3), params.k, criteria=INVERSION)[:, 0]
        error = np.abs(distort(params, straight) - seen).max() * focal
        turned = (straight * seen).sum(1)
    if not (error < MOST_ERROR_PX and (turned >= 0).all()):
        raise LuxloopError(f"lens.coefficients: {list(params.coefficients)} fold the picture of the model {params.model}; give weaker ones")
    return straight


def distort(params: LensParams, straight: Array) -> Array:
    """Lens positions of pinhole positions, both `[N, 2]` at focal length 1: the inverse of `undistort`."""
    if params.model == "opencv":
        points = np.insert(straight, 2, 1, 1)
        return np.asarray(cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), params.k)[0][:, 0], np.float64)
    if params.model == "fisheye":
        return np.asarray(cv2.fisheye.distortPoints(straight[:, None], np.eye(3), params.k)[:, 0], np.float64)
    radius = np.linalg.norm(straight, axis=1, keepdims=True)
    root = np.sqrt(1 - 4 * params.k[0] * radius**2)  # r_straight = r / (1 + k r^2), the smaller root of k r_straight r^2 - r + r_straight
    return straight * (2 / (1 + root))
