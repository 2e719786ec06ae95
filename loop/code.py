"""The version of the code that decides a run, for results that have to follow it."""

import hashlib
from functools import cache
from importlib.resources import files
from pathlib import Path

DECISIVE = {"world": "**/*", "perception": "**/*", "controllers": "**/*.py", "loop": "*.py", "loop.lighting": "*.py"}
SHOWING = (  # beginnings of the names of those modules of loop that decide no figure
    "campaign",
    "cli",
    "commands",
    "comparison",
    "doctor",
    "evaluate",
    "executors",
    "gradient",
    "headlight",
    "jobs",
    "photometry_picture",
    "progress",
    "ranges",
    "rectangles",
    "replay",
    "report",
    "tables",
    "template",
    "tune",
    "video",
)


@cache
def digest_of_code() -> str:
    """SHA-256, hexadecimal, of the sources of world, perception, controllers and loop, but for those modules of loop that only show."""
    digest = hashlib.sha256()
    for package, pattern in DECISIVE.items():
        for path in sorted(Path(str(files(package))).glob(pattern)):
            shows = package == "loop" and path.name.startswith(SHOWING)
            if path.is_file() and path.suffix != ".pyc" and not shows:
                digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()
