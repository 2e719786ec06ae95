"""Read OpenCRG files of all four data kinds: a text header of sections, numbers and channel definitions, and a block of data."""

import math
import os
import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from luxloop.world.errors import LuxloopError
from luxloop.world.files import content
from luxloop.world.opencrg.crg import FINEST_M, KINDS, TEXT_WIDTH, Crg

LARGEST = 1e9  # no number of a road's header is larger, so that products of a few stay finite
_END = re.compile(rb"^\$\$[^\n]*(?:\n|\Z)", re.MULTILINE)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
_ODD_EXPONENT = re.compile(r"[+-]?[eEdD]?[+-]?\d*")  # "2.000000000+e00" occurs in the wild and means 2
_SECTION = re.compile(rf"long\s+section\s+(?:(at)\s+v\s*=\s*)?({_NUMBER.pattern})")
_KIND = re.compile(r"#[\s:]*([A-Za-z]{4})")
_BRACKETS = str.maketrans("[]()", ",,,,")
# Factors of other units to the format's (m, rad, m/m), in lower case.
LENGTH = {"m": 1.0, "metre": 1.0, "meter": 1.0, "km": 1e3, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}
LENGTH |= dict.fromkeys(("in", "inch", "inches"), 0.0254) | dict.fromkeys(("ft", "foot", "feet"), 0.3048)
ANGLE = {"rad": 1.0, "mrad": 1e-3, **dict.fromkeys(("deg", "degree", "degrees", "°"), math.pi / 180), "gon": math.pi / 200}
SLOPE = {"m/m": 1.0, "1": 1.0, "-": 1.0, "%": 0.01, "percent": 0.01, "cm/m": 0.01, "mm/m": 1e-3}
REFERENCE = {"u": LENGTH, "x": LENGTH, "y": LENGTH, "phi": ANGLE, "slope": SLOPE, "banking": SLOPE}


@dataclass(frozen=True)
class Header:
    """Sections as `name -> [(line number, text)]`, comments stripped, and the bytes that follow."""

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
                raise LuxloopError(f"{self.path}, line {line}: {key.strip()} = {value!r} is not a number; correct the header")
            found, unit = _float(number[0]), value[number.end() :]
            if key.strip().lower().endswith("_phi") and abs(found) > 2 * math.pi and _ODD_EXPONENT.fullmatch(unit):
                raise LuxloopError(
                    f"{self.path}, line {line}: {key.strip()} = {found:g} rad is more than a turn; write its unit, deg or rad, after it"
                )
            if not _ODD_EXPONENT.fullmatch(unit):
                found *= _unit(self.path, line, unit, _units_of(key.strip().lower()))
            if abs(found) > LARGEST:
                raise LuxloopError(f"{self.path}, line {line}: {key.strip()} = {found:g} is too large for a road; correct the header")
            yield key.strip().lower(), found


def _float(number: str) -> float:
    return float(number.replace("D", "E").replace("d", "e"))


def _units_of(key: str) -> Mapping[str, float]:
    """Units in which a key of the header may be given, with their factors."""
    last = key.rpartition("_")[2]
    if last in ("phi", "lon", "lat"):
        return ANGLE
    if last in ("s", "b"):
        return SLOPE
    return {} if key.startswith("scale_") or last in ("mode", "fraction", "continuation") else LENGTH


def _unit(path: Path, line: int, text: str, units: Mapping[str, float]) -> float:
    """Factor from a unit that a header names, in any case and brackets, to the format's unit."""
    name = text.translate(_BRACKETS).strip(" \t,.").lower()
    if name not in units:
        known = f"give it in {', '.join(units)}" if units else "it has none"
        raise LuxloopError(f"{path}, line {line}: the unit {text.strip()!r} is unknown here; {known}")
    return units[name]


@dataclass(frozen=True)
class Channels:
    """Columns of the data block and their meanings."""

    kind: str
    scale: list[float]  # of each column, to m, rad or m/m
    reference: dict[str, int]  # "phi", "slope", "banking", ... -> column
    sections: list[tuple[float, int]]  # (v in m or number, column)
    by_position: bool


