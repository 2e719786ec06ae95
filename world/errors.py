"""The one error that users cause, which the command line turns into a sentence and exit code 2, and what helps to word it."""

import difflib
from collections.abc import Iterable, Iterator
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


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """The nearest of the known names, or all of them."""
    known = list(known)
    nearest = difflib.get_close_matches(given, known, 1, 0.5)
    return f"did you mean {nearest[0]!r}?" if nearest else f"known are {', '.join(known)}"
