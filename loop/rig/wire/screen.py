"""Light for a screen: the pixels of all modules in one picture, and its bytes in a WebSocket's message."""

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

HEAD: Final = struct.Struct(">IHH")  # of a message: number of the light, width and height of its picture


def stacked(pictures: Sequence[NDArray]) -> NDArray:
    """Pictures of all modules below each other, the first on top, each at the left: `[sum of rows, most columns]`, black beside them."""
    width = max(each.shape[1] for each in pictures)
    return np.concatenate([np.pad(each, ((0, 0), (0, width - each.shape[1]))) for each in pictures])


def unstacked(picture: NDArray, grids: Sequence[tuple[int, int]]) -> NDArray:
    """The pixels `[n]` of all modules one after another, row by row, of a picture. grids: rows and columns of each. Raises ValueError where
    the picture has another size.
    """
    rows, columns = sum(rows for rows, _ in grids), max(columns for _, columns in grids)
    if picture.shape != (rows, columns):
        raise ValueError(f"the picture has {picture.shape[0]} x {picture.shape[1]} pixels, not {rows} x {columns}")
    ends = np.cumsum([rows for rows, _ in grids])[:-1]
    parts = np.split(picture, ends)
    return np.concatenate([part[:, :columns].ravel() for part, (_, columns) in zip(parts, grids, strict=True)])


def message_of(number: int, codes: NDArray[np.uint8]) -> bytes:
    """The bytes of a picture `[height, width]`: `HEAD`, big endian, and a byte a pixel, row by row from the top."""
    return HEAD.pack(number % 2**32, codes.shape[1], codes.shape[0]) + codes.tobytes()


def understood(message: bytes) -> tuple[int, NDArray[np.uint8]]:
    """The number of a message and its picture `[height, width]`. Raises ValueError where it is none."""
    if len(message) < HEAD.size:
        raise ValueError(f"a message of {len(message)} bytes has no head")
    number, width, height = HEAD.unpack_from(message)
    return number, np.frombuffer(message, np.uint8, offset=HEAD.size).reshape(height, width)
