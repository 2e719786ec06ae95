"""IES LM-63 files, editions 1986, 1991, 1995, 2002 and 2019: read and written.

Numbers are read as tokens, since files break lines anywhere; unambiguous oddities are read with a warning.
"""

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import atomic_write
from luxloop.world.photometry.distribution import HORIZONTAL_RANGE, VERTICAL_RANGE, Distribution, Kind
from luxloop.world.photometry.record import Numbers, Photometry, Tilt, load

FOOT_M = 0.3048
LAST_BALLAST_LAMP = 1991  # edition in which the number after the ballast factor multiplies the candela; later ones reserve it
FIRST_ORIGIN = 2019  # edition in which it encodes the file's origin
NOISE = 0.01  # goniophotometers report slightly negative values in the dark: up to this share of the peak they are taken as zero
_TILT = re.compile(r"^[ \t]*TILT[ \t]*=[ \t]*(.*?)[ \t]*$", re.IGNORECASE | re.MULTILINE)
_VERSION = re.compile(r"IES(?:NA)?:?\s*(?:LM-63-)?(\d{4}|\d{2})\b", re.IGNORECASE)
_KEYWORD = re.compile(r"\s*\[([^\]]*)\]\s*(.*?)\s*$")
_EDITIONS = (1986, 1991, 1995, 2002, 2019)
_TYPES: dict[int, Kind] = {1: "C", 2: "B", 3: "A"}
_PER_LINE = 12  # numbers of a written line, which the standard limits to 256 characters


def parse(text: str, path: Path) -> Photometry:
    """Photometry of an LM-63 file's text; `path` is for messages and to find a TILT file beside it.

    Raises LuxloopError with the line and what was expected there.
    """
    tilt_line = _TILT.search(text)
    if tilt_line is None:
        last = text.rstrip().count("\n") + 1
        raise LuxloopError(f"{path}, line {last}: expected a TILT= line, found the file's end; give an IES LM-63 file")
    warnings: list[str] = []
    edition, keywords = _header(text[: tilt_line.start()].split("\n")[:-1], warnings)
    body, stop, after = text[tilt_line.end() :].partition("\x1a")
    if stop:
        warnings.append("ends in Ctrl-Z" + (", what follows is ignored" if after.strip() else ""))
    numbers = Numbers(path, body, text.count("\n", 0, tilt_line.end()) + 1)
    tilt = tilt_line[1].upper() if tilt_line[1].upper() in ("NONE", "INCLUDE") else tilt_line[1]
    factors = _tilt(tilt, numbers, path, warnings)
    figures = _figures(numbers, path, edition, warnings)
    numbers.end(warnings)
    return Photometry(
        **figures,
        path=path,
        format=f"LM-63-{edition}",
        luminaire=keywords.get("LUMINAIRE") or keywords.get("LUMCAT") or path.stem,
        tilt=tilt,
        tilt_factors=factors,
        keywords=keywords,
        warnings=tuple(warnings),
    )


def _header(lines: list[str], warnings: list[str]) -> tuple[int, dict[str, str]]:
    """Edition and keywords; a file of 1986 has neither, only free text."""
    version = _VERSION.match(lines[0].strip()) if lines else None
    edition = 1986
    if version is None:
        warnings.append("has no version line: read as LM-63-1986")
    else:
        edition = int(version[1]) + (1900 if len(version[1]) == 2 else 0)
        if edition not in _EDITIONS:
            warnings.append(f"names edition {edition}, which is unknown: read as {_EDITIONS[-1]}")
            edition = _EDITIONS[-1]
    keywords: dict[str, str] = {}
    last = ""
    for number, line in enumerate(lines, start=1):
        match = _KEYWORD.match(line)
        if match is None:
            if version is not None and number > 1 and line.strip():
                warnings.append(f"line {number} is no keyword, ignored: {line.strip()[:40]!r}")
            continue
        last = last if match[1].strip().upper() == "MORE" and last else match[1].strip().upper()
        keywords[last] = f"{keywords[last]}\n{match[2]}" if last in keywords else match[2]
    return edition, keywords


def _tilt(tilt: str, numbers: Numbers, path: Path, warnings: list[str]) -> Tilt | None:
    if tilt == "NONE":
        return None
    if tilt != "INCLUDE":
        beside = path.parent / Path(tilt.replace("\\", "/")).name
        if not beside.name or not os.path.isfile(beside):
            warnings.append(f"TILT file {tilt!r} is not beside it: lamp tilt factors are unknown")
            return None
        numbers = Numbers(beside, load(beside), 1)
    geometry = numbers.whole("the lamp-to-luminaire geometry, 1 to 3", 1)
    count = numbers.whole("the number of tilt angles", 1)
    found = Tilt(geometry, numbers.many(count, "tilt angle"), numbers.many(count, "tilt factor"))
    if tilt != "INCLUDE":
        numbers.end(warnings)
    return found


