"""What a client can choose from: shipped scenarios, controllers and regulations, and recordings below the working directory."""

import time
from functools import cache
from pathlib import Path
from typing import Any, Final

import pyarrow.parquet as pq

from luxloop.loop.recording.files import TRAJECTORY
from luxloop.loop.recording.manifest import FILE, Manifest
from luxloop.loop.scenario.listing import listing
from luxloop.loop.scenario.shipped import shipped_files
from luxloop.loop.studio.sources import RUNS
from luxloop.world.errors import LuxloopError
from luxloop.world.lamps.presets import SUMMARIES
from luxloop.world.regulation.tables import sets

MOST: Final = 200  # recordings, the newest


def choices() -> dict[str, Any]:
    """As the protocol has them."""
    of = {kind: [{key: each[key] for key in ("name", "description")} for each in listing(kind)] for kind in ("scenarios", "controllers")}
    names = {"rules": list(sets()), "symbols": list(shipped_files("symbols")), "lamps": list(SUMMARIES)}
    return {**of, **names, "recordings": recordings()}


def recordings() -> list[dict[str, str]]:
    """Folders of recordings in `runs`, the newest first, and what is in them. Those that cannot be read are left out."""
    found = {each.parent: each.stat().st_mtime for each in RUNS.glob(f"*/{FILE}") if (each.parent / TRAJECTORY).is_file()}
    newest = sorted(found, key=lambda folder: -found[folder])[:MOST]
    told = ((folder, _told(folder, found[folder])) for folder in newest)
    return [{"name": folder.as_posix(), "description": text} for folder, text in told if text]


@cache
def _told(folder: Path, written_s: float) -> str:
    try:
        name, steps = Manifest.read(folder).scenario["name"], pq.read_metadata(folder / TRAJECTORY).num_rows
    except (LuxloopError, OSError, KeyError, ValueError):
        return ""
    return f"{name}, {steps} steps, {time.strftime('%Y-%m-%d %H:%M', time.localtime(written_s))}"
