"""SVG drawings of others: text that refers to nothing outside of itself, declares no entities and is not nested without end."""

import gzip
import io
import re
import zlib
from typing import Final
from xml.parsers import expat

GZIP: Final = b"\x1f\x8b"
LONGEST: Final = 30_000_000  # bytes of text: what is drawn from it takes a hundred times as many
DEEPEST: Final = 256  # elements within each other; the library that draws overflows its stack at some thousand
_OUTSIDE: Final = re.compile(r"url\(\s*['\"]?\s*(?!['\"#\s])|@import", re.I)  # in CSS; url(#name) is a part of the drawing
# Units of lengths, in attributes and CSS, whose shapes resvg leaves out.
_UNDRAWN: Final = re.compile(r"(?:^|:)\s*[-+]?[\d.]+(?:e[-+]?\d+)?(q|rem|ch|lh|vw|vh|vmin|vmax)\s*(?:$|[;}!])", re.I)


def self_contained(data: bytes) -> str:
    """The text of an .svg or .svgz. Raises ValueError with the reason where it must not be drawn."""
    if data.startswith(GZIP):
        try:
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
                data = stream.read(LONGEST + 1)
        except (EOFError, OSError, zlib.error) as error:
            raise ValueError(f"damaged gzip: {error}") from error
    if len(data) > LONGEST:
        raise ValueError(f"it is longer than {LONGEST / 1e6:g} MB")
    text = data.decode("utf-8-sig")
    try:
        _Check().parser.Parse(text, True)
    except expat.ExpatError as error:
        raise ValueError(str(error)) from error
    return text


class _Check:
    """Looks at every element, attribute and text of a drawing while expat reads it."""

    def __init__(self) -> None:
        self.depth = 0
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._text
        self.parser.EntityDeclHandler = self._entity
        self.parser.buffer_text = True

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self.depth += 1
        if self.depth > DEEPEST:
            raise ValueError(f"its elements are nested deeper than {DEEPEST}")
        for key, value in attributes.items():
            if key.rpartition(":")[2] == "href" and name.rpartition(":")[2] != "a" and not value.strip().startswith("#"):
                if value.strip().startswith("data:"):
                    raise ValueError("it embeds a picture, which is not drawn")
                raise ValueError(f"it refers to something outside of itself, {key}={value[:40]!r}")
            self._text(value)

    def _end(self, name: str) -> None:
        self.depth -= 1

    def _text(self, text: str) -> None:
        if found := _OUTSIDE.search(text):
            raise ValueError(f"it refers to something outside of itself, {text[found.start() : found.start() + 40]!r}")
        if found := _UNDRAWN.search(text):
            raise ValueError(f"its lengths in {found[1]} are not drawn, take mm or px")

    def _entity(self, name: str, *_: object) -> None:
        raise ValueError(f"it declares the entity {name[:40]!r}")
