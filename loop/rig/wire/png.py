"""Grey pictures as PNG without compression, which takes a tenth of the time."""

import struct
import zlib
from typing import Final

import numpy as np
from numpy.typing import NDArray

SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
GREY: Final = 0  # colour type


def png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """A picture `[height, width]` of 8 or 16 bits, its numbers as they are."""
    height, width = image.shape
    rows = np.zeros((height, 1 + width * image.itemsize), np.uint8)  # a row begins with its filter, 0 for none
    rows[:, 1:] = image.astype(image.dtype.newbyteorder(">"), copy=False).view(np.uint8)
    head = struct.pack(">IIBBBBB", width, height, 8 * image.itemsize, GREY, 0, 0, 0)
    return SIGNATURE + _chunk(b"IHDR", head) + _chunk(b"IDAT", zlib.compress(rows.data, 0)) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return b"".join((struct.pack(">I", len(data)), kind, data, struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))))
