"""Foreign pictures and SVG drawings: read within the memory budget; drawings must not refer to anything outside."""

import gzip
import io
import math
import re
import zlib
from contextlib import suppress
from typing import Any, Final
from xml.parsers import expat

import cv2
import numpy as np
from PIL import ExifTags, Image

from luxloop.world.files import afford

BYTES_A_PIXEL: Final = 32  # of a colour picture of 16 bits with transparency, and the same in single precision beside it
FLIPS: Final = {2: 1, 3: -1, 4: 0, 6: 1, 7: -1, 8: 0}  # of an orientation (EXIF 2.32, 4.6.4.A), as OpenCV numbers them
TRANSPOSED: Final = (5, 6, 7, 8)  # orientations of pictures that are transposed before the flip


def decode(coded: bytes, what: str, flags: int = cv2.IMREAD_UNCHANGED) -> np.ndarray | None:
    """The picture as OpenCV decodes it with `flags`, upright unless they ignore orientation; None if it is damaged or no picture.

    what: the picture in a message. Raises LuxloopError where it declares more pixels than the budget allows.
    """
    orientation = None
    try:
        with Image.open(io.BytesIO(coded)) as header:
            pixels, form = math.prod(header.size), header.format
            with suppress(Exception):  # of damaged tags
                orientation = header.getexif().get(ExifTags.Base.Orientation)
    except Image.DecompressionBombError:  # Pillow refuses twice the number that it warns of, before it gives the size
        pixels, form = 2 * (Image.MAX_IMAGE_PIXELS or 0), None
    except Exception:  # readers raise whatever their formats provoke
        return None
    afford(f"{what}: its pixels", BYTES_A_PIXEL * pixels, "shrink the picture")
    keeps = flags != cv2.IMREAD_UNCHANGED and flags & cv2.IMREAD_IGNORE_ORIENTATION
    try:
        picture = cv2.imdecode(np.frombuffer(coded, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        return None
    if picture is None or (form in ("JPEG", "MPO") and not _complete(coded)):
        return None
    if keeps or form == "TIFF" or orientation not in (*FLIPS, 5):  # OpenCV always turns a TIFF
        return picture
    if orientation in TRANSPOSED:
        picture = cv2.transpose(picture)
    return cv2.flip(picture, FLIPS[orientation]) if orientation in FLIPS else picture


def _complete(jpeg: bytes) -> bool:
    """Whether a JPEG is intact; OpenCV fills damaged or missing parts with grey."""
    import av

    decoder: Any = av.CodecContext.create("mjpeg", "r")
    decoder.options = {"err_detect": "explode"}
    try:
        decoder.decode(av.Packet(jpeg))
    except av.FFmpegError:
        return False
    return True


GZIP: Final = b"\x1f\x8b"
LONGEST: Final = 30_000_000  # bytes of text; drawing takes a hundred times as many
DEEPEST: Final = 256  # elements within each other; the library that draws overflows its stack at some thousand
_OUTSIDE: Final = re.compile(r"url\(\s*['\"]?\s*(?!['\"#\s])|@import", re.I)  # in CSS; url(#name) is a part of the drawing
# Units of lengths, in attributes and CSS, whose shapes resvg leaves out.
_UNDRAWN: Final = re.compile(r"(?:^|:)\s*[-+]?[\d.]+(?:e[-+]?\d+)?(q|rem|ch|lh|vw|vh|vmin|vmax)\s*(?:$|[;}!])", re.I)


def svg_text(data: bytes) -> str:
    """The text of an .svg or .svgz. Raises ValueError with the reason where it must not be drawn."""
    if data.startswith(GZIP):
        try:
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
                data = stream.read(LONGEST + 1)
        except (EOFError, OSError, zlib.error) as error:
            raise ValueError(f"damaged gzip: {error}") from error
    if len(data) > LONGEST:
        raise ValueError(f"it is longer than {LONGEST / 1e6:g} MB")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError("its text is not in UTF-8, save it as UTF-8") from error
    try:
        _check(text)
    except expat.ExpatError as error:
        raise ValueError(str(error)) from error
    return text


def _check(text: str) -> None:
    """Raises ValueError at an element, attribute or text that must not be drawn, and expat's error where it is no XML."""
    depth = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise ValueError(f"its elements are nested deeper than {DEEPEST}")
        for key, value in attributes.items():
            if key.rpartition(":")[2] == "href" and name.rpartition(":")[2] != "a" and not value.strip().startswith("#"):
                if value.strip().startswith("data:"):
                    raise ValueError("it embeds a picture, which is not drawn")
                raise ValueError(f"it refers to something outside of itself, {key}={value[:40]!r}")
            characters(value)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1

    def characters(text: str) -> None:
        if found := _OUTSIDE.search(text):
            raise ValueError(f"it refers to something outside of itself, {text[found.start() : found.start() + 40]!r}")
        if found := _UNDRAWN.search(text):
            raise ValueError(f"its lengths in {found[1]} are not drawn, take mm or px")

    def entity(name: str, *_: object) -> None:
        raise ValueError(f"it declares the entity {name[:40]!r}")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.EntityDeclHandler = characters, entity
    parser.buffer_text = True
    parser.Parse(text, True)
