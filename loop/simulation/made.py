"""What a simulation is made of, part by part, so that the next one takes over what has stayed as it was."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel

Part = TypeVar("Part")


class Made:
    """Parts by name, each with its ingredients. Those of the simulation before serve again where their ingredients are the same."""

    def __init__(self, before: "Made | None" = None) -> None:
        self._parts: dict[str, tuple[Any, Any]] = {}
        self._before: Mapping[str, tuple[Any, Any]] = {} if before is None else before._parts

    def __call__(self, name: str, ingredients: Any, make: Callable[[], Part]) -> Part:
        """The part of a name. ingredients: all that `make` uses: parameters, which are compared, and objects, which are the same or not."""
        known = self._before.get(name)
        part: Part = known[1] if known is not None and same(known[0], ingredients) else make()
        self._parts[name] = ingredients, part
        return part

    def before(self, name: str, default: Part) -> Part:
        """The part as it was in the simulation before."""
        known = self._before.get(name)
        return default if known is None else known[1]

    def without(self, name: str) -> "Made":
        """The same parts but one."""
        left = Made()
        left._parts = {each: part for each, part in self._parts.items() if each != name}
        return left

    def going_on(self) -> "Made":
        """The same parts, of which some are then replaced."""
        after = Made(self)
        after._parts = dict(self._parts)
        return after

    def end(self) -> None:
        """All is made: let go what no longer serves."""
        self._before = {}


def same(a: Any, b: Any) -> bool:
    """Whether both are the same ingredients: equal parameters, or one object."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    return isinstance(a, BaseModel | str | int | float) and bool(a == b)
