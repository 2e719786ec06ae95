"""What sockets raise for an address that a user gave: a name that is none, a port that is taken or too large."""

from typing import Final

REFUSED: Final = (OSError, OverflowError, UnicodeError, TypeError)


def reason_of(error: BaseException) -> str:
    """The reason in words."""
    return str(getattr(error, "strerror", None) or error)
