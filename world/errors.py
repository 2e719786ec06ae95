"""The one error that users cause: the command line turns it into a sentence and exit code 2."""

from collections.abc import Iterator
from contextlib import contextmanager


class LuxloopError(ValueError):
    """Bad input; the message is one sentence that names the file, the key or line, and the remedy."""


@contextmanager
def located(place: str) -> Iterator[None]:
    """Say before every LuxloopError of a block where it lies: a file, a key."""
    try:
        yield
    except LuxloopError as error:
        raise LuxloopError(f"{place}: {error}") from error
