"""EULUMDAT (.ldt) files: one value a line, planes C and angles gamma of a luminaire that looks down.

The reader names the line of an error and tolerates common oddities with a warning, which available libraries do not.
"""

import re
from itertools import chain
from pathlib import Path

import numpy as np

from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import atomic_write
from luxloop.world.photometry.distribution import VERTICAL_RANGE, Array, Distribution
from luxloop.world.photometry.record import Numbers, Photometry

_SETS_AT = 26  # line of the number of lamp sets, each of which takes six lines
_COUNTS = re.compile(r".*\n\s*\d+\s*\n\s*[0-4]\s*\n\s*\d+[.,]?0*\s*\n")  # lines 2 to 4: kind, symmetry, number of planes
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")  # or a decimal comma
_WHOLE_THOUSANDS = re.compile(r"[1-9]\d{0,2}\.000")  # which is 1, or 1000 where a point separates thousands
_RATIOS = 10  # lines of direct ratios, unused


class _Lines:
    """The lines of the header, numbered from 1, as texts and numbers with decimal point or comma."""

    def __init__(self, path: Path, text: str, warnings: list[str]) -> None:
        self.path, self.warnings = path, warnings
        self._lines = text.split("\n")

    def text(self, number: int) -> str:
        return self._lines[number - 1].strip().strip('"') if number <= len(self._lines) else ""

    def number(self, number: int, what: str) -> float:
        if number > len(self._lines):
            last = len("\n".join(self._lines).rstrip().split("\n"))
            raise LuxloopError(f"{self.path}, line {last}: expected {what} on line {number}, found the file's end; fetch the whole file")
        text = self.text(number)
        numbers = Numbers(self.path, text or "(nothing)", number, comma=".")
        found = numbers.one(what)
        if numbers.rest:
            raise LuxloopError(f"{self.path}, line {number}: expected {what}, one number, found {text[:40]!r}; correct it")
        if _THOUSANDS.fullmatch(text):
            self.warnings.append(
                f"line {number}: {what} is {text!r}, read as {found:g}; write {text.replace(',', '')} if thousands are meant"
            )
        return found

    def whole(self, number: int, what: str, low: int, high: float = np.inf) -> int:
        value = self.number(number, what)
        if value != int(value) or not low <= value <= high:
            limits = f"at least {low}" if high == np.inf else f"{low} to {high:g}"
            raise LuxloopError(f"{self.path}, line {number}: expected {what} ({limits}), found {self.text(number)[:40]!r}; correct it")
        return int(value)

    def optional(self, number: int, what: str) -> float:
        """An optional number: zero, with a warning, if missing."""
        try:
            return self.number(number, what)
        except LuxloopError:
            self.warnings.append(f"line {number}: {what} is {self.text(number)[:40]!r}, read as 0")
            return 0.0