def read_header(path: Path) -> Header:
    data = content(path)
    end = _END.search(data)
    text = data[: end.start() if end else len(data)].decode("latin-1")
    sections: dict[str, list[tuple[int, str]]] = {}
    name = ""
    lines = text.splitlines() if "$ROAD_CRG" in text.upper() else []
    for number, line in enumerate(lines, start=1):
        if line.startswith("$"):
            name = re.split(r"[\s!*$]", line[1:], maxsplit=1)[0].upper()
            sections.setdefault(name, [])
        elif name and not line.lstrip().startswith("*"):
            sections[name].append((number, line.partition("!")[0].strip()))
    if "ROAD_CRG_FILE" not in sections and not (end and "ROAD_CRG" in sections):
        raise LuxloopError(f"{path}: is not an OpenCRG file (no $ROAD_CRG header that ends in a $$$$ line); give a .crg file")
    return Header(path, sections, len(lines) + 1, data[end.end() :] if end else b"")


def _name_and_unit(path: Path, line: int, text: str) -> tuple[str, str]:
    name, unit, *more = [*filter(str.strip, text.translate(_BRACKETS).split(",")), "", ""]
    if any(more):
        raise LuxloopError(f"{path}, line {line}: {text.strip()!r} has more than a name and a unit; write 'D:name,unit'")
    return name, unit


def read_channels(header: Header) -> Channels:
    path = header.path
    if "KD_DEFINITION" not in header.sections:
        raise LuxloopError(f"{path}: has no $KD_DEFINITION section, which names the data channels; add one or fetch the file again")
    kind, scale = "KRBI", list[float]()
    reference: dict[str, int] = {}
    numbered: list[tuple[float, int]] = []
    placed: list[tuple[float, int]] = []
    for line, text in header.sections["KD_DEFINITION"]:
        if text.startswith("#"):
            match = _KIND.match(text)
            if match is None or match[1].upper() not in KINDS:
                raise LuxloopError(f"{path}, line {line}: data kind {text[1:].strip(': ')!r} is unknown; use one of {', '.join(KINDS)}")
            kind = match[1].upper()
        tag, colon, rest = text.partition(":")
        if tag.strip().upper() != "D" or not colon:
            continue
        name, unit = _name_and_unit(path, line, rest)
        words = name.lower().split()
        units = LENGTH
        if words[:2] == ["reference", "line"]:
            units = REFERENCE.get(" ".join(words[2:]), {})
            if not units:
                raise LuxloopError(f"{path}, line {line}: {text!r} is no channel of a reference line; use one of {', '.join(REFERENCE)}")
            reference[words[2]] = len(scale)
        elif words[:2] == ["long", "section"]:
            section = _SECTION.fullmatch(name.strip().lower())
            if section is None:
                raise LuxloopError(
                    f"{path}, line {line}: {text!r} has neither a number nor a position v; write 'D:long section at v = 0.0,m'"
                )
            if section[1]:
                units = {"m": 1.0}  # any other might be that of v, of the heights or of both
            (placed if section[1] else numbered).append((_float(section[2]), len(scale)))
        else:
            raise LuxloopError(f"{path}, line {line}: {text!r} is neither a long section nor a channel of the reference line; correct it")
        scale.append(_unit(path, line, unit, units))
    if placed and numbered:
        raise LuxloopError(f"{path}: $KD_DEFINITION mixes long sections by number and by position; define all of them in one way")
    sections = sorted(placed or numbered)
    if len(sections) < 2:
        raise LuxloopError(f"{path}: $KD_DEFINITION has {len(sections)} long sections, at least two are needed; add D:long section lines")
    if numbered and [number for number, _ in sections] != list(range(1, len(sections) + 1)):
        raise LuxloopError(f"{path}: long sections in $KD_DEFINITION are not numbered 1 to {len(sections)} without gaps; renumber them")
    if len({v for v, _ in sections}) < len(sections):
        raise LuxloopError(f"{path}: $KD_DEFINITION has two long sections at one v; remove one of them")
    if ("x" in reference or "y" in reference) and "phi" not in reference:
        raise LuxloopError(f"{path}: gives its reference line by x and y only; give its heading, 'D:reference line phi,rad'")
    return Channels(kind, scale, reference, sections, bool(placed))


LINE_WIDTH = 80  # characters of a line of text data, at most
NUMERALS = b"0123456789+-.,eEdD*unsedmig \t\r\n\x1a"  # what a text data block is made of
HIGHEST_ELEVATION_M = 1e4  # no road is higher; binary data read out of step is, almost surely
_DEEPEST_REFERENCE = 8


