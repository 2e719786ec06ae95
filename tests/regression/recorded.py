"""What the tests of recorded runs share: where recordings lie, how one is replaced, and how differences are told."""

from pathlib import Path

import pyarrow as pa

from luxloop.loop.recording.comparison import Difference
from luxloop.loop.recording.manifest import write_table

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "scenarios" / "recordings"


def file_of(name: str) -> Path:
    return FOLDER / f"{name}.parquet"


def told(differences: tuple[Difference, ...]) -> str:
    return "\n".join(
        f"  {d.column}: from step {d.first_step} on ({d.recorded} is now {d.replayed}), at most {d.largest:.3g} at step {d.largest_step}"
        for d in differences
    )


def replace(name: str, now: pa.Table, news: str | None) -> str:
    """Write a recording anew; news: what is different in it, None where there was none. Returns what to print."""
    FOLDER.mkdir(exist_ok=True)
    write_table(file_of(name), now)
    return f"\n{name} recorded:\n{'  for the first time' if news is None else news or '  as before'}"
