"""Tables, to the terminal and to Markdown, and the values that stand in them."""

import json
import math
import sys
from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import Console, JustifyMethod
from rich.markup import escape
from rich.table import Table

WIDE = 160  # columns where there is no terminal to fit into
JUSTIFY: Mapping[str, JustifyMethod] = {"l": "left", "r": "right"}
RULES = {"l": "---", "r": "---:"}
Rows = Iterable[Iterable[object]]


def console(stderr: bool = False) -> Console:
    """A console as wide as the terminal, or wide enough not to break lines in files and pipes."""
    stream = sys.stderr if stderr else sys.stdout
    return Console(stderr=stderr, highlight=False, width=None if stream.isatty() else WIDE)


def say(text: str, stderr: bool = False) -> None:
    """Print a text as it is, on lines as wide as the terminal."""
    console(stderr).print(text, markup=False)


def show(table: Table) -> None:
    """Print a table."""
    console().print(table)


def show_json(value: Any) -> None:
    """Print what a program reads."""
    print(json.dumps(value, indent=2, ensure_ascii=False))


def plain(columns: Iterable[str], rows: Rows = (), align: str = "l", *, title: str | None = None, caption: str | None = None) -> Table:
    """A table without lines for the terminal; all of its texts may have markup.

    align: l or r for each column, the last for all that follow.
    """
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim", title=title, caption=caption)
    table.title_justify = table.caption_justify = "left"
    names = list(columns)
    for name, side in zip(names, align.ljust(len(names), align[-1]), strict=True):
        table.add_column(name, overflow="fold", justify=JUSTIFY[side])
    for row in rows:
        table.add_row(*map(str, row))
    return table


def facts(rows: Mapping[str, str]) -> Table:
    """A table of what is known of one thing, by name."""
    table = plain(("", ""), ((f"[bold]{escape(name)}[/]", escape(value)) for name, value in rows.items()))
    table.show_header = False
    return table


def markdown_table(columns: Iterable[str], rows: Rows, align: str = "lr") -> str:
    """A table as Markdown; align as of `plain`."""
    names = list(columns)
    rules = (RULES[side] for side in align.ljust(len(names), align[-1]))
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in (names, rules, *rows))


def plural(count: int, noun: str) -> str:
    """A number of things, such as "1 object" and "2 objects"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def number(value: float | None, form: str = "g", unit: str = "") -> str:
    """A number in a form such as `.2f`; a dash where there is none."""
    return "–" if value is None or math.isnan(value) else f"{value:{form}}{unit}"
