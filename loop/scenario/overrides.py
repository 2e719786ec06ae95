"""Overrides: other values for a scenario's keys, from `--set`, files or tables, merged into its plain data."""

import copy
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from luxloop.world import plugin
from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.validation import parsed_toml, read_toml

Override = str | Mapping[str, Any]
FUNCTIONS = ("", "functions.*.")  # tables of controllers: an argument of `load`, and those of functions
FILES = (  # keys of paths; * is any name, and a key of a list is that of all its items
    *("road.file", "headlight.model", "plant.folder", "detector.file", "detector.weights", "objects.file", "objects.*.file"),
    *("functions.image", "functions.*.image", "lighting.raw.file", "lighting.raw.*.file"),
    *(f"{function}controller.road.file" for function in FUNCTIONS),
)
CLASSES = (  # keys that may name the user's own class
    *("road.kind", "detector.kind", "tracker.kind", "plant.kind", "functions.*.kind", "pixel_controller"),
    *(f"{function}{key}" for function in FUNCTIONS for key in ("controller.road.kind", "controller.name", "controller", "extraction.kind")),
)
INDEX = re.compile(r"\[(\d+)\]")  # of a list's item, as in --set objects[0].albedo=0.5
CLEARED: Final = object()  # in place of a value that returns to its default
TAGS = ("kind", "name")  # keys that name the variant of a table; the first one present counts


def overridden(data: Mapping[str, Any], overrides: Sequence[Override]) -> dict[str, Any]:
    """Plain data of a scenario with overrides, of which later ones win. Raises LuxloopError for an invalid override.

    Variants of tables are chosen first, so that an override of a key may precede the override of its table's variant.
    """
    nested = [tables(override) for override in overrides]
    changed = copy.deepcopy(dict(data))
    for changes in map(_variants, nested):
        _merge(changed, changes)
    for changes in nested:
        _refuse_misspelt(changed.get("functions"), changes.get("functions"))
        _merge(changed, changes)
    return _clear(changed)


def _refuse_misspelt(functions: Any, changes: Any) -> None:
    """Raises LuxloopError for a new function without a kind, which is another one's name misspelt."""
    if isinstance(functions, dict) and isinstance(changes, dict):
        for name, table in changes.items():
            if name not in functions and isinstance(table, dict) and "kind" not in table:
                known = did_you_mean(name, functions)
                raise LuxloopError(f"functions.{name}: there is no function {name!r}; {known}; a new one needs a kind")


def _clear(data: Any) -> Any:
    """Plain data without cleared values."""
    if isinstance(data, dict):
        return {key: _clear(value) for key, value in data.items() if value is not CLEARED}
    return [_clear(value) for value in data if value is not CLEARED] if isinstance(data, list) else data


def _variants(changes: Mapping[str, Any]) -> dict[str, Any]:
    """The changes that choose variants of tables, except in items of lists, which an earlier change may add."""
    named = ((key, value) for key, value in changes.items() if not INDEX.fullmatch(key))
    chosen = ((key, _variants(value) if isinstance(value, dict) else key in TAGS and value) for key, value in named)
    return {key: value for key, value in chosen if value}


