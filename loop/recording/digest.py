"""The version of the code that decides a run, for results that have to follow it."""

import hashlib
from functools import cache
from importlib.resources import files
from pathlib import Path

PACKAGES = ("world", "perception", "controllers", "loop")
NO_FIGURE = (*(f"studies/{part}" for part in ("beams", "contracts", "dataset", "evaluation", "jobs", "training")), "commands", "report")
SHOWING = tuple(f"loop/{folder}/" for folder in NO_FIGURE)  # folders that decide no figure of a run


@cache
def digest_of_code() -> str:
    """SHA-256, hexadecimal, of all files of world, perception, controllers and loop, but for those in folders that decide no figure."""
    digest = hashlib.sha256()
    root = Path(str(files("luxloop")))
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*")):
            name = path.relative_to(root).as_posix()
            if path.is_file() and path.suffix != ".pyc" and not name.startswith(SHOWING):
                digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()
