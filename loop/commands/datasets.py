"""Make a data set for the command line, and say what is in it."""

from pathlib import Path
from typing import Final

from luxloop.loop.report import terminal as tables
from luxloop.loop.studies.dataset.drawn import read
from luxloop.loop.studies.dataset.make import make_dataset

SHOWN: Final = 6  # classes in the closing line


def do_dataset(file: Path, number: int, out: Path | None, processes: int | None, allow_code: bool) -> bool:
    """Make a data set, say what is in it and which scenes failed; returns whether all were made."""
    folder = out or Path("runs") / file.stem
    counts, failures = make_dataset(read(file, number, allow_code=allow_code), folder, processes)
    for key, reason in failures.items():
        tables.console(stderr=True).print(f"failed: scene {key}: {reason}", markup=False)
    classes = ", ".join(f"{number:,} {name}" for name, number in counts.objects.most_common(SHOWN))
    scenes, frames = tables.counted(counts.scenes, "scene"), tables.counted(counts.frames, "frame")
    print(f"{counts.file} written: {scenes}, {frames}, objects: {classes or 'none'}")
    return not failures
