"""Memory budget for sizes that files declare, checked before allocation.

A few bytes can declare any size: an array's header, a picture, a lamp, a camera's resolution. One budget limits all of them.
"""

from typing import Final

from luxloop.world.errors import LuxloopError

BUDGET_BYTES: Final = 3_000_000_000  # enough for a camera of 1920 x 1080 px at 4 samples, and fits on a machine with 8 GB


def afford(what: str, n_bytes: float, remedy: str) -> None:
    """Raises LuxloopError with the remedy if `what`, the begin of the message, needs more memory than the budget."""
    if n_bytes > BUDGET_BYTES:
        needed = min(n_bytes, 1e18) / 1e9  # a declared number may have more digits than a float
        budget = f"more than the budget of {BUDGET_BYTES / 1e9:g} GB"
        raise LuxloopError(f"{what} would take at least {needed:,.3g} GB of memory, {budget}; {remedy}")