def _figures(numbers: Numbers, path: Path, edition: int, warnings: list[str]) -> dict[str, Any]:
    """All numbers after TILT, in the standard's order."""
    lamps = numbers.whole("the number of lamps")
    lumens = numbers.one("lumens per lamp, or -1 for absolute photometry")
    if lumens == 0 or (lumens < 0 and lumens != -1):
        warnings.append(f"{lumens:g} lumens per lamp: read as absolute photometry")
    multiplier = numbers.positive("the candela multiplier")
    n_v = numbers.whole("the number of vertical angles", 2)
    n_h = numbers.whole("the number of horizontal angles", 1)
    code = numbers.whole("the photometric type: 1 for C, 2 for B, 3 for A")
    if code not in _TYPES:
        raise numbers.wrong("the photometric type: 1 for C, 2 for B, 3 for A")
    kind = _TYPES[code]
    units = numbers.one("the unit of length: 1 for feet, 2 for metres")
    if units not in (1, 2):
        warnings.append(f"unit of length {units:g} is unknown: read as metres")
    size = numbers.many(3, "width, length and height, number") * (FOOT_M if units == 1 else 1.0)
    if (size < 0).any():
        warnings.append("negative width, length or height: a round opening")
    ballast = numbers.positive("the ballast factor")
    if edition <= LAST_BALLAST_LAMP:
        field_12 = numbers.positive("the ballast-lamp photometric factor")
        ballast *= field_12
        if field_12 != 1:
            warnings.append(f"ballast-lamp factor {field_12:g} is applied to the candela")
    else:
        field_12 = numbers.one("the number after the ballast factor")
        if edition < FIRST_ORIGIN and field_12 != 1:
            warnings.append(f"the number after the ballast factor is {field_12:g}, which LM-63-{edition} does not define: not applied")
    watts = numbers.one("input watts")
    v = numbers.ascending(n_v, "vertical angle", *VERTICAL_RANGE[kind])
    h = numbers.ascending(n_h, "horizontal angle", *HORIZONTAL_RANGE[kind])
    table = numbers.many(n_v * n_h, "candela value")
    candela = _not_negative(table, numbers, warnings) * (multiplier * ballast)
    with locate(str(path)):
        distribution = Distribution(kind, v, h, candela.reshape(n_h, n_v))
    if not distribution.complete:
        warnings.append(f"planes from {h[0]:g} to {h[-1]:g} deg tell neither a symmetry nor the full turn: dark where they say nothing")
    if kind != "C" and n_h == 1:
        warnings.append(f"one horizontal angle, which the standard does not define for type {kind}: read as the same light at all of them")
    if kind != "C" and v[0] == 0:
        warnings.append("vertical angles begin at 0: read as mirrored about the horizontal plane")
    return {
        "distribution": distribution,
        "lamps": lamps,
        "lumens_per_lamp": lumens if lumens > 0 else None,
        "watts": watts,
        "size_m": tuple(size.tolist()),
        "feet": units == 1,
        "multiplier": multiplier,
        "ballast_factor": ballast,
        "field_12": field_12,
    }


def _not_negative(table: NDArray[np.float64], numbers: Numbers, warnings: list[str]) -> NDArray[np.float64]:
    least = table.min()
    if least >= 0:
        return table
    if least < -NOISE * table.max():
        k = int(table.argmin())
        raise numbers.wrong(f"candela value {k + 1} of {len(table)}, not negative", back=len(table) - k)
    warnings.append(f"slightly negative candela, down to {least:g} of {table.max():g}: read as zero")
    return np.maximum(table, 0.0)


def has_version(text: str) -> bool:
    """Whether a file's text begins with a version line of LM-63."""
    return _VERSION.match(text.lstrip()) is not None


def has_tilt(text: str) -> bool:
    """Whether a file's text has a TILT line, as LM-63 demands; EULUMDAT may have one among its names."""
    return _TILT.search(text) is not None


def write(path: str | Path, distribution: Distribution, keywords: Mapping[str, str] | None = None) -> None:
    """Write a distribution as LM-63-2019, absolute photometry; the file appears whole or not at all.

    Nine significant digits. keywords: in addition to, or in place of, those that the standard demands. Raises LuxloopError where the file
    cannot be written.
    """
    required = {"TEST": "none", "TESTLAB": "luxloop (computed)", "ISSUEDATE": "none", "MANUFAC": "none"}
    labels = [
        f"[{key if number == 0 else 'MORE'}] {line}"
        for key, value in {**required, "LUMINAIRE": Path(path).stem, **(keywords or {})}.items()
        for number, line in enumerate(value.splitlines() or [""])
    ]
    v, h = distribution.vertical_deg, distribution.horizontal_deg
    code = next(code for code, kind in _TYPES.items() if kind == distribution.type)
    # One lamp of unknown flux; an opening of no size, in metres. 1.00001: origin of the file unspecified.
    head = ["IES:LM-63-2019", *labels, "TILT=NONE", f"1 -1 1 {len(v)} {len(h)} {code} 2 0 0 0", "1 1.00001 0"]
    lines = [line for values in (v, h, *distribution.candela) for line in _lines(values)]
    atomic_write(Path(path), "\r\n".join([*head, *lines, ""]))


def _lines(values: NDArray[np.float64]) -> Iterator[str]:
    for start in range(0, len(values), _PER_LINE):
        yield " ".join(f"{value:.9g}" for value in values[start : start + _PER_LINE])
