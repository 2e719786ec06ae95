"""Utilisations of a module's pixels from files, as other programs write them."""

from pathlib import Path

import cv2
import numpy as np

from world.errors import LuxloopError
from world.files import UNREADABLE
from world.photometry.distribution import Array
from world.pixel_tables import separators


def read_utilisation(path: Path, rows: int, columns: int) -> Array:
    """Utilisations `[rows * columns]` in 0..1 of a .npy (`[rows, columns]` or flat), .csv (a line a row) or grey .png (white is 1).

    Raises: LuxloopError that names the file and what is wrong in it.
    """
    readers = {".npy": _npy, ".csv": _csv, ".png": _png}
    if path.suffix.lower() not in readers:
        raise LuxloopError(f"{path}: utilisations are .npy, .csv or .png files; save them as one of these")
    try:
        given: Array = readers[path.suffix.lower()](path)
    except OSError as error:
        raise LuxloopError(f"{path}: cannot be read ({error.strerror or error}); check the path") from error
    except UNREADABLE as error:
        raise LuxloopError(f"{path}: holds no utilisations ({error}); save numbers from 0 to 1") from error
    if given.shape not in ((rows, columns), (rows * columns,)):
        size = " x ".join(map(str, given.shape))
        raise LuxloopError(f"{path}: holds {size} utilisations, but the module has {rows} x {columns} pixels; bring them to this size")
    if not ((given >= 0) & (given <= 1)).all():
        raise LuxloopError(f"{path}: utilisations lie between 0 and 1, not {given.min():g} and {given.max():g}; divide by the largest")
    return given.ravel()


def _npy(path: Path) -> Array:
    with path.open("rb") as stream:
        given = np.lib.format.read_array(stream, allow_pickle=False)
    if given.dtype.kind not in "biuf":
        raise ValueError("no real numbers")
    return np.asarray(given, np.float64)


def _csv(path: Path) -> Array:
    delimiter, decimal_point = separators(path)
    lines = [line.replace(decimal_point, ".") for line in path.read_text("utf-8-sig").splitlines() if line.strip()]
    if not lines:
        raise ValueError("no lines")
    return np.loadtxt(lines, delimiter=delimiter, comments=None, ndmin=2)


def _png(path: Path) -> Array:
    data = np.frombuffer(path.read_bytes(), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH) if len(data) else None
    if image is None:
        raise ValueError("no picture")
    return np.asarray(image, np.float64) / (65535 if image.dtype == np.uint16 else 255)
