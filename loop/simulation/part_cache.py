"""Cache of a simulation's parts: a simulation built after an edit reuses parts with unchanged inputs."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel

Part = TypeVar("Part")


class PartCache:
    """Parts by name, each with its key: the arguments that made it. before: cache of the simulation before the edit."""

    def __init__(self, before: "PartCache | None" = None) -> None:
        self._parts: dict[str, tuple[Any, Any]] = {}
        self._before: Mapping[str, tuple[Any, Any]] = {} if before is None else before._parts

    def __call__(self, name: str, make: Callable[..., Part], *key: Any) -> Part:
        """The part `make(*key)`, reused from before if its key is the same (see `same`)."""
        known = self._before.get(name)
        part: Part = known[1] if known is not None and same(known[0], key) else make(*key)
        self._parts[name] = key, part
        return part

    def before(self, name: str, default: Part) -> Part:
        """The part of a name before the edit, or default."""
        known = self._before.get(name)
        return default if known is None else known[1]

    def copy(self, *but: str) -> "PartCache":
        """A cache of the same parts except the named ones."""
        after = PartCache(self)
        after._parts = {name: part for name, part in self._parts.items() if name not in but}
        return after

    def end(self) -> None:
        """Release the parts of before."""
        self._before = {}


def same(a: Any, b: Any) -> bool:
    """Whether two keys are the same: equal parameters and plain values, or the same object."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    return isinstance(a, BaseModel | str | int | float) and bool(a == b)
