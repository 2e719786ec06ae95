"""Photometric files for the tests, written by hand rather than by the writer under test."""

from collections.abc import Iterable, Sequence


def row(values: Iterable[float]) -> str:
    return " ".join(f"{value:g}" for value in values)


def ies(
    vertical: Sequence[float],
    horizontal: Sequence[float],
    table: Sequence[Sequence[float]],
    code: int = 1,
    lumens: float = -1,
    multiplier: float = 1,
    ballast: float = 1,
    head: str = "IESNA:LM-63-2002\n[TEST] 1\n",
    tilt: str = "TILT=NONE\n",
) -> str:
    """Text of an LM-63 file, with a line each for the counts, the factors, the angles, and every plane."""
    planes = "".join(f"{row(plane)}\n" for plane in table)
    counts = f"1 {lumens:g} {multiplier:g} {len(vertical)} {len(horizontal)} {code} 2 0 0 0\n{ballast:g} 1 10\n"
    return f"{head}{tilt}{counts}{row(vertical)}\n{row(horizontal)}\n{planes}"


def ldt(
    symmetry: int, c: Sequence[float], gamma: Sequence[float], table: Sequence[Sequence[float]], lamps: str = "1", flux: str = "2000"
) -> str:
    """Text of an EULUMDAT file with one set of lamps."""
    head = ["maker", 1, symmetry, len(c), 0, len(gamma), 0, "report", "luminaire", "number", "file", "date", *[0] * 3, 200, 0, 10, 20, 0, 0]
    sets = [100, 100, 1, 0, 1, lamps, "LED", flux, 4000, 80, 20, *[0.5] * 10]
    values = [f"{value:g}" for plane in table for value in plane]
    return "\n".join(map(str, [*head, *sets, *c, *gamma, *values])) + "\n"
