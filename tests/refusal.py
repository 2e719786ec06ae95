"""What a test expects of bad input."""

import pytest

from luxloop.world.errors import LuxloopError


def refusal(match: str) -> "pytest.RaisesExc[LuxloopError]":
    """A block that ends with a LuxloopError whose text the regular expression finds."""
    return pytest.raises(LuxloopError, match=match)
