"""The text header of an OpenCRG file: sections, numbers, channel definitions."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from world.files import content
from world.opencrg.crg import KINDS, CrgError

LARGEST = 1e9  # no number of a road's header is larger, so that products of a few stay finite
_END = re.compile(rb"^\$\$[^\n]*(?:\n|\Z)", re.MULTILINE)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")


@dataclass(frozen=True)
class Header:
    """Sections as `name -> [(line number, text)]`, comments stripped (but for `$CT`), and the bytes that follow."""

    path: Path
    sections: dict[str, list[tuple[int, str]]]
    lines: int
    data: bytes

    def numbers(self, section: str) -> dict[str, float]:
        """`key = number` lines under lower-case keys."""
        return dict(self._numbers(section))

    def _numbers(self, section: str) -> Iterator[tuple[str, float]]:
        for line, text in self.sections.get(section, []):
            key, equals, value = text.partition("=")
            if not equals:
                continue
            # Only the longest leading number counts: "2.000000000+e00" occurs in the wild and means 2.
            number = _NUMBER.match(value.strip())
            if number is None:
                raise CrgError(f"{self.path}, line {line}: {key.strip()} = {value.strip()!r} is not a number; correct the header")
            found = float(number[0].replace("D", "E").replace("d", "e"))
            if abs(found) > LARGEST:
                raise CrgError(f"{self.path}, line {line}: {key.strip()} = {found:g} is too large for a road; correct the header")
            yield key.strip().lower(), found


@dataclass(frozen=True)
class Channels:
    """Columns of the data block: which of them are what."""

    kind: str
    count: int
    reference: dict[str, int]  # "phi", "slope", "banking", ... -> column
    sections: list[tuple[float, int]]  # (v in m or number, column)
    by_position: bool


def read_header(path: Path) -> Header:
    try:
        data = content(path)
    except OSError as error:
        raise CrgError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    end = _END.search(data)
    text = data[: end.start() if end else len(data)].decode("latin-1")
    sections: dict[str, list[tuple[int, str]]] = {}
    name = ""
    lines = text.splitlines() if "$ROAD_CRG" in text.upper() else []
    for number, line in enumerate(lines, start=1):
        if line.startswith("$"):
            name = re.split(r"[\s!*$]", line[1:], maxsplit=1)[0].upper()
            sections.setdefault(name, [])
        elif name == "CT":
            sections[name].append((number, line))
        elif name and not line.lstrip().startswith("*"):
            sections[name].append((number, line.partition("!")[0].strip()))
    if "ROAD_CRG_FILE" not in sections and not (end and "ROAD_CRG" in sections):
        raise CrgError(f"{path}: is not an OpenCRG file (no $ROAD_CRG header that ends in a $$$$ line); give a .crg file")
    return Header(path, sections, len(lines) + 1, data[end.end() :] if end else b"")


def read_channels(header: Header) -> Channels:
    path = header.path
    if "KD_DEFINITION" not in header.sections:
        raise CrgError(f"{path}: has no $KD_DEFINITION section, which names the data channels; add one or fetch the file again")
    kind, count = "KRBI", 0
    reference: dict[str, int] = {}
    numbered: list[tuple[float, int]] = []
    placed: list[tuple[float, int]] = []
    for line, text in header.sections["KD_DEFINITION"]:
        tag, colon, rest = text.partition(":")
        if tag == "#" and colon:
            kind = rest.strip()[:4].upper()
            if kind not in KINDS:
                raise CrgError(f"{path}, line {line}: data kind {rest.strip()!r} is unknown; use one of {', '.join(KINDS)}")
        if tag.upper() != "D" or not colon:
            continue
        words = rest.partition(",")[0].lower().split()
        if words[:2] == ["reference", "line"] and len(words) == 3:
            reference[words[2]] = count
        elif words[:2] == ["long", "section"]:
            number = _NUMBER.search("".join(words[2:]))
            if number is None:
                raise CrgError(f"{path}, line {line}: {text!r} has neither a number nor a position v; write 'D:long section at v = 0.0,m'")
            (placed if words[2] == "at" else numbered).append((float(number[0]), count))
        count += 1
    if placed and numbered:
        raise CrgError(f"{path}: $KD_DEFINITION mixes long sections by number and by position; define all of them in one way")
    sections = sorted(placed or numbered)
    if len(sections) < 2:
        raise CrgError(f"{path}: $KD_DEFINITION has {len(sections)} long sections, at least two are needed; add D:long section lines")
    if numbered and [number for number, _ in sections] != list(range(1, len(sections) + 1)):
        raise CrgError(f"{path}: long sections in $KD_DEFINITION are not numbered 1 to {len(sections)} without gaps; renumber them")
    if len({v for v, _ in sections}) < len(sections):
        raise CrgError(f"{path}: $KD_DEFINITION has two long sections at one v; remove one of them")
    if ("x" in reference or "y" in reference) and "phi" not in reference:
        raise CrgError(f"{path}: gives its reference line by x and y only; give its heading, 'D:reference line phi,rad'")
    return Channels(kind, count, reference, sections, bool(placed))