def read_crg(path: str | Path) -> Crg:
    """Read an OpenCRG file (LRFI, LDFI, KRBI or KDBI), following `$ROAD_CRG_FILE`; nothing is modified, NaN stays NaN.

    Raises `LuxloopError` for anything that cannot be read; warns where whole rows are missing at the end.
    """
    return _read(Path(path), _DEEPEST_REFERENCE)


def _read(path: Path, depth: int) -> Crg:
    header = read_header(path)
    options = header.numbers("ROAD_CRG_OPTS")
    modifiers = header.numbers("ROAD_CRG_MODS")
    if "ROAD_CRG_FILE" in header.sections:
        inner = _follow_reference(header, depth)
        return replace(inner, options={**inner.options, **options}, modifiers={**inner.modifiers, **modifiers})

    channels = read_channels(header)
    road = header.numbers("ROAD_CRG")
    step = road.get("reference_line_increment")
    if step is None or step < FINEST_M:
        raise LuxloopError(f"{path}: $ROAD_CRG needs REFERENCE_LINE_INCREMENT, the positive step in u in metres (is {step}); add it")
    rows = None
    if "reference_line_end_u" in road:
        rows = round((road["reference_line_end_u"] - road.get("reference_line_start_u", 0.0)) / step) + 1
        if rows < 2:
            raise LuxloopError(f"{path}: REFERENCE_LINE_END_U lies before REFERENCE_LINE_START_U plus one step; correct $ROAD_CRG")
    table = _text(header, channels, rows) if channels.kind in TEXT_WIDTH else _binary(header, channels, rows)
    if len(table) < 2:
        raise LuxloopError(f"{path}: has {len(table)} rows of data and needs at least two; fetch the file again")
    table *= channels.scale
    z = table[:, [column for _, column in channels.sections]]
    implausible = np.abs(z) > HIGHEST_ELEVATION_M
    if implausible.any():
        row = int(np.flatnonzero(implausible.any(axis=1))[0])
        raise LuxloopError(
            f"{path}: elevations from row {row + 1} on are implausible (over {HIGHEST_ELEVATION_M:g} m), "
            "as if newlines had been converted; fetch the file again in binary mode"
        )
    reference = {name: table[:, channels.reference[name]] for name in ("phi", "slope", "banking") if name in channels.reference}
    for name, values in reference.items():
        if not np.isfinite(values[0 if name == "banking" else 1 :]).all():
            raise LuxloopError(f"{path}: channel 'reference line {name}' has missing values; only elevations may be missing")
    return Crg(
        z=z,
        v=_positions(path, channels, road),
        road=road,
        phi=reference.get("phi"),
        slope=reference.get("slope"),
        banking=reference.get("banking"),
        options=options,
        modifiers=modifiers,
        source=str(path),
    )


def _follow_reference(header: Header, depth: int) -> Crg:
    lines = header.sections["ROAD_CRG_FILE"]
    named = "".join(text for _, text in lines)
    if not named or "$" in named:
        what = f"is {named!r}, but environment variables are not expanded" if named else "is empty"
        raise LuxloopError(f"{header.path}: the path in $ROAD_CRG_FILE {what}; write the path out")
    if depth == 0:
        raise LuxloopError(f"{header.path}: $ROAD_CRG_FILE refers to itself in a circle; name the file that has the data")
    target = header.path.parent / named
    if not os.path.exists(target):
        raise LuxloopError(f"{header.path}: $ROAD_CRG_FILE names {named}, which is not at {target}; correct the path")
    return _read(target, depth - 1)


def _positions(path: Path, channels: Channels, road: dict[str, float]) -> NDArray[np.float64]:
    if channels.by_position:
        return np.array([v for v, _ in channels.sections])
    count = len(channels.sections)
    given = {key: road[f"long_section_v_{key}"] for key in ("right", "left", "increment") if f"long_section_v_{key}" in road}
    step = (given["left"] - given["right"]) / (count - 1) if {"right", "left"} == given.keys() else given.get("increment", 0.01)
    right = given.get("right", -step * (count - 1) / 2)
    left = right + step * (count - 1)
    if step <= 0 or abs(given.get("left", left) - left) > step / 2:
        raise LuxloopError(
            f"{path}: {count} long sections {step:g} m apart from v = {right:g} m do not end at {given.get('left', left):g} m; "
            f"correct {', '.join(f'LONG_SECTION_V_{key.upper()}' for key in given)}"
        )
    return right + step * np.arange(count, dtype=np.float64)


