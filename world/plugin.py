"""Parts of the user's own, which a scenario names by `package.module:Name`."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, Final

from pydantic import Discriminator, ValidationError

from world.errors import LuxloopError

OWN: Final = "package.module:Name"
PATTERN: Final = r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*$"


def known_or_own(key: str, default: str | None = None) -> Discriminator:
    """Tells the variants of a table apart by a key of it; all of `package.module:Name` are one, with the tag `OWN`."""

    def tag(table: Any) -> Any:
        given = table.get(key, default) if isinstance(table, dict) else getattr(table, key, None)
        return OWN if isinstance(given, str) and ":" in given else given

    tag.__name__ = key  # which is what an error calls it
    return Discriminator(tag)


def load(name: str, key: str) -> Any:
    """What `package.module:Name` means; key: that of the scenario which names it, for messages.

    Raises LuxloopError where there is no such module, it fails while it is imported, or it has no such name.
    """
    where = f"{key}: {name}"
    module_name, _, attribute = name.partition(":")
    try:
        module = import_module(module_name)
    except ImportError as error:
        raise LuxloopError(f"{where}: {error}; run where Python finds it, or set PYTHONPATH to its folder") from error
    except Exception as error:
        raise LuxloopError(f"{where}: {module_name} fails while it is imported ({in_a_line(error)}); mend it") from error
    try:
        return getattr(module, attribute)
    except AttributeError as error:
        raise LuxloopError(f"{where}: module {module_name} has no {attribute}; name a class or a function of it") from error


def make(name: str, key: str, given: Mapping[str, Any], options: Mapping[str, Any], methods: Sequence[str]) -> Any:
    """`Name(*given, **options)`, which must have all of the methods; given: what luxloop hands over, by what messages call it.

    key: that of the scenario which names it; `options` stands beside it. Raises what `load` does, and LuxloopError where it does not take
    what it is given, or lacks a method.
    """
    where, table = f"{key}: {name}", key.rpartition(".")[0]
    made_by = load(name, key)
    try:
        made = made_by(*given.values(), **options)
    except Exception as error:
        what = " and ".join([*(f"the {each}" for each in given), f"{table}.options"])
        raise LuxloopError(f"{where}: cannot be made with {what} ({in_a_line(error)})") from error
    missing = [method for method in methods if not callable(getattr(made, method, None))]
    if missing:
        raise LuxloopError(f"{where}: has no method {missing[0]}; it needs {', '.join(methods)}")
    return made


def in_a_line(error: Exception) -> str:
    """What went wrong, for the end of a sentence."""
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    return " ".join(f"{type(error).__name__}: {error}".split())
