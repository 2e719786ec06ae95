"""Photometric files (IES LM-63, EULUMDAT), intensity distributions on the sphere, and their light textures (T 2.3, 5.2)."""

import warnings
from collections.abc import Iterable
from pathlib import Path

from luxloop.world.photometry.distribution import Distribution, sample
from luxloop.world.photometry.eulumdat import has_counts
from luxloop.world.photometry.eulumdat import parse as parse_eulumdat
from luxloop.world.photometry.eulumdat import write as write_eulumdat
from luxloop.world.photometry.lm63 import has_tilt, has_version, write
from luxloop.world.photometry.lm63 import parse as parse_lm63
from luxloop.world.photometry.record import Photometry, load
from luxloop.world.photometry.texture import light_texture, rmse

__all__ = ["Distribution", "Photometry", "light_texture", "read_all", "read_photometry", "rmse", "sample", "write", "write_eulumdat"]


def read_photometry(path: str | Path) -> Photometry:
    """Read an IES LM-63 or EULUMDAT file; its content decides the format, or, if unclear, its suffix.

    path: of the file.
    Raises LuxloopError with the line and what was expected there.
    """
    path = Path(path)
    text = load(path)
    is_lm63 = has_version(text) or (not has_counts(text) and (has_tilt(text) or path.suffix.lower() == ".ies"))
    return (parse_lm63 if is_lm63 else parse_eulumdat)(text, path)


def read_all(paths: Iterable[str | Path]) -> list[Photometry]:
    """Read files as `read_photometry` does. Each kind of oddity is warned of once, with the first file and the number of others."""
    files = [read_photometry(path) for path in paths]
    odd: dict[str, list[Path]] = {}
    for file in files:
        for each in file.warnings:
            odd.setdefault(each, []).append(file.path)
    for each, (first, *more) in odd.items():
        warnings.warn(f"{first}: {each}" + (f" (as in {len(more)} more files)" if more else ""), stacklevel=2)
    return files
