"""The error for users' mistakes, which the command line shows as a sentence with exit code 2, and helpers for its wording."""

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final

LONGEST_WORD: Final = 200  # characters; longer words are input
LONGEST_SENTENCE: Final = 1000
HIDDEN: Final = "***"  # in place of a login
LOGINS: Final = re.compile(
    r"(?<=://)\S{0,500}(?=@)|(?<=[?&])(\w{0,40}(?:pass|pwd|token|secret|auth|key)\w{0,40}=)[^&\s'\"]+", re.I
)  # in addresses
SECRETS: Final = re.compile(r"pass|pwd|token|secret|auth|header|cookie|credential|api_?key", re.I)  # keys of such values
MOST_ERRORS: Final = 10  # of a file that are listed

NEAR = 0.7  # share of letters, in order, that two similar names have in common
BEGINNING = 3  # first letters by which a name is recognised


class LuxloopError(ValueError):
    """Bad input; the message is one sentence that names the file, the key or line, and the remedy, or, for several errors, their file and
    number and then a line each. Long input in it is cut short, its control characters are question marks, and logins in addresses are
    hidden."""

    def __init__(self, *sentences: str) -> None:
        super().__init__(*map(_line, sentences))

    def __str__(self) -> str:
        return "\n  ".join(self.args)


def all_of(sentences: Sequence[str]) -> LuxloopError:
    """The error of a sentence, or of several: their number, and a line each for the first ten."""
    if len(sentences) == 1:
        return LuxloopError(sentences[0])
    left_out = len(sentences) - MOST_ERRORS
    return LuxloopError(f"{len(sentences)} errors", *sentences[:MOST_ERRORS], *([f"and {left_out} more"] if left_out > 0 else []))


def _line(sentence: str) -> str:
    shown = re.sub(r"[\0-\x1f\x7f-\x9f]", "?", re.sub(r"[\t-\r]+", " ", redact(sentence)))  # input must not control the terminal
    words = re.sub(rf"\S{{{LONGEST_WORD},}}", lambda word: _short(word[0], LONGEST_WORD), shown)
    return _short(words, LONGEST_SENTENCE)


def _short(text: str, longest: int) -> str:
    """Both ends of a long text, since a path or sentence begins with the place and ends with its subject."""
    half = (longest - 3) // 2
    return text if len(text) <= longest else f"{text[:half]}...{text[-half:]}"


def redact(value: Any) -> Any:
    """Plain data without logins: those in addresses of texts, and texts under keys such as `password` or `headers`."""
    if isinstance(value, str):
        return LOGINS.sub(lambda found: f"{found[1] or ''}{HIDDEN}", value)
    if isinstance(value, Mapping):
        return {key: HIDDEN if isinstance(each, str) and SECRETS.search(key) else redact(each) for key, each in value.items()}
    return [redact(each) for each in value] if isinstance(value, list | tuple) else value


@contextmanager
def locate(place: str) -> Iterator[None]:
    """Put a place, such as a file or key, before every LuxloopError of a block."""
    try:
        yield
    except LuxloopError as error:
        first, *others = error.args
        raise LuxloopError(f"{place}: {first}", *others) from error


def did_you_mean(given: str, known: Iterable[str], otherwise: str = "") -> str:
    """The known name that is near the given one, else `otherwise`, by default all known names."""
    names = list(known)
    meant = near(given, names)
    return f"did you mean {meant!r}?" if meant else otherwise or f"known are {', '.join(names)}"


def near(given: str, known: Iterable[str]) -> str | None:
    """The known name that is near the given one, None where there is none. One wrong letter is always near, and so are three at the
    beginning of the name.
    """
    names = {name.lower(): name for name in known}
    letters = max(len(given), 2)
    found = difflib.get_close_matches(given.lower(), names, 1, min(NEAR, (letters - 1) / letters))
    begun = [name for name in names if len(given) >= BEGINNING and name.startswith(given.lower())]
    return names[found[0] if found else min(begun, key=len)] if found or begun else None
