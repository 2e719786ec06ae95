"""Read OpenCRG files of all four data kinds."""

import math
import os
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from luxloop.world.opencrg.crg import FINEST_M, KINDS, TEXT_WIDTH, Crg, CrgError
from luxloop.world.opencrg.header import Channels, Header, read_channels, read_header

LINE_WIDTH = 80  # characters of a line of text data, at most
NUMERALS = b"0123456789+-.,eEdD*unsedmig \t\r\n\x1a"  # what a text data block is made of
HIGHEST_ELEVATION_M = 1e4  # no road is higher; binary data read out of step is, almost surely
_DEEPEST_REFERENCE = 8


def read_crg(path: str | Path) -> Crg:
    """Read an OpenCRG file (LRFI, LDFI, KRBI or KDBI), following `$ROAD_CRG_FILE`; nothing is modified, NaN stays NaN.

    Raises `CrgError` for anything that cannot be read; warns where whole rows are missing at the end.
    """
    return _read(Path(path), _DEEPEST_REFERENCE)


def _read(path: Path, depth: int) -> Crg:
    header = read_header(path)
    options = header.numbers("ROAD_CRG_OPTS")
    modifiers = header.numbers("ROAD_CRG_MODS") if "ROAD_CRG_MODS" in header.sections else None
    comment = "\n".join(text for _, text in header.sections.get("CT", []))
    if "ROAD_CRG_FILE" in header.sections:
        inner = _referenced(header, depth)
        if inner.modifiers is not None or modifiers is not None:
            modifiers = {**(inner.modifiers or {}), **(modifiers or {})}
        return replace(inner, options={**inner.options, **options}, modifiers=modifiers, comment=comment)

    channels = read_channels(header)
    road = header.numbers("ROAD_CRG")
    step = road.get("reference_line_increment")
    if step is None or step < FINEST_M:
        raise CrgError(f"{path}: $ROAD_CRG needs REFERENCE_LINE_INCREMENT, the positive step in u in metres (is {step}); add it")
    rows = None
    if "reference_line_end_u" in road:
        rows = round((road["reference_line_end_u"] - road.get("reference_line_start_u", 0.0)) / step) + 1
        if rows < 2:
            raise CrgError(f"{path}: REFERENCE_LINE_END_U lies before REFERENCE_LINE_START_U plus one step; correct $ROAD_CRG")
    table = _text(header, channels, rows) if channels.kind in TEXT_WIDTH else _binary(header, channels, rows)
    table *= channels.scale
    z = table[:, [column for _, column in channels.sections]]
    implausible = np.abs(z) > HIGHEST_ELEVATION_M
    if implausible.any():
        row = int(np.flatnonzero(implausible.any(axis=1))[0])
        raise CrgError(
            f"{path}: elevations from row {row + 1} on are implausible (over {HIGHEST_ELEVATION_M:g} m), "
            "as if newlines had been converted; fetch the file again in binary mode"
        )
    reference = {name: table[:, channels.reference[name]] for name in ("phi", "slope", "banking") if name in channels.reference}
    for name, values in reference.items():
        if not np.isfinite(values[0 if name == "banking" else 1 :]).all():
            raise CrgError(f"{path}: channel 'reference line {name}' has missing values; only elevations may be missing")
    return Crg(
        z=z,
        v=_positions(path, channels, road),
        road=road,
        phi=reference.get("phi"),
        slope=reference.get("slope"),
        banking=reference.get("banking"),
        options=options,
        modifiers=modifiers,
        comment=comment,
        kind=channels.kind,
        source=str(path),
    )


def _referenced(header: Header, depth: int) -> Crg:
    lines = header.sections["ROAD_CRG_FILE"]
    named = "".join(text for _, text in lines)
    if not named or "$" in named:
        what = f"is {named!r}, but environment variables are not expanded" if named else "is empty"
        raise CrgError(f"{header.path}: the path in $ROAD_CRG_FILE {what}; write the path out")
    if depth == 0:
        raise CrgError(f"{header.path}: $ROAD_CRG_FILE refers to itself in a circle; name the file that has the data")
    target = header.path.parent / named
    if not os.path.isfile(target):
        raise CrgError(f"{header.path}: $ROAD_CRG_FILE names {named}, which is not at {target}; correct the path")
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
        raise CrgError(
            f"{path}: {count} long sections {step:g} m apart from v = {right:g} m do not end at {given.get('left', left):g} m; "
            f"correct {', '.join(f'LONG_SECTION_V_{key.upper()}' for key in given)}"
        )
    return right + step * np.arange(count, dtype=np.float64)


def _binary(header: Header, channels: Channels, rows: int | None) -> NDArray[np.float64]:
    dtype = KINDS[channels.kind]
    assert dtype is not None
    count = len(channels.scale)
    if len(header.data.translate(None, NUMERALS)) < 0.1 * len(header.data):
        raise CrgError(
            f"{header.path}: its data block is text, but $KD_DEFINITION declares {channels.kind}, which is binary and the default; "
            "write #:LRFI or #:LDFI"
        )
    complete = len(header.data) // (count * dtype.itemsize)
    other, bytes_ = ("KDBI", 8) if dtype.itemsize == 4 else ("KRBI", 4)
    if rows is not None and complete != rows and len(header.data) == -(-rows * count * bytes_ // LINE_WIDTH) * LINE_WIDTH:
        raise CrgError(f"{header.path}: its data block is as long as that of {rows} rows of {other}, not {channels.kind}; write #:{other}")
    if rows is not None and complete < rows:
        if complete < 2 or len(header.data) % 80:
            raise CrgError(
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
    return _at_least_two(header, table)


def _text(header: Header, channels: Channels, rows: int | None) -> NDArray[np.float64]:
    width = TEXT_WIDTH[channels.kind]
    per_line, count = LINE_WIDTH // width, len(channels.scale)
    lines_a_row = math.ceil(count / per_line)
    texts = header.data.decode("latin-1").splitlines()
    lines = [(number, line.rstrip()) for number, line in enumerate(texts, header.lines + 1) if line.strip()]
    for number, line in lines:
        if len(line) > LINE_WIDTH:
            raise CrgError(
                f"{header.path}, line {number}: has {len(line)} characters, and {channels.kind} data {LINE_WIDTH} at most; "
                f"write {per_line} values a line"
            )
    complete = len(lines) // lines_a_row
    if rows is None or complete < rows:
        if complete < 2 or len(lines) % lines_a_row:
            of = "" if rows is None else f" of {rows}"
            raise CrgError(
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
                raise CrgError(f"{header.path}, line {number}: has more than the {last - first} values that $KD_DEFINITION announces here")
            for column in range(first, last):
                at = (column - first) * width
                values[column] = _field(header.path, number, line[at : at + width])
    return _at_least_two(header, table)


def _field(path: Path, line: int, text: str) -> float:
    if "*" in text:
        return 0.0 if text.strip("* ").lower() == "unused" else math.nan
    try:
        return float(text.replace("D", "E").replace("d", "e"))
    except ValueError:
        raise CrgError(f"{path}, line {line}: {text!r} is not a number in a fixed column; restore the column widths") from None


def _at_least_two(header: Header, table: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(table) < 2:
        raise CrgError(f"{header.path}: has {len(table)} rows of data and needs at least two; fetch the file again")
    return table
