"""Methods whose last results are kept."""

from collections.abc import Callable
from functools import lru_cache
from typing import ParamSpec, TypeVar, cast
from weakref import WeakMethod

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def keeping(most: int, method: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A bound method with its last `most` results, to be kept by its object, whose other methods call it. Arguments must be hashable.

    Unlike `lru_cache` of the bound method it holds no reference to the object, whose memory, often hundreds of megabytes, is so free as
    soon as nobody uses it, and not at some later collection of cycles.
    """
    of_object = WeakMethod(method)

    @lru_cache(most)
    def kept(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        living = of_object()
        assert living is not None, "the object that keeps this calls it"
        return living(*arguments, **named)

    return cast(Callable[Arguments, Result], kept)
