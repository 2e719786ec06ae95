"""Parts of the user's own, which a scenario names by `package.module:Name`."""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from inspect import Parameter, signature
from typing import Any, Final

from pydantic import Discriminator, ValidationError

from world.errors import LuxloopError, did_you_mean

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

    key: that of the scenario which names it; `options` stands beside it. Raises what `load` does, and LuxloopError where an option is not
    one that it takes or is missing, it cannot be made, or lacks a method.
    """
    where, table = f"{key}: {name}", f"{key.rpartition('.')[0]}.options"
    made_by = load(name, key)
    _fitting(made_by, name, table, tuple(given.values()), options)
    try:
        made = made_by(*given.values(), **options)
    except Exception as error:
        what = " and ".join([*(f"the {each}" for each in given), table])
        raise LuxloopError(f"{where}: cannot be made with {what} ({in_a_line(error)})") from error
    missing = [method for method in methods if not callable(getattr(made, method, None))]
    if missing:
        raise LuxloopError(f"{where}: has no method {missing[0]}; it needs {', '.join(methods)}")
    return made


def _fitting(made_by: Callable[..., Any], name: str, table: str, given: Sequence[Any], options: Mapping[str, Any]) -> None:
    """Raises LuxloopError where options are not what `Name` takes beside what it is given, as far as it tells what that is."""
    try:
        takes = signature(made_by)
        filled = takes.bind_partial(*given).arguments
    except (TypeError, ValueError):
        return
    left = [each for key, each in takes.parameters.items() if key not in filled]
    if any(each.kind == Parameter.VAR_KEYWORD for each in left):
        return
    known = [each.name for each in left if each.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)]
    if strange := [key for key in options if key not in known]:
        remedy = did_you_mean(strange[0], known) if known else "leave it out, for it takes none"
        raise LuxloopError(f"{table}.{strange[0]}: {name} has no option of this name; {remedy}")
    if lacking := [each.name for each in left if each.default is Parameter.empty and each.name in known and each.name not in options]:
        raise LuxloopError(f"{table}.{lacking[0]}: is missing, and {name} has no default for it; add it")


def in_a_line(error: Exception) -> str:
    """What went wrong, for the end of a sentence."""
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    return " ".join(f"{type(error).__name__}: {error}".split())
