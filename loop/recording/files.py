"""The files of a recording: what they are called, and tables as they are written."""

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from luxloop.loop.recording.manifest import FILE as MANIFEST
from luxloop.world.files import whole

TRAJECTORY, SUMMARY, REPORT, VIDEO, EDITS = "trajectory.parquet", "summary.json", "report.png", "video.mp4", "edits.json"
RIG = "rig.json"  # of a run on a rig: its file, and how frames came
TWIN, TWIN_PICTURE = "twin.parquet", "twin.png"  # of a rig's frames held against the simulated plant's
BEAM = "beam.png"  # of the last light that was digitised live
FILES = (TRAJECTORY, SUMMARY, REPORT, VIDEO, EDITS, RIG, TWIN, TWIN_PICTURE, BEAM, MANIFEST)


def table_of(rows: list[dict[str, Any]], schema: pa.Schema) -> pa.Table:
    """Rows as a table; NaN becomes null, and so does what a row lacks."""
    columns = [pa.array([r.get(field.name) for r in rows], field.type, from_pandas=True) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema)


def write_table(file: Path, table: pa.Table) -> None:
    """Write Parquet, whole or not at all. Raises LuxloopError where it cannot be written."""
    with whole(file) as part:
        pq.write_table(table, part, use_dictionary=False)
