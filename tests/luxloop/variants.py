"""Classes that break a contract in one method, and what is said of them."""

from collections.abc import Callable
from typing import Any

import pytest

from luxloop import LuxloopError


def variant(base: type, name: str, **methods: Any) -> type:
    """A class like another one but for some methods, as if it were written beside it."""
    return type(name, (base,), {"__module__": base.__module__, **methods})


def assert_refused(check: Callable[[type], None], broken: type, key: str, words: list[str]) -> None:
    """One sentence names the key, the class and the words."""
    with pytest.raises(LuxloopError) as caught:
        check(broken)
    (sentence,) = caught.value.args
    assert f"{key}: {broken.__module__}:{broken.__name__}: " in sentence
    assert all(each in sentence for each in words), sentence
