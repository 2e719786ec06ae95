"""NumPy and Parquet files: declared sizes are checked before allocation, and pickled objects are refused, since they run code."""

import io
import math
import os
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.lib import format as npy

from luxloop.world.errors import LuxloopError
from luxloop.world.files import afford, reading, regular, whole

BYTES_A_NUMBER: Final = 16  # readers turn most numbers into float64, and copy them once
REMEDY: Final = "save fewer numbers in it"
LEVEL: Final = 1  # of compression: a lamp shrinks to a half or a quarter; 6 saves another 10 to 30 % and takes up to five times as long
_HEADERS: Final = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}

Arrays = dict[str, np.ndarray[Any, Any]]


def read_npy(path: Path) -> np.ndarray[Any, Any]:
    """The array of a .npy. Raises LuxloopError beyond the memory budget, and NumPy's errors for damaged files."""
    with regular(path).open("rb") as stream:
        afford(f"{path}: its array", BYTES_A_NUMBER * _array_size(stream, path.stat().st_size), REMEDY)
        return _array(stream)


def read_npz(path: Path) -> Arrays:
    """The arrays of a .npz by name, `.npy` left out. Raises as `read_npy` does."""
    with zipfile.ZipFile(regular(path)) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        afford(f"{path}: its entries", sum(info.file_size for info in members.values()), REMEDY)
        declared = 0
        for info in members.values():
            with archive.open(info) as stream:
                declared += _array_size(stream, info.file_size)
        afford(f"{path}: its arrays", BYTES_A_NUMBER * declared, REMEDY)
        arrays: Arrays = {}
        for name, info in members.items():
            with archive.open(info) as stream:
                arrays[name] = _array(stream)
        return arrays


def write_npz(path: Path, arrays: Iterable[tuple[str, np.ndarray[Any, Any]]]) -> None:
    """Write arrays by name as a .npz, whole or not at all; equal arrays give equal bytes. Raises LuxloopError as `whole`."""
    with whole(path) as part, zipfile.ZipFile(part, "w") as archive:
        for name, array in arrays:
            buffer = io.BytesIO()
            npy.write_array(buffer, np.asarray(array, order="C"), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), buffer.getbuffer(), zipfile.ZIP_DEFLATED, LEVEL)


def _array_size(stream: IO[bytes], n_bytes: int) -> int:
    """Number of values that the header of an array declares. Raises ValueError if the stream has too few bytes for them."""
    version = npy.read_magic(stream)
    if version not in _HEADERS:
        raise ValueError(f"an array of format version {version}")
    try:
        shape, _, dtype = _HEADERS[version](stream)
    except MemoryError as error:  # what Python's parser says of brackets in brackets
        raise ValueError("a header that is nested too deep") from error
    count = math.prod(shape)
    if count * dtype.itemsize > n_bytes:
        raise ValueError("an array that is longer than its file")
    stream.seek(0)
    return count


def _array(stream: IO[bytes]) -> np.ndarray[Any, Any]:
    return npy.read_array(stream, allow_pickle=False)  # type: ignore[no-any-return]


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
            afford(f"{file}: its table", _table_bytes(stored.metadata), "record the run again")
            table = pa.Table.from_batches(stored.iter_batches(ROWS), stored.schema_arrow)
        chunks = (chunk for name in texts for chunk in table[name].chunks)
        unpacked = sum(len(chunk) * (pc.max(pc.binary_length(chunk.dictionary)).as_py() or 0) for chunk in chunks)
        afford(f"{file}: its texts", unpacked, "record the run again")
        return table.cast(schema)


def _table_bytes(metadata: pq.FileMetaData) -> int:
    """Bytes of all columns, texts that are the same in many rows counted once.

    From the row groups, as pyarrow ends the process where it is asked for a column chunk whose metadata are damaged.
    """
    groups = (metadata.row_group(k) for k in range(metadata.num_row_groups))
    return sum(max(BYTES_A_VALUE * each.num_rows * metadata.num_columns, each.total_byte_size) for each in groups)
