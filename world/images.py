"""Decoding of pictures whose declared size is within the memory budget."""

import io
import math
from typing import Final

import cv2
import numpy as np
from PIL import Image

from world.budget import afford

BYTES_A_PIXEL: Final = 32  # of a colour picture of 16 bits with transparency, and the same in single precision beside it


def decoded(coded: bytes, what: str, flags: int = cv2.IMREAD_UNCHANGED) -> np.ndarray | None:
    """The picture as OpenCV decodes it with `flags`, or None where it is none; what: the picture, as a message begins.

    Raises LuxloopError where it declares more pixels than the budget allows.
    """
    try:
        with Image.open(io.BytesIO(coded)) as header:
            pixels = math.prod(header.size)
    except Image.DecompressionBombError:  # Pillow refuses twice the number that it warns of, before it gives the size
        pixels = 2 * (Image.MAX_IMAGE_PIXELS or 0)
    except Exception:  # readers raise whatever their formats provoke
        return None
    afford(f"{what}: its pixels", BYTES_A_PIXEL * pixels, "shrink the picture")
    try:
        return cv2.imdecode(np.frombuffer(coded, np.uint8), flags)
    except cv2.error:
        return None