def _binary(header: Header, channels: Channels, rows: int | None) -> NDArray[np.float64]:
    dtype = KINDS[channels.kind]
    assert dtype is not None
    count = len(channels.scale)
    if len(header.data.translate(None, NUMERALS)) < 0.1 * len(header.data):
        raise LuxloopError(
            f"{header.path}: its data block is text, but $KD_DEFINITION declares {channels.kind}, which is binary and the default; "
            "write #:LRFI or #:LDFI"
        )
    complete = len(header.data) // (count * dtype.itemsize)
    other, bytes_ = ("KDBI", 8) if dtype.itemsize == 4 else ("KRBI", 4)
    if rows is not None and complete != rows and len(header.data) == -(-rows * count * bytes_ // LINE_WIDTH) * LINE_WIDTH:
        raise LuxloopError(
            f"{header.path}: its data block is as long as that of {rows} rows of {other}, not {channels.kind}; write #:{other}"
        )
    if rows is not None and complete < rows:
        if complete < 2 or len(header.data) % 80:
            raise LuxloopError(
                f"{header.path}: its {channels.kind} data block is {len(header.data)} bytes long and {rows} rows need "
                f"{rows * count * dtype.itemsize}: truncated, or its newlines were converted; fetch the file again in binary mode"
            )
        warnings.warn(f"{header.path}: has {complete} of the {rows} rows that its header announces; the rest is missing", stacklevel=4)
    used = complete if rows is None else min(rows, complete)
    with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN
        table = np.frombuffer(header.data, dtype, used * count).astype(np.float64).reshape(used, count)
    if rows is None:
        measured = np.flatnonzero(~np.isnan(table).all(axis=1))
        table = table[: measured[-1] + 1] if len(measured) else table[:0]
    return table


def _text(header: Header, channels: Channels, rows: int | None) -> NDArray[np.float64]:
    width = TEXT_WIDTH[channels.kind]
    per_line, count = LINE_WIDTH // width, len(channels.scale)
    lines_a_row = math.ceil(count / per_line)
    texts = header.data.decode("latin-1").splitlines()
    lines = [(number, line.rstrip()) for number, line in enumerate(texts, header.lines + 1) if line.strip()]
    for number, line in lines:
        if len(line) > LINE_WIDTH:
            raise LuxloopError(
                f"{header.path}, line {number}: has {len(line)} characters, and {channels.kind} data {LINE_WIDTH} at most; "
                f"write {per_line} values a line"
            )
    complete = len(lines) // lines_a_row
    if rows is None or complete < rows:
        if complete < 2 or len(lines) % lines_a_row:
            of = "" if rows is None else f" of {rows}"
            raise LuxloopError(
                f"{header.path}: {channels.kind} data end after line {lines[-1][0] if lines else header.lines} "
                f"in row {complete + 1}{of}; fetch the file again"
            )
        if rows is not None:
            what = f"has {complete} of the {rows} rows that its header announces; the rest is missing"
            warnings.warn(f"{header.path}: {what}", stacklevel=4)
    table = np.empty((complete if rows is None else min(rows, complete), count))
    for row, values in enumerate(table):
        for part in range(lines_a_row):
            number, line = lines[row * lines_a_row + part]
            first, last = part * per_line, min((part + 1) * per_line, count)
            if len(line) > (last - first) * width:
                raise LuxloopError(
                    f"{header.path}, line {number}: has more than the {last - first} values that $KD_DEFINITION announces here"
                )
            for column in range(first, last):
                at = (column - first) * width
                values[column] = _field(header.path, number, line[at : at + width])
    return table


def _field(path: Path, line: int, text: str) -> float:
    if "*" in text:
        return 0.0 if text.strip("* ").lower() == "unused" else math.nan
    try:
        return _float(text)
    except ValueError:
        raise LuxloopError(f"{path}, line {line}: {text!r} is not a number in a fixed column; restore the column widths") from None
