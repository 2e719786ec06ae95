"""Arrays of steps in shared memory, for clients on the same machine (docs/programs.md)."""

import os
import secrets
import shutil
import struct
import threading
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

import numpy as np

from luxloop.world.errors import LuxloopError
from luxloop.world.messages import CODES

HEAD = struct.Struct("<8sIIQQ")  # magic, version, bytes of the head, number, bytes of the arrays
NUMBER = struct.Struct("<Q")
NUMBER_AT = 16
MAGIC = b"LUXLOOP\0"
VERSION = 1
ALIGNED = 64  # bytes of the head, and alignment of arrays
LINUX = Path("/dev/shm")


class Blocks:
    """Shared memory of one client, two blocks per run: while one is read, the next step is written to the other."""

    def __init__(self) -> None:
        self._blocks, self._lock, self._closed = dict[tuple[int, int], SharedMemory](), threading.Lock(), False
        self._turns = dict[int, int]()  # block written last, by run

    def put(self, run: int, number: int, arrays: Mapping[str, np.ndarray]) -> dict[str, Any] | None:
        """Write arrays of a step; returns their places, None without room. number: of the message, above 0."""
        listed, end = dict[str, Any](), ALIGNED
        for name, array in arrays.items():
            listed[name] = {"dtype": CODES[str(array.dtype)], "shape": array.shape, "start": end, "bytes": array.nbytes}
            end += -(-array.nbytes // ALIGNED) * ALIGNED
        with self._lock:
            self._turns[run] = turn = 1 - self._turns.get(run, 0)
            block = None if self._closed else self._block((run, turn), end)
            if block is None:
                return None
            assert block.buf is not None
            HEAD.pack_into(block.buf, 0, MAGIC, VERSION, ALIGNED, 0, end - ALIGNED)
            for name, array in arrays.items():
                np.ndarray(array.shape, array.dtype, block.buf, listed[name]["start"])[...] = array
            NUMBER.pack_into(block.buf, NUMBER_AT, number)
            return {"block": block.name, "process": os.getpid(), "arrays": listed}

    def close(self) -> None:
        """Release all blocks."""
        with self._lock:
            self._closed = True
            for block in self._blocks.values():
                _free(block)
            self._blocks.clear()

    def _block(self, key: tuple[int, int], size: int) -> SharedMemory | None:
        block = self._blocks.get(key)
        if block is None or block.size < size:
            if LINUX.is_dir() and shutil.disk_usage(LINUX).free < 2 * size:
                return None
            if block is not None:
                _free(block)
            block = self._blocks[key] = SharedMemory(f"luxloop_{secrets.token_hex(8)}", create=True, size=size)
        return block


def _free(block: SharedMemory) -> None:
    block.close()
    with suppress(FileNotFoundError):
        block.unlink()


class BlockReader:
    """Reader of a studio's shared memory."""

    def __init__(self) -> None:
        self._blocks = dict[str, SharedMemory]()

    def arrays(self, told: Mapping[str, Any], number: int) -> dict[str, np.ndarray] | None:
        """Copies of a step's arrays, None if they are overwritten. told: `shared` of the message. number: its `id`.

        Raises LuxloopError if this machine has no such block.
        """
        try:
            block = self._block(told["block"], told["process"])
        except FileNotFoundError:
            if self._blocks:  # replaced by a newer block
                return None
            raise LuxloopError("the studio's memory is not on this machine; connect with shared=False") from None
        assert block.buf is not None
        magic, version, head_bytes, written, _ = HEAD.unpack_from(block.buf)
        if (magic, version, head_bytes) != (MAGIC, VERSION, ALIGNED):
            raise LuxloopError("the studio's memory has another form; use the same version of luxloop here and there")
        found = {
            name: np.ndarray(each["shape"], f"<{each['dtype']}", block.buf, each["start"]).copy() for name, each in told["arrays"].items()
        }
        return found if written == number == NUMBER.unpack_from(block.buf, NUMBER_AT)[0] else None

    def close(self) -> None:
        """Close all blocks."""
        for block in self._blocks.values():
            block.close()

    def _block(self, name: str, process: int) -> SharedMemory:
        if name not in self._blocks:
            self._blocks[name] = SharedMemory(name)
            if os.name == "posix" and process != os.getpid():  # the studio releases it
                resource_tracker.unregister(f"/{name}", "shared_memory")
        return self._blocks[name]
