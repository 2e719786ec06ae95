"""The text header of an OpenCRG file: sections, numbers, channel definitions."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from luxloop.world.files import content
from luxloop.world.opencrg.crg import KINDS, CrgError

LARGEST = 1e9  # no number of a road's header is larger, so that products of a few stay finite
_END = re.compile(rb"^\$\$[^\n]*(?:\n|\Z)", re.MULTILINE)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
_ODD_EXPONENT = re.compile(r"[+-]?[eEdD]?[+-]?\d*")  # "2.000000000+e00" occurs in the wild and means 2
_SECTION = re.compile(rf"long\s+section\s+(?:(at)\s+v\s*=\s*)?({_NUMBER.pattern})")
_KIND = re.compile(r"#[\s:]*([A-Za-z]{4})")
_BRACKETS = str.maketrans("[]()", ",,,,")
# How much of the format's unit (m, rad, m/m) others are, in lower case.
LENGTH = {"m": 1.0, "metre": 1.0, "meter": 1.0, "km": 1e3, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}
LENGTH |= dict.fromkeys(("in", "inch", "inches"), 0.0254) | dict.fromkeys(("ft", "foot", "feet"), 0.3048)
ANGLE = {"rad": 1.0, "mrad": 1e-3, **dict.fromkeys(("deg", "degree", "degrees", "°"), math.pi / 180), "gon": math.pi / 200}
SLOPE = {"m/m": 1.0, "1": 1.0, "-": 1.0, "%": 0.01, "percent": 0.01, "cm/m": 0.01, "mm/m": 1e-3}
REFERENCE = {"u": LENGTH, "x": LENGTH, "y": LENGTH, "phi": ANGLE, "slope": SLOPE, "banking": SLOPE}


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
            value = value.strip()
            number = _NUMBER.match(value)
            if number is None:
                raise CrgError(f"{self.path}, line {line}: {key.strip()} = {value!r} is not a number; correct the header")
            found, unit = _float(number[0]), value[number.end() :]
            if not _ODD_EXPONENT.fullmatch(unit):
                found *= _unit(self.path, line, unit, _units_of(key.strip().lower()))
            if abs(found) > LARGEST:
                raise CrgError(f"{self.path}, line {line}: {key.strip()} = {found:g} is too large for a road; correct the header")
            yield key.strip().lower(), found


def _float(number: str) -> float:
    return float(number.replace("D", "E").replace("d", "e"))


def _units_of(key: str) -> Mapping[str, float]:
    """What a key of the header may be given in."""
    last = key.rpartition("_")[2]
    if last in ("phi", "lon", "lat"):
        return ANGLE
    if last in ("s", "b"):
        return SLOPE
    return {} if key.startswith("scale_") or last in ("mode", "fraction", "continuation") else LENGTH


def _unit(path: Path, line: int, text: str, units: Mapping[str, float]) -> float:
    """How much of the format's unit one is that a header names, whatever its case and brackets."""
    name = text.translate(_BRACKETS).strip(" \t,.").lower()
    if name not in units:
        known = f"give it in {', '.join(units)}" if units else "it has none"
        raise CrgError(f"{path}, line {line}: the unit {text.strip()!r} is unknown here; {known}")
    return units[name]


@dataclass(frozen=True)
class Channels:
    """Columns of the data block: which of them are what."""

    kind: str
    scale: list[float]  # of each column, to m, rad or m/m
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
    kind, scale = "KRBI", list[float]()
    reference: dict[str, int] = {}
    numbered: list[tuple[float, int]] = []
    placed: list[tuple[float, int]] = []
    for line, text in header.sections["KD_DEFINITION"]:
        if text.startswith("#"):
            match = _KIND.match(text)
            if match is None or match[1].upper() not in KINDS:
                raise CrgError(f"{path}, line {line}: data kind {text[1:].strip(': ')!r} is unknown; use one of {', '.join(KINDS)}")
            kind = match[1].upper()
        tag, colon, rest = text.partition(":")
        if tag.strip().upper() != "D" or not colon:
            continue
        name, unit = [*(part for part in rest.translate(_BRACKETS).split(",") if part.strip()), "", ""][:2]
        words = name.lower().split()
        units = LENGTH
        if words[:2] == ["reference", "line"]:
            units = REFERENCE.get(" ".join(words[2:]), {})
            if not units:
                raise CrgError(f"{path}, line {line}: {text!r} is no channel of a reference line; use one of {', '.join(REFERENCE)}")
            reference[words[2]] = len(scale)
        elif words[:2] == ["long", "section"]:
            section = _SECTION.fullmatch(name.strip().lower())
            if section is None:
                raise CrgError(f"{path}, line {line}: {text!r} has neither a number nor a position v; write 'D:long section at v = 0.0,m'")
            if section[1]:
                units = {"m": 1.0}  # any other might be that of v, of the heights or of both
            (placed if section[1] else numbered).append((_float(section[2]), len(scale)))
        else:
            raise CrgError(f"{path}, line {line}: {text!r} is neither a long section nor a channel of the reference line; correct it")
        scale.append(_unit(path, line, unit, units))
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
    return Channels(kind, scale, reference, sections, bool(placed))
