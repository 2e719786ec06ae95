"""Tables for the terminal and for Markdown, their values in words, and progress on stderr."""

import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console, JustifyMethod
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

WIDE = 160  # columns without a terminal
JUSTIFY: Mapping[str, JustifyMethod] = {"l": "left", "r": "right"}
RULES = {"l": "---", "r": "---:"}
Rows = Iterable[Iterable[object]]


def console(stderr: bool = False) -> Console:
    """A console as wide as the terminal, or as `WIDE` for files and pipes."""
    stream = sys.stderr if stderr else sys.stdout
    return Console(stderr=stderr, highlight=False, width=None if stream.isatty() else WIDE)


def say(text: str, stderr: bool = False) -> None:
    """Print a text without markup."""
    console(stderr).print(text, markup=False)


def show(table: Table) -> None:
    """Print a table."""
    console().print(table)


def show_json(value: Any) -> None:
    """Print a value as JSON, for programs."""
    print(json.dumps(value, indent=2, ensure_ascii=False))


def plain(columns: Iterable[str], rows: Rows = (), align: str = "l", *, title: str | None = None, caption: str | None = None) -> Table:
    """A table without lines for the terminal; texts may have markup. align: l or r for each column, the last for all further columns."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim", title=title, caption=caption)
    table.title_justify = table.caption_justify = "left"
    names = list(columns)
    for name, side in zip(names, align.ljust(len(names), align[-1]), strict=True):
        table.add_column(name, overflow="fold", justify=JUSTIFY[side])
    for row in rows:
        table.add_row(*map(str, row))
    return table


def facts(rows: Mapping[str, str]) -> Table:
    """A table of names and values."""
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


LINE_S = 30.0  # least time between two lines of progress


@contextmanager
def progress(title: str, total: int, done: int = 0) -> Iterator[Callable[..., None]]:
    """A progress bar, or lines of progress without a terminal. done: steps that are done already.

    Yields `advance(steps=1, now=None)`, to be called after every step; now: description of the current work.
    """
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    stderr = console(stderr=True)
    start, before = time.monotonic(), done
    shown_s = start
    if done and not stderr.is_terminal:
        stderr.print(f"{title}: {done} of {total} already done", markup=False)
    with Progress(*columns, console=stderr, transient=True, disable=not stderr.is_terminal) as bar:
        task = bar.add_task(title, total=total, completed=done)

        def advance(steps: int = 1, now: str | None = None) -> None:
            nonlocal done, shown_s
            done += steps
            bar.update(task, advance=steps, description=now or title)
            time_s = time.monotonic()
            if not stderr.is_terminal and time_s - shown_s >= LINE_S:
                shown_s = time_s
                text = f"{title}: {done} of {total} done after {time_s - start:.0f} s"
                if done > before + 1:  # the first step's time includes the preparation
                    text += f", about {(total - done) / (done - before) * (time_s - start):.0f} s left"
                stderr.print(text, markup=False)

        yield advance
