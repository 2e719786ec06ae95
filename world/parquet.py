"""Tables of recordings, read once their file is known to declare no more memory than the budget allows."""

import os
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq

from luxloop.world.budget import afford
from luxloop.world.errors import LuxloopError
from luxloop.world.files import reading

BYTES_A_VALUE: Final = 16  # of a table while it is read, however well it was compressed
ROWS: Final = 65_536  # read at once, so that no column reserves memory for as many values as it claims to have
TYPES: Final = (pa.int64(), pa.float64(), pa.bool_(), pa.string())


def read_parquet(file: Path) -> pa.Table:
    """Read a recording's table of steps. Raises LuxloopError where it is missing or damaged."""
    import pyarrow.compute as pc

    if not os.path.isfile(file):
        raise LuxloopError(f"{file}: is missing, no step was recorded; record the run again")
    with reading(file, "damaged, not readable as Parquet", "record the run again"):
        schema = pq.read_schema(file)
        if strange := [field.name for field in schema if field.type not in TYPES]:
            raise ValueError(f"the column {strange[0]!r} has a type that recordings do not have")
        texts = [field.name for field in schema if field.type == pa.string()]
        with pq.ParquetFile(file, read_dictionary=texts) as stored:
            afford(f"{file}: its table", _declared(stored.metadata), "record the run again")
            table = pa.Table.from_batches(stored.iter_batches(ROWS), stored.schema_arrow)
        chunks = (chunk for name in texts for chunk in table[name].chunks)
        unpacked = sum(len(chunk) * (pc.max(pc.binary_length(chunk.dictionary)).as_py() or 0) for chunk in chunks)
        afford(f"{file}: its texts", unpacked, "record the run again")
        return table.cast(schema)


def _declared(metadata: pq.FileMetaData) -> int:
    """Bytes of all columns, texts that are the same in many rows counted once.

    From the row groups, as pyarrow ends the process where it is asked for a column chunk whose metadata are damaged.
    """
    groups = (metadata.row_group(k) for k in range(metadata.num_row_groups))
    return sum(max(BYTES_A_VALUE * each.num_rows * metadata.num_columns, each.total_byte_size) for each in groups)