def parse(text: str, path: Path) -> Photometry:
    """Photometry of an EULUMDAT file's text; `path` is for messages. Several sets of lamps are alternatives: the first one counts.

    Raises LuxloopError with the line and what was expected there.
    """
    warnings: list[str] = []
    text, stop, _ = text.partition("\x1a")
    if stop:
        warnings.append("ends in Ctrl-Z")
    lines = _Lines(path, text, warnings)
    symmetry = lines.whole(3, "the symmetry Isym", 0, 4)
    n_c = lines.whole(4, "the number of C planes", 1)
    n_gamma = lines.whole(6, "the number of angles gamma in a plane", 2)
    factor = lines.number(24, "the conversion factor") if lines.text(24) else 1.0
    if factor == 0:
        warnings.append("conversion factor 0 is read as 1")
        factor = 1.0
    sets = lines.whole(_SETS_AT, "the number of lamp sets", 1)
    lamps = int(lines.optional(_SETS_AT + 1, "the number of lamps"))
    flux = lines.number(_SETS_AT + 3, "the total luminous flux of the lamps in lm")
    if _WHOLE_THOUSANDS.fullmatch(flux_text := lines.text(_SETS_AT + 3)):
        warnings.append(
            f"line {_SETS_AT + 3}: the luminous flux is {flux_text}, read as {flux:g} lm; leave the point out if thousands are meant"
        )
    if factor <= 0 or flux <= 0:
        line, what = (24, "a conversion factor") if factor <= 0 else (_SETS_AT + 3, "a luminous flux")
        raise LuxloopError(f"{path}, line {line}: expected {what} above 0, found {lines.text(line)[:40]!r}; correct it")
    if factor != 1.0:
        warnings.append(f"conversion factor {factor:g} is applied to the candela")
    if sets > 1:
        warnings.append(f"{sets} sets of lamps: the first one counts")
    first = _SETS_AT + 6 * sets + _RATIOS + 1
    body = text.split("\n", first - 1)
    if len(body) < first:
        raise LuxloopError(f"{path}, line {len(body)}: expected C plane 1 of {n_c} on line {first}, found the file's end")
    numbers = Numbers(path, body[-1], first, comma=".")
    c = numbers.ascending(n_c, "C plane", 0.0, 360.0)
    planes = _planes(symmetry, c, numbers)
    gamma = numbers.ascending(n_gamma, "angle gamma", *VERTICAL_RANGE["C"])
    table = numbers.many(len(planes) * n_gamma, "value in cd/klm")
    if (table < 0).any():
        k = int(table.argmin())
        raise numbers.wrong(f"value in cd/klm {k + 1} of {len(table)}, not negative", back=len(table) - k)
    numbers.end(warnings)
    comma = re.search(r"\S*,\S*", body[-1])
    if comma and "." in body[-1]:
        line = first + body[-1].count("\n", 0, comma.start())
        raise LuxloopError(f"{path}, line {line}: expected a decimal point as elsewhere, found {comma[0][:40]!r}; leave the comma out")
    if comma and all(map(_THOUSANDS.fullmatch, re.findall(r"\S*,\S*", body[-1]))):
        warnings.append(f"values such as {comma[0]} are read with a decimal comma; leave it out if thousands are meant")
    with locate(str(path)):
        distribution = Distribution("C", gamma, planes, table.reshape(len(planes), n_gamma) * (factor * flux / 1000))
    if not distribution.complete:
        warnings.append(f"planes C from {planes[0]:g} to {planes[-1]:g} deg do not close: dark where they say nothing")
    length, width = (lines.optional(n, "the luminous area's size in mm") / 1000 for n in (16, 17))
    height = max(lines.optional(n, "the luminous area's height in mm") for n in (18, 19, 20, 21)) / 1000
    return Photometry(
        path=path,
        format="EULUMDAT",
        distribution=distribution,
        luminaire=lines.text(9) or path.stem,
        lamps=abs(lamps),
        lumens_per_lamp=flux / lamps if lamps > 0 else None,
        watts=lines.optional(_SETS_AT + 6, "watts"),
        size_m=(width or -length, length, height),
        multiplier=factor * flux / 1000,
        keywords={"MANUFAC": lines.text(1), "TEST": lines.text(8), "LUMCAT": lines.text(10), "LAMP": lines.text(_SETS_AT + 2)},
        warnings=tuple(warnings),
    )


def has_counts(text: str) -> bool:
    """Whether a file's text begins as EULUMDAT does: a name, then the kind, the symmetry and the number of planes."""
    return _COUNTS.match(text) is not None


def _planes(symmetry: int, c: Array, numbers: Numbers) -> Array:
    """The planes that a symmetry stores: all (0), one (1), C0 to C180 (2), C270 through C0 to C90 (3), C0 to C90 (4).

    C360, where it is counted, is C0.
    """
    if symmetry < 2:
        return c if symmetry == 0 else c[:1]
    if symmetry == 3 and (c[0], c[-1]) == (90, 270):
        return c  # the other half, as some programs store it
    c = c[c < 360]
    planes = np.concatenate([c[c >= 270] - 360, c[c <= 90]]) if symmetry == 3 else c[c <= (180 if symmetry == 2 else 90)]
    first, last = {2: (0, 180), 3: (-90, 90), 4: (0, 90)}[symmetry]
    if not len(planes) or planes[0] != first or planes[-1] != last:
        raise numbers.wrong(f"C planes that hold C{first % 360} and C{last}, as symmetry {symmetry} needs")
    return planes


def write(path: str | Path, distribution: Distribution, name: str) -> None:
    """Write a distribution of type C with planes all round, evenly spaced, as EULUMDAT; the file appears whole or not at all.

    name: of the luminaire. Its one lamp has the flux of the distribution. Raises LuxloopError where the file cannot be written.
    """
    path, c, gamma = Path(path), distribution.horizontal_deg, distribution.vertical_deg
    flux = round(distribution.luminous_flux, 3) or 1.0  # of a dark luminaire, whose table is zero
    kind, no_symmetry, uneven = 3, 0, 0
    head = ["luxloop (computed)", kind, no_symmetry, len(c), f"{360 / len(c):g}", len(gamma), uneven]
    names = ["none", name, "none", path.name, "none"]
    opening, shares, lamp = [0] * 9, [100, 100, 1, 0], [1, 1, "none", f"{flux:.12g}", "none", "none", 0]
    values = (f"{value:.3f}" for value in (distribution.candela * (1000 / flux)).ravel())
    angles = (f"{angle:g}" for angle in (*c, *gamma))
    lines = chain(head, names, opening, shares, lamp, [0] * _RATIOS, angles, values, [""])
    atomic_write(path, "\r\n".join(map(str, lines)))
