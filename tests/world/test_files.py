"""Files: the memory budget, files written whole or not at all, NumPy and Parquet files that declare more than they hold."""

import struct
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from luxloop.world.arrays import ROWS, read_npy, read_npz, read_parquet
from luxloop.world.errors import LuxloopError
from luxloop.world.files import BUDGET_BYTES, afford, content, whole
from luxloop.world.images import decode
from luxloop.world.lamps import archive
from luxloop.world.messages import ArrayHead, given_arrays
from tests.refusal import refusal


def test_a_file_takes_its_place_when_it_is_whole(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    with whole(target) as part:
        part.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_what_fails_leaves_nothing_behind(tmp_path):
    with pytest.raises(ZeroDivisionError), whole(tmp_path / "a.txt") as part:
        part.write_text("half")
        raise ZeroDivisionError
    with refusal("is a folder"), whole(tmp_path) as part:
        part.write_text("all")
    with refusal("check the folder"), whole(tmp_path / "no" / "a.txt") as part:
        part.write_text("all")
    (tmp_path / "file").write_text("")
    with refusal("cannot be written"), whole(tmp_path / "file" / "a.txt") as part:
        part.write_text("all")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def npy_header(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text) + 1) + text.encode() + b"\n"


def npy(shape: tuple[int, ...], data: bytes = b"") -> bytes:
    return npy_header(f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}") + data


def npz(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


def png(width: int, height: int) -> bytes:
    """A PNG that declares its size, with the pixels of one row."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", zlib.compress(bytes(width + 1))), (b"IEND", b"")]
    body = (struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


def test_what_fits_is_afforded_and_what_does_not_is_named_with_its_remedy():
    afford("the scene", BUDGET_BYTES, "make it smaller")
    with pytest.raises(
        LuxloopError, match=r"^the scene would take at least 6 GB of memory, more than the budget of 3 GB; make it smaller$"
    ):
        afford("the scene", 2 * BUDGET_BYTES, "make it smaller")
    with pytest.raises(LuxloopError):
        afford("a size of 5,000 digits", 10**4999, "make it smaller")  # which no float holds


def test_arrays_declare_no_more_than_their_file_holds(tmp_path):
    file = tmp_path / "a.npy"
    file.write_bytes(npy((1_000_000_000,)))
    with pytest.raises(ValueError, match="longer than its file"):
        read_npy(file)
    with pytest.raises(ValueError, match="longer than its file"):
        read_npz(npz(tmp_path / "a.npz", a=npy((40_000, 40_000))))


def test_archives_that_unpack_to_more_than_the_budget_are_refused(tmp_path):
    file = npz(tmp_path / "a.npz", a=npy((2**26,), bytes(2**28)), b=npy((2**27,), bytes(2**29)))
    assert file.stat().st_size < 1e6
    with refusal(r"its arrays would take at least 3.22 GB"):
        read_npz(file)


@pytest.mark.parametrize(
    "header",
    [
        b"not an array",
        *map(npy_header, ("{'descr': '<f4", "(" * 200, "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }", "[1, 2]", "\0")),
    ],
)
def test_entries_that_are_no_arrays_are_told_in_a_sentence(header, tmp_path):
    with refusal("damaged, or no lamp file"):
        archive.load(npz(tmp_path / "a.npz", header=header))


def test_pictures_declare_no_more_pixels_than_the_budget_bears():
    assert decode(png(30, 1), "it") is not None
    for side in (10_000, 12_000, 100_000):
        with refusal(r"^it: its pixels would take at least .* GB of memory.*shrink the picture$"):
            decode(png(side, side), "it")
    assert decode(b"", "it") is None and decode(b"GIF89a", "it") is None


@pytest.mark.parametrize("shape", [(5, 7), (1000, 1000)])
def test_arrays_of_messages_are_unpacked_no_further_than_their_shape(shape):
    bomb = zlib.compress(bytes(50_000_000), 9)
    head = ArrayHead(dtype="u1", shape=shape, start=0, bytes=len(bomb), coding="deflate")
    tracemalloc.start()
    with pytest.raises(ValueError, match="has not the"):
        given_arrays({"a": head}, bomb, {"a": ("u1",)})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5_000_000  # the shape's bytes, the bomb itself, and a piece of zlib's


def test_only_regular_files_are_read():
    with refusal("no regular file"):
        content(Path("/dev/zero"))


def test_long_input_is_cut_short_in_messages():
    message = str(LuxloopError(f"{'a' * 5000}: unknown key; {'known ' * 500}are all"))
    assert len(message) <= 1000 and message.startswith("aaaa") and message.endswith("are all")
    assert max(map(len, message.split())) <= 200


def test_a_column_whose_statistics_are_not_those_of_its_type_is_refused(tmp_path):
    file = tmp_path / "a.parquet"
    pq.write_table(pa.table({"step": [0, 1], "x": [0.5, 1.0]}), file)
    optional, required = b"\x25\x02\x18\x01x", b"\x25\x00\x18\x01x"  # repetition type and name in the schema
    assert file.read_bytes().count(optional) == 1
    file.write_bytes(file.read_bytes().replace(optional, required))
    with refusal(r"a\.parquet: damaged, not readable as Parquet \(.*histogram.*\); record the run again"):
        read_parquet(file)


def test_a_table_of_many_rows_is_read_whole(tmp_path):
    n = 2 * ROWS + 3
    table = pa.table({"step": range(n), "loss": [("", "late", "lost")[k % 3] for k in range(n)]})
    pq.write_table(table, tmp_path / "a.parquet", row_group_size=ROWS - 1)
    assert read_parquet(tmp_path / "a.parquet").equals(table)
