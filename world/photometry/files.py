"""Read a photometric file of any kind."""

from world.photometry import lm63
from world.photometry.record import Photometry


def read(path: str | Path) -> Photometry:
    """Read an IES LM-63 file. Raises PhotometryError with the line and what was expected there."""
    return lm63.read(path)
