"""The memory that sizes in a file may ask for, checked before anything of such a size is allocated.

A few bytes can declare any size: a header of an array, a picture or a lamp, a camera's pixels. One budget limits all of them.
"""

from typing import Final

from world.errors import LuxloopError

BUDGET_BYTES: Final = 3_000_000_000  # a camera of 1920 x 1080 px at 4 samples fits, and so does this beside the rest on a machine of 8 GB


def afford(what: str, n_bytes: float, remedy: str) -> None:
    """Raises LuxloopError with the remedy where `what`, named as a message begins, needs more memory than the budget."""
    if n_bytes > BUDGET_BYTES:
        needed = min(n_bytes, 1e18) / 1e9  # a declared number may have more digits than a float
        budget = f"more than the budget of {BUDGET_BYTES / 1e9:g} GB"
        raise LuxloopError(f"{what} would take at least {needed:,.3g} GB of memory, {budget}; {remedy}")
