"""A progress bar on stderr where somebody looks at it, else a line now and then."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from loop import tables

LINE_S = 30.0  # between two lines at least


@contextmanager
def progress(title: str, total: int, done: int = 0) -> Iterator[Callable[[], None]]:
    """Call what it gives after every step; `done` of the total are done already."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = tables.console(stderr=True)
    start = told = time.monotonic()
    if done and not console.is_terminal:
        console.print(f"{title}: {done} of {total} done before", markup=False)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=total, completed=done)

        def advance() -> None:
            nonlocal done, told
            done += 1
            bar.advance(task)
            now = time.monotonic()
            if not console.is_terminal and now - told >= LINE_S:
                told = now
                console.print(f"{title}: {done} of {total} done after {now - start:.0f} s", markup=False)

        yield advance
