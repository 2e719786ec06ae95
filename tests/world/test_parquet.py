"""Damaged tables are refused in a sentence; they never end the process."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from luxloop.world.arrays import ROWS, read_parquet
from luxloop.world.errors import LuxloopError


def test_a_column_whose_statistics_are_not_those_of_its_type_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.parquet"
    pq.write_table(pa.table({"step": [0, 1], "x": [0.5, 1.0]}), file)
    optional, required = b"\x25\x02\x18\x01x", b"\x25\x00\x18\x01x"  # repetition type and name in the schema
    assert file.read_bytes().count(optional) == 1
    file.write_bytes(file.read_bytes().replace(optional, required))
    with pytest.raises(LuxloopError, match=r"a\.parquet: damaged, not readable as Parquet \(.*histogram.*\); record the run again"):
        read_parquet(file)


def test_a_table_of_many_rows_is_read_whole(tmp_path: Path) -> None:
    n = 2 * ROWS + 3
    table = pa.table({"step": range(n), "loss": [("", "late", "lost")[k % 3] for k in range(n)]})
    pq.write_table(table, tmp_path / "a.parquet", row_group_size=ROWS - 1)
    assert read_parquet(tmp_path / "a.parquet").equals(table)
