"""The one error that users cause, which the command line turns into a sentence and exit code 2, and what helps to word it."""

import difflib
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Final

LONGEST_WORD: Final = 200  # characters: what is longer is input
LONGEST_MESSAGE: Final = 1000

NEAR = 0.7  # share of the letters that two near names have in common, in the same order


class LuxloopError(ValueError):
    """Bad input; the message is one sentence that names the file, the key or line, and the remedy. Long input in it is cut short, and its
    control characters are question marks."""

    def __init__(self, message: str) -> None:
        shown = re.sub(r"[\0-\x08\x0e-\x1f\x7f-\x9f]", "?", message)  # input must not control the terminal
        words = re.sub(rf"\S{{{LONGEST_WORD},}}", lambda word: _short(word[0], LONGEST_WORD), shown)
        super().__init__(_short(words, LONGEST_MESSAGE))


def _short(text: str, longest: int) -> str:
    """Both ends of a text, since a path or a sentence begins with the place and ends with what it is about."""
    half = (longest - 3) // 2
    return text if len(text) <= longest else f"{text[:half]}...{text[-half:]}"


@contextmanager
def located(place: str) -> Iterator[None]:
    """Say before every LuxloopError of a block where it lies: a file, a key."""
    try:
        yield
    except LuxloopError as error:
        raise LuxloopError(f"{place}: {error}") from error


def did_you_mean(given: str, known: Iterable[str], otherwise: str = "") -> str:
    """The known name that is near the given one, else `otherwise`, by default all known names. One wrong letter is always near."""
    names = {name.lower(): name for name in known}
    letters = max(len(given), 2)
    near = difflib.get_close_matches(given.lower(), names, 1, min(NEAR, (letters - 1) / letters))
    return f"did you mean {names[near[0]]!r}?" if near else otherwise or f"known are {', '.join(names.values())}"