def texts(data: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """All texts in plain data, each after its key."""
    if isinstance(data, str):
        yield key, data
    elif isinstance(data, Mapping | list | tuple):
        items = data.items() if isinstance(data, Mapping) else ((None, each) for each in data)
        for name, each in items:
            yield from texts(each, key if name is None else f"{key}.{name}".lstrip("."))


def toml_key(key: str) -> str:
    """A key in TOML, with indices of lists as keys: `objects[0].albedo` is `objects."[0]".albedo`."""
    return INDEX.sub(r'."[\1]"', key)


def is_file(override: Override) -> bool:
    """Whether an override is the path of a TOML file of keys."""
    return isinstance(override, str) and "=" not in override and Path(override).suffix == ".toml"


def tables(override: Override) -> dict[str, Any]:
    """An override as nested tables with absolute paths. Raises LuxloopError for an invalid override."""
    folder, data = Path.cwd(), override
    if isinstance(data, str):
        folder, data = (Path(data).parent, read_toml(Path(data))) if is_file(data) else (folder, _parse(data))
    data = copy.deepcopy(dict(data))
    resolve_paths(data, folder)
    return data


def _parse(text: str) -> dict[str, Any]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise LuxloopError(f"--set {text}: not of the form key=value; write for example --set camera.bits=8, or name a .toml file of keys")
    key = toml_key(key.strip())
    try:
        with suppress(ValueError):
            return parsed_toml(f"{key} = {value.strip()}")
        return parsed_toml(f"{key} = {json.dumps(value.strip())}")
    except ValueError as error:
        raise LuxloopError(f"--set {text}: not understood ({error}); write for example --set camera.bits=8") from error


def _merge(into: dict[str, Any], changes: Mapping[str, Any], within: str = "") -> None:
    """Merge changes into nested tables; a table of another variant replaces the old one.

    An empty table clears an existing key, and adds a table of defaults under a new key. Changes of list items have the keys "[0]", "[1]"
    and so on; a table under the index after the last is appended. within: key of the table, for messages. Raises LuxloopError where a list
    has no such item.
    """
    for key, value in changes.items():
        old, whole = into.get(key), within + key if INDEX.fullmatch(key) else f"{within}.{key}".strip(".")
        if isinstance(old, list) and isinstance(value, dict) and value and all(INDEX.fullmatch(place) for place in value):
            items = {f"[{k}]": item for k, item in enumerate(old)}
            added = f"[{len(items)}]"
            tables_ = all(isinstance(each, dict) for each in (*old, value.get(added)))
            if strange := [place for place in value if place not in items and not (place == added and value[added] and tables_)]:
                found = f"there are {len(items)} {key}, numbered from 0" if items else f"there are no {key}"
                raise LuxloopError(f"{whole}{strange[0]}: {found}; change another, or set all of {whole}")
            _merge(items, value, whole)
            into[key] = list(items.values())
        elif value == {} and key in into:
            into[key] = CLEARED
        elif isinstance(old, list) and isinstance(value, dict):
            raise LuxloopError(
                f"{whole}: is a list and has no {next(iter(value))!r}; write --set '{whole}[0].KEY=VALUE' for its first, "
                f"--set '{whole}=[...]' for all of it, or change a copy, `luxloop new FILE --like NAME`"
            )
        elif isinstance(old, dict) and isinstance(value, dict) and _same_variant(old, value):
            _merge(old, value, whole)
        else:
            into[key] = value


def _same_variant(table: Mapping[str, Any], changes: Mapping[str, Any]) -> bool:
    tags = [tag for tag in TAGS if isinstance(table.get(tag), str)][:1]  # a function may be named "kind" or "name"
    return all(tag not in changes or changes[tag] == table[tag] for tag in tags)


def resolve_paths(data: dict[str, Any], folder: Path) -> None:
    """Make paths absolute relative to a file's folder, also those of modules in the folder; names of shipped and registered files stay."""
    for table, key in _places(data, FILES):
        if key == "folder" or any(mark in table[key] for mark in "/\\."):
            table[key] = str((folder / table[key]).resolve())
    for table, key in _places(data, CLASSES):
        table[key] = plugin.beside(table[key], folder)


def _places(data: Any, keys: Iterable[str]) -> list[tuple[dict[str, Any], str]]:
    """Tables that have a text under one of the keys, each with the last part of the key."""
    found = []
    for key in keys:
        *path, last = key.split(".")
        tables = [data]
        for part in path:
            inner = [each for table in tables if isinstance(table, dict) for each in (table.values() if part == "*" else [table.get(part)])]
            tables = [each for one in inner for each in (one if isinstance(one, list) else [one])]
        found += [(table, last) for table in tables if isinstance(table, dict) and isinstance(table.get(last), str)]
    return found
