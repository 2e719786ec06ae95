"""Read a photometric file of any kind."""

from pathlib import Path

from world.photometry import eulumdat, lm63
from world.photometry.record import Photometry
from world.photometry.text import load


def read(path: str | Path) -> Photometry:
    """Read an IES LM-63 or EULUMDAT file at path, by what it holds; where that does not tell, by its suffix, .ies or not.

    Raises PhotometryError, a LuxloopError, with the line and what was expected there.
    """
    path = Path(path)
    text = load(path)
    is_lm63 = lm63.has_version(text) or not eulumdat.has_counts(text) and (lm63.has_tilt(text) or path.suffix.lower() == ".ies")
    return (lm63 if is_lm63 else eulumdat).parse(text, path)
