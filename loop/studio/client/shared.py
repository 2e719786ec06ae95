"""Arrays that a studio on this machine leaves in shared memory (docs/programs.md)."""

import os
from collections.abc import Mapping
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np

from luxloop.loop.studio.shared import ALIGNED, HEAD, MAGIC, NUMBER, NUMBER_AT, VERSION
from luxloop.world.errors import LuxloopError


class Mapped:
    """The blocks of a studio that this program has read."""

    def __init__(self) -> None:
        self._blocks = dict[str, SharedMemory]()

    def arrays(self, told: Mapping[str, Any], number: int) -> dict[str, np.ndarray] | None:
        """Copies of a step's arrays, None where another step's lie there by now. told: `shared` of its message. number: its `id`.

        Raises LuxloopError where there is no such block on this machine.
        """
        try:
            block = self._block(told["block"], told["process"])
        except FileNotFoundError:
            if self._blocks:  # its studio has made another one since
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
        """Let go of all blocks."""
        for block in self._blocks.values():
            block.close()

    def _block(self, name: str, process: int) -> SharedMemory:
        if name not in self._blocks:
            self._blocks[name] = SharedMemory(name)
            if os.name == "posix" and process != os.getpid():  # it is the studio that gives it back
                resource_tracker.unregister(f"/{name}", "shared_memory")
        return self._blocks[name]
