"""Processes that cannot simulate, and would hang or crash instead."""

import os
import resource
from functools import cache
from typing import Final

from luxloop.world.errors import LuxloopError

LEAST_ADDRESSES: Final = 6_000_000_000  # bytes of address space, of which torch, embree and OpenGL use little


@cache
def _first_process() -> int:
    return os.getpid()


def check_process() -> None:
    """Raises LuxloopError in a fork of a process that has called this, as threads of torch, embree and OpenGL do not outlive a fork, and
    where `ulimit -v` leaves too few addresses."""
    if _first_process() != os.getpid():
        remedy = "start workers by 'spawn' or 'forkserver', such as AsyncVectorEnv(..., context='spawn')"
        raise LuxloopError(f"this process was forked from one that had simulated, and would wait for threads that it lacks; {remedy}")
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if 0 <= limit < LEAST_ADDRESSES:
        remedy = f"give `ulimit -v {LEAST_ADDRESSES // 1000}` or more; a limit on memory does no harm"
        raise LuxloopError(f"this process may have {limit / 1e9:.3g} GB of addresses, which is too little to simulate; {remedy}")
