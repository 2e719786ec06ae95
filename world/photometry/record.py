"""The content of a photometric file, and a tokenizer of its numbers: fast for valid files, with line numbers for errors."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from luxloop.world.errors import LuxloopError
from luxloop.world.files import content
from luxloop.world.photometry.distribution import Distribution


@dataclass(frozen=True, eq=False)
class Tilt:
    """Output of a lamp over its tilt; read, but not applied to the candela."""

    geometry: int  # 1 base up or down at nadir, 2 lamp stays horizontal, 3 lamp tilts with the luminaire
    angles_deg: NDArray[np.float64]
    factors: NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Photometry:
    """The content of a photometric file."""

    path: Path
    format: str  # "LM-63-2002", "EULUMDAT"
    distribution: Distribution
    luminaire: str = ""
    lamps: int = 1
    lumens_per_lamp: float | None = None  # None: absolute photometry, the candela are as measured
    watts: float = 0.0
    size_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # width, length, height of the opening; negative where round
    feet: bool = False  # the file's own unit of length
    multiplier: float = 1.0  # of the candela, already applied, as is the ballast factor
    ballast_factor: float = 1.0  # until 1991 with the ballast-lamp factor
    field_12: float = 1.0  # LM-63's number after the ballast factor: until 1991 the ballast-lamp factor, later not applied
    tilt: str = "NONE"
    tilt_factors: Tilt | None = None
    keywords: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def absolute(self) -> bool:
        return self.lumens_per_lamp is None


LARGEST = 1e15  # no number of photometry comes near it, and products of a few stay finite


def load(path: Path) -> str:
    """Text of a file with \\n at line ends: UTF-8, else Latin-1. Raises LuxloopError where it cannot be read, is empty or binary."""
    data = content(path)
    if not data.strip():
        raise LuxloopError(f"{path}, line 1: the file is empty; fetch it again")
    if b"\0" in data:
        raise LuxloopError(f"{path}, line 1: expected text, found a binary file; give a .ies or .ldt file saved as plain text")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


class Numbers:
    """A cursor over the numbers of `body`, whose first line is line `first_line` of the file.

    comma: its meaning, a blank or a decimal point.
    """

    def __init__(self, path: Path, body: str, first_line: int, comma: str = " ") -> None:
        self.path, self.first_line = path, first_line
        self._body = body.replace(",", comma)
        self._tokens = self._body.split()
        self._at = 0

    def one(self, what: str) -> float:
        return float(self.many(1, what)[0])

    def positive(self, what: str) -> float:
        value = self.one(what)
        if value <= 0:
            raise self.wrong(f"{what}, above 0")
        return value

    def whole(self, what: str, low: int | None = None) -> int:
        value = self.one(what)
        if value != int(value) or (low is not None and value < low):
            raise self.wrong(what + (" (a whole number)" if low is None else f" (a whole number, at least {low})"))
        return int(value)

    def many(self, count: int, what: str) -> NDArray[np.float64]:
        """The next `count` numbers. Raises LuxloopError at the first token that is none, and where the file ends too early."""
        tokens = self._tokens[self._at : self._at + count]
        try:
            values = np.array(list(map(float, tokens)))
            fine = bool((np.abs(values) <= LARGEST).all()) and "_" not in "".join(tokens)
        except ValueError:
            fine = False
        if not fine:
            bad = next(k for k, token in enumerate(tokens) if not _number(token))
            self._at += bad + 1
            raise self.wrong(_which(what, bad, count))
        if len(tokens) < count:
            line = self.first_line + self._body.rstrip().count("\n")
            missing = _which(what, len(tokens), count)
            raise LuxloopError(f"{self.path}, line {line}: expected {missing}, found the file's end; fetch the whole file")
        self._at += count
        return values

    def wrong(self, expected: str, back: int = 1) -> LuxloopError:
        """The error that the token `back` tokens before the cursor is not what was expected."""
        index = self._at - back
        return LuxloopError(f"{self.path}, line {self.line(index)}: expected {expected}, found {self._tokens[index][:40]!r}; correct it")

    def line(self, index: int) -> int:
        seen = 0
        for number, line in enumerate(self._body.split("\n"), start=self.first_line):
            seen += len(line.split())
            if seen > index:
                return number
        return self.first_line

    def ascending(self, count: int, what: str, low: float, high: float) -> NDArray[np.float64]:
        """The next `count` numbers, which must ascend within low to high."""
        values = self.many(count, what)
        bad = ~np.append(True, np.diff(values) > 0) | (values < low) | (values > high)
        if bad.any():
            k = int(bad.argmax())
            raise self.wrong(f"{_which(what, k, count)}, ascending within {low:g} to {high:g} deg", back=count - k)
        return values

    @property
    def rest(self) -> list[str]:
        return self._tokens[self._at :]

    def end(self, warnings: list[str]) -> None:
        """Check that no number follows, only words, with a warning. Raises LuxloopError at a number, since then all others may be
        misaligned.
        """
        rest = self.rest
        if rest and rest[0].lstrip("+-.")[:1].isdigit():
            self._at += 1
            raise self.wrong("the end of the data (is a comma or a blank within a number?)")
        if rest:
            warnings.append(f"{len(rest)} words after the data are ignored, from {rest[0][:40]!r} on")


def _number(token: str) -> bool:
    return re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", token) is not None and abs(float(token)) <= LARGEST


def _which(what: str, k: int, count: int) -> str:
    return what if count == 1 else f"{what} {k + 1} of {count}"
