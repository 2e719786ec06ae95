"""Utilisations of a module's pixels from files: constant, or a sequence over time."""

import glob
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from luxloop.world.arrays import read_npy, read_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import afford, content, reading
from luxloop.world.headlight.sources import separators
from luxloop.world.images import decode
from luxloop.world.photometry.distribution import Array
from luxloop.world.symbols import FOLDER_HZ, VIDEOS, frame_at, video

BYTES_A_VALUE = 8  # of a sequence: single precision, and its frames beside it until they are joined


@dataclass(frozen=True, eq=False)
class RawUtilisation:
    """Frames `[n, n_p]` in 0..1 one after the other. rate_hz: frames a second. repeat: start over at the end, or hold the last."""

    frames: Tensor
    rate_hz: float
    repeat: bool = True

    def at(self, time_s: float) -> Tensor:
        """Utilisation `[n_p]` at a time."""
        return self.frames[frame_at(len(self.frames), time_s, self.rate_hz, self.repeat)]


def read_sequence(path: Path, rows: int, columns: int, rate_hz: float | None = None, repeat: bool = True) -> RawUtilisation:
    """Utilisations over time from a file of `read_utilisation`, an array `[n, rows, columns]`, a folder or pattern of files, or a video.

    rate_hz: frames a second; left out: a video's own, else 25. Raises LuxloopError that names the file and what is wrong in it.
    """
    own_hz, parts = _video(path) if path.suffix.lower() in VIDEOS else (FOLDER_HZ, map(_read, sequence_files(path)))
    frames, n_values = [], 0
    for file, part in zip(sequence_files(path), parts, strict=True):
        frames.append(_on_grid(file, part, rows, columns).astype(np.float32))
        n_values += frames[-1].size
        afford(f"{path}: its frames", BYTES_A_VALUE * n_values, "cut it to the part that shall be shown")
    return RawUtilisation(torch.from_numpy(np.concatenate(frames)), rate_hz or own_hz, repeat)


def sequence_files(path: Path) -> list[Path]:
    """The files of a sequence in the order of their names: those of a folder or of a pattern such as `frames/*.png`, or the file itself.

    Raises LuxloopError where there are none.
    """
    if os.path.isdir(path):
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in READERS)
    elif glob.has_magic(str(path)):
        files = sorted(map(Path, glob.glob(str(path))))
    else:
        return [path]
    if not files:
        raise LuxloopError(
            f"{path}: there are no utilisations ({', '.join(READERS)}) here; check the path, or put a numbered sequence there"
        )
    return files


def read_utilisation(path: Path, rows: int, columns: int) -> Array:
    """Utilisations `[rows * columns]` in 0..1 of a .npy or .npz (`[rows, columns]` or flat), .csv (a line a row) or grey .png (white is 1).

    Raises LuxloopError that names the file and what is wrong in it.
    """
    given = _read(path)
    if given.ndim > 2:
        raise LuxloopError(f"{path}: holds {_size(given)} utilisations, a sequence, but one {rows} x {columns} picture is wanted; save one")
    flat: Array = _on_grid(path, given, rows, columns)[0]
    return flat


def _read(path: Path) -> Array:
    if path.suffix.lower() not in READERS:
        raise LuxloopError(f"{path}: utilisations are {', '.join(READERS)} files and videos; save them as one of these")
    with reading(path, "holds no utilisations", "save numbers from 0 to 1"):
        return READERS[path.suffix.lower()](path)


def _on_grid(path: Path, given: Array, rows: int, columns: int) -> Array:
    """Frames `[n, rows * columns]`, checked."""
    if given.shape not in ((rows, columns), (rows * columns,)) and not (
        given.ndim == 3 and len(given) and given.shape[1:] == (rows, columns)
    ):
        raise LuxloopError(
            f"{path}: holds {_size(given)} utilisations, but the module has {rows} x {columns} pixels; bring them to this size"
        )
    frames: Array = given.reshape(-1, rows * columns)
    if (bad := ~((frames >= 0) & (frames < np.inf))).any():
        frame, pixel = np.argwhere(bad)[0]
        place = f"row {pixel // columns}, column {pixel % columns}" + (f" of frame {frame}" if len(frames) > 1 else "")
        more = f" (and {bad.sum() - 1} more)" if bad.sum() > 1 else ""
        raise LuxloopError(f"{path}: the utilisation at {place}, from 0, is {frames[frame, pixel]:g}{more}, not from 0 to 1; set it to 0")
    if frames.max() > 1:
        raise LuxloopError(f"{path}: utilisations lie between 0 and 1, not {frames.min():g} and {frames.max():g}; divide by the largest")
    return frames


def _video(path: Path) -> tuple[float, Iterable[Array]]:
    if not os.path.isfile(path):
        raise LuxloopError(f"{path}: there is no such video; check the path")
    images, rate_hz = video(path, None)
    afford(f"{path}: its frames", 2 * BYTES_A_VALUE * images.numel(), "cut it to the part that shall be shown")
    return rate_hz, [images.numpy() / 255]


def _size(given: Array) -> str:
    return " x ".join(map(str, given.shape))


def _npz(path: Path) -> Array:
    arrays = list(read_npz(path).values())
    if len(arrays) != 1:
        raise ValueError(f"{len(arrays)} arrays in place of one")
    return _numbers(arrays[0])


def _numbers(given: Array) -> Array:
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
    image = decode(content(path), str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if image is None:
        raise ValueError("no picture")
    return np.asarray(image, np.float64) / (65535 if image.dtype == np.uint16 else 255)


READERS = {".npy": lambda path: _numbers(read_npy(path)), ".npz": _npz, ".csv": _csv, ".png": _png}
