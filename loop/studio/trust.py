"""What a client may change over the socket: values, not code and not files, unless the server was started with `--allow-code`."""

import re
from collections.abc import Sequence

from loop.scenario.overrides import is_file, tables, texts
from world.errors import LuxloopError
from world.plugin import PATTERN


def refuse_foreign(overrides: Sequence[str]) -> None:
    """Raises LuxloopError where an override names a file, a module of Python or a plant, which the server's machine would open."""
    for override in overrides:
        if is_file(override):
            raise LuxloopError(f"{override}: the page cannot name a file; give its keys, or start luxloop studio with --allow-code")
        given = tables(override)
        if "plant" in given:
            raise LuxloopError(f"{override}: a plant cannot be chosen from the page; start luxloop studio with --allow-code")
        for text in texts(given):
            if re.fullmatch(PATTERN, text) or any(mark in text for mark in "/\\."):
                raise LuxloopError(f"{override}: names a file or a module of Python; start luxloop studio with --allow-code for that")
