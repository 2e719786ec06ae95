"""Conversion of a camera's picture to the scenario's image: decoding, grey, rectification or crop, and digital numbers."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from luxloop.loop.rig.arrays import Array, Data, Image
from luxloop.loop.rig.params import RigParams
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.world.arrays import read_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import reading, regular
from luxloop.world.images import decode

AS_SENT = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION  # the calibration covers a camera mounted upside down
GREY = cv2.IMREAD_GRAYSCALE | AS_SENT
REMEDY = "set camera.width_px and camera.height_px of the scenario, or camera.crop of the rig file"
AGAIN = "run `luxloop rig calibrate` again"


Rectify = Callable[[Data], Image]  # raises WrongPicture where there is no image


class WrongPicture(LuxloopError):
    """A picture that cannot be a frame of the scenario's camera."""


@dataclass(frozen=True, eq=False)
class Lens:
    """Lens of a calibration, for rectifying pictures.

    size: width and height of the pictures in px. matrix, distortion: `[3, 3]` and `[n]`, OpenCV's. response: share of the saturation by
    code `[2^bits]`, None for a linear camera.
    """

    size: tuple[int, int]
    matrix: Array
    distortion: Array
    response: Image | None = None


def rectifier(rig: RigParams, camera: CameraParams) -> Rectify:
    """Conversion of a camera's picture to the scenario's image `[height, width]` in digital numbers. camera: the scenario's.

    Raises LuxloopError if the calibration file cannot be read, or `crop` does not fit.
    """
    lens = None if rig.calibration is None else load_lens(rig.calibration.file)
    crop, size, maps = rig.camera.crop, (camera.width_px, camera.height_px), None
    if lens is not None:
        if crop is not None:
            raise LuxloopError("camera.crop: the calibration gives the scenario's image as a whole; leave crop out")
        view = camera_view(camera)
        pinhole = np.array([[view.fx, 0, view.cx - 0.5], [0, view.fy, view.cy - 0.5], [0, 0, 1]])  # OpenCV counts from pixels' centres
        maps = cv2.initUndistortRectifyMap(lens.matrix, lens.distortion, np.eye(3), pinhole, size, cv2.CV_32FC1)
    elif crop is not None and (crop.width_px, crop.height_px) != size:
        raise LuxloopError(
            f"camera.crop: is {crop.width_px} x {crop.height_px} px, but the scenario's image has {size[0]} x {size[1]}; "
            f"set its camera.width_px = {crop.width_px} and camera.height_px = {crop.height_px}"
        )

    def image(data: Data) -> Image:
        picture = grey(data)
        height, width = picture.shape
        if lens is not None and (width, height) != lens.size:
            raise WrongPicture(f"camera: a picture of {width} x {height} px, where the calibration is of {_times(lens.size)}")
        if lens is None:
            u, v = (0, 0) if crop is None else (crop.u_px, crop.v_px)
            if (width - u < size[0] or height - v < size[1]) if crop else ((width, height) != size):
                raise WrongPicture(f"camera: a picture of {width} x {height} px, where the scenario's image has {_times(size)}; {REMEDY}")
            picture = picture[v : v + size[1], u : u + size[0]]
        share = _linear(picture, rig.camera.bits or 8 * picture.dtype.itemsize, None if lens is None else lens.response, camera.gamma)
        if maps is not None:
            share = cv2.remap(share, *maps, cv2.INTER_LINEAR).astype(np.float32, copy=False)
        levels = 2**camera.bits - 1
        return np.clip(np.rint(share * np.float32(levels)), 0, levels).astype(np.float32)

    return image


def _linear(picture: Image, bits: int, response: Image | None, gamma: float) -> Image:
    """Codes as shares of the largest; with a calibrated response, converted to the response of the scenario's camera."""
    if response is None:
        return np.minimum(picture.astype(np.float32) / np.float32(2**bits - 1), 1)
    if len(response) != 2**bits:
        raise WrongPicture(f"camera: pictures of {bits} bits, where the calibration's response has {len(response)} numbers; {AGAIN}")
    light = response[np.minimum(picture, len(response) - 1)]
    return light if gamma == 1 else light ** np.float32(1 / gamma)


def grey(data: Data) -> Image:
    """Grey codes `[height, width]` of an encoded or raw picture. Raises WrongPicture if it is damaged or too large."""
    if isinstance(data, bytes):
        return camera_picture(data, GREY)
    if data.ndim == 3:
        return cv2.cvtColor(np.ascontiguousarray(data[..., :3]), cv2.COLOR_BGR2GRAY)
    return data


def camera_picture(data: bytes, flags: int) -> Image:
    """An encoded picture, decoded by OpenCV with these flags. Raises WrongPicture if it is damaged, even in part, or too large."""
    try:
        picture = decode(data, "camera: a picture", flags)
    except LuxloopError as error:
        raise WrongPicture(str(error)) from error
    if picture is None:
        raise WrongPicture("camera: a picture is damaged")
    return picture


def load_lens(file: Path) -> Lens:
    """Lens of a calibration file: `size_px` `[2]`, `camera_matrix` `[3, 3]`, `distortion` `[n]`, and `response` `[2^bits]` if it was
    measured.

    Raises LuxloopError if the file cannot be read.
    """
    with reading(file, "no calibration of a rig", AGAIN):
        arrays = read_npz(regular(file))
        width, height = (int(value) for value in arrays["size_px"])
        matrix, distortion = (np.asarray(arrays[key], np.float64) for key in ("camera_matrix", "distortion"))
        response = np.asarray(arrays["response"], np.float32) if "response" in arrays else None
        if matrix.shape != (3, 3) or distortion.size not in (4, 5, 8, 12, 14) or not (0 < width <= 16384 and 0 < height <= 16384):
            raise ValueError("camera_matrix is no [3, 3], distortion has no 4, 5, 8, 12 or 14 numbers, or size_px is none")
        if not (np.isfinite(matrix).all() and np.isfinite(distortion).all()):
            raise ValueError("a number is not finite")
        if response is not None and not (
            response.ndim == 1 and 256 <= len(response) <= 65536 and ((response >= 0) & (response <= 1)).all()
        ):
            raise ValueError("response is no [256] to [65536] of shares")
        return Lens((width, height), matrix, distortion.ravel(), response)


def _times(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"
