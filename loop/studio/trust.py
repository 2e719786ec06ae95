"""What a client may change over the socket: values, not code and not files, unless the server was started with `--allow-code`."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from luxloop.loop.scenario import data
from luxloop.loop.scenario.overrides import is_file, tables
from luxloop.loop.scenario.shipped import shipped_files
from luxloop.world.errors import LuxloopError
from luxloop.world.lamps.presets import SUMMARIES
from luxloop.world.plugin import PATTERN

FILES: Final = ("file", "folder", "image", "model", "weights")  # keys that may name one


def refuse_foreign(overrides: Sequence[str]) -> None:
    """Raises LuxloopError where an override names a file that is not shipped, a module of Python or a plant: the server would open it."""
    shipped = {*shipped_files("symbols"), *shipped_files("utilisations"), *data.registry(), *SUMMARIES}
    for override in overrides:
        if is_file(override):
            raise LuxloopError(f"{override}: the page cannot name a file; give its keys, or start luxloop studio with --allow-code")
        for key, text in _texts(tables(override)):
            if key.startswith("plant"):
                raise LuxloopError(f"{override}: a plant cannot be chosen from the page; start luxloop studio with --allow-code")
            if re.fullmatch(PATTERN, text):
                raise LuxloopError(f"{override}: names a module of Python; start luxloop studio with --allow-code for that")
            if key.rpartition(".")[2] in FILES and text not in shipped:
                raise LuxloopError(f"{override}: names a file that is not shipped; start luxloop studio with --allow-code for that")


def _texts(values: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """All texts in plain data, with the keys that they stand at."""
    if isinstance(values, str):
        yield key, values
    elif isinstance(values, Mapping):
        for name, each in values.items():
            yield from _texts(each, f"{key}.{name}".lstrip("."))
    elif isinstance(values, list | tuple):
        for each in values:
            yield from _texts(each, key)
