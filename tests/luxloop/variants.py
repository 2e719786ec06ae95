"""Classes that break a contract in one method, and what is said of them."""

from collections.abc import Callable
from typing import Any

from tests.refusal import sentence


def variant(base: type, **methods: Any) -> type:
    """A class like another one but for some methods, as if it were written beside it."""
    return type("Own", (base,), {"__module__": base.__module__, **methods})


def assert_refused(check: Callable[[type], None], broken: type, key: str, kind: str) -> None:
    """One sentence names the key, the class and the kind of error."""
    with sentence(f"{key}: {broken.__module__}:{broken.__name__}: ", kind):
        check(broken)
