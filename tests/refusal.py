"""What a test expects of bad input."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from luxloop.world.errors import LuxloopError


def refusal(match: str) -> "pytest.RaisesExc[LuxloopError]":
    """A block that ends with a LuxloopError whose text the regular expression finds."""
    return pytest.raises(LuxloopError, match=match)


@contextmanager
def sentence(*words: str) -> Iterator[None]:
    """A block that ends with a LuxloopError of one line that has all words."""
    with pytest.raises(LuxloopError) as error:
        yield
    message = str(error.value)
    assert all(word in message for word in words) and "\n" not in message, message
