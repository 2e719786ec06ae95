"""Decoding of pictures whose declared size is within the memory budget."""

import io
import math
from typing import Final

import cv2
import numpy as np
from PIL import ExifTags, Image

from luxloop.world.budget import afford

BYTES_A_PIXEL: Final = 32  # of a colour picture of 16 bits with transparency, and the same in single precision beside it
FLIPS: Final = {2: 1, 3: -1, 4: 0, 6: 1, 7: -1, 8: 0}  # of an EXIF orientation, as OpenCV numbers them
TRANSPOSED: Final = (5, 6, 7, 8)  # orientations of pictures that are transposed before the flip


def decoded(coded: bytes, what: str, flags: int = cv2.IMREAD_UNCHANGED) -> np.ndarray | None:
    """The picture as OpenCV decodes it with `flags`, upright by its EXIF orientation, or None where it is none.

    what: the picture, as a message begins.
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
        picture, kinds, blocks = cv2.imdecodeWithMetadata(np.frombuffer(coded, np.uint8), flags=flags)
    except cv2.error:
        return None
    if flags == cv2.IMREAD_UNCHANGED and picture is not None and cv2.IMAGE_METADATA_EXIF in kinds:  # with other flags OpenCV turns it
        return _upright(picture, bytes(blocks[list(kinds).index(cv2.IMAGE_METADATA_EXIF)]))
    return picture


def _upright(picture: np.ndarray, exif: bytes) -> np.ndarray:
    """The picture turned and mirrored by its orientation, 1 to 8 (EXIF 2.32, 4.6.4.A); unchanged where there is none."""
    tags = Image.Exif()
    try:
        tags.load(exif)
        orientation = tags.get(ExifTags.Base.Orientation)
    except Exception:  # of damaged tags
        return picture
    if orientation in TRANSPOSED:
        picture = cv2.transpose(picture)
    return cv2.flip(picture, FLIPS[orientation]) if orientation in FLIPS else picture
