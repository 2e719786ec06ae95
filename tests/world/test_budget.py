"""A few bytes can declare any size; what they declare is refused before it is allocated."""

import struct
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import pytest

from luxloop.world.arrays import read_npy, read_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import BUDGET_BYTES, afford, content
from luxloop.world.images import decode
from luxloop.world.lamps import archive
from luxloop.world.messages import ArrayHead, given_arrays


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


def test_what_fits_is_afforded_and_what_does_not_is_named_with_its_remedy() -> None:
    afford("the scene", BUDGET_BYTES, "make it smaller")
    with pytest.raises(
        LuxloopError, match=r"^the scene would take at least 6 GB of memory, more than the budget of 3 GB; make it smaller$"
    ):
        afford("the scene", 2 * BUDGET_BYTES, "make it smaller")
    with pytest.raises(LuxloopError):
        afford("a size of 5,000 digits", 10**4999, "make it smaller")  # which no float holds


def test_arrays_declare_no_more_than_their_file_holds(tmp_path: Path) -> None:
    file = tmp_path / "a.npy"
    file.write_bytes(npy((1_000_000_000,)))
    with pytest.raises(ValueError, match="longer than its file"):
        read_npy(file)
    with pytest.raises(ValueError, match="longer than its file"):
        read_npz(npz(tmp_path / "a.npz", a=npy((40_000, 40_000))))


def test_archives_that_unpack_to_more_than_the_budget_are_refused(tmp_path: Path) -> None:
    file = npz(tmp_path / "a.npz", a=npy((2**26,), bytes(2**28)), b=npy((2**27,), bytes(2**29)))
    assert file.stat().st_size < 1e6
    with pytest.raises(LuxloopError, match=r"its arrays would take at least 3.22 GB"):
        read_npz(file)


@pytest.mark.parametrize(
    "header", ["{'descr': '<f4", "(" * 200, "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }", "[1, 2]", "\0"]
)
def test_headers_that_are_damaged_are_told_in_a_sentence(header: str, tmp_path: Path) -> None:
    file = npz(tmp_path / "a.npz", header=npy_header(header))
    with pytest.raises(LuxloopError, match="damaged, or no lamp file"):
        archive.load(file)


def test_entries_that_are_no_arrays_are_told_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(LuxloopError, match="damaged, or no lamp file"):
        archive.load(npz(tmp_path / "a.npz", header=b"not an array"))


def test_pictures_declare_no_more_pixels_than_the_budget_bears() -> None:
    assert decode(png(30, 1), "it") is not None
    for side in (10_000, 12_000, 100_000):
        with pytest.raises(LuxloopError, match=r"^it: its pixels would take at least .* GB of memory.*shrink the picture$"):
            decode(png(side, side), "it")
    assert decode(b"", "it") is None and decode(b"GIF89a", "it") is None


@pytest.mark.parametrize("shape", [(5, 7), (1000, 1000)])
def test_arrays_of_messages_are_unpacked_no_further_than_their_shape(shape: tuple[int, ...]) -> None:
    bomb = zlib.compress(bytes(50_000_000), 9)
    head = ArrayHead(dtype="u1", shape=shape, start=0, bytes=len(bomb), coding="deflate")
    tracemalloc.start()
    with pytest.raises(ValueError, match="has not the"):
        given_arrays({"a": head}, bomb, {"a": ("u1",)})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5_000_000  # the shape's bytes, the bomb itself, and a piece of zlib's


def test_only_regular_files_are_read() -> None:
    with pytest.raises(OSError, match="no regular file"):
        content(Path("/dev/zero"))


def test_long_input_is_cut_short_in_messages() -> None:
    message = str(LuxloopError(f"{'a' * 5000}: unknown key; {'known ' * 500}are all"))
    assert len(message) <= 1000 and message.startswith("aaaa") and message.endswith("are all")
    assert max(map(len, message.split())) <= 200
