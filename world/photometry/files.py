"""Read a photometric file of any kind."""

import warnings
from collections.abc import Iterable
from pathlib import Path

from luxloop.world.photometry import eulumdat, lm63
from luxloop.world.photometry.record import Photometry
from luxloop.world.photometry.text import load


def read_photometry(path: str | Path) -> Photometry:
    """Read an IES LM-63 or EULUMDAT file at path, by what it holds; where that does not tell, by its suffix, .ies or not.

    Raises PhotometryError, a LuxloopError, with the line and what was expected there.
    """
    path = Path(path)
    text = load(path)
    is_lm63 = lm63.has_version(text) or (not eulumdat.has_counts(text) and (lm63.has_tilt(text) or path.suffix.lower() == ".ies"))
    return (lm63 if is_lm63 else eulumdat).parse(text, path)


def read_all(paths: Iterable[str | Path]) -> list[Photometry]:
    """Read files as `read` does, and warn of what is odd in them: of each kind once, for the first file and the number of others."""
    files = [read_photometry(path) for path in paths]
    odd: dict[str, list[Path]] = {}
    for file in files:
        for each in file.warnings:
            odd.setdefault(each, []).append(file.path)
    for each, (first, *more) in odd.items():
        warnings.warn(f"{first}: {each}" + (f" (as in {len(more)} more files)" if more else ""), stacklevel=2)
    return files
