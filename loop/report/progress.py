"""A progress bar on stderr where somebody looks at it, else a line now and then."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from luxloop.loop.report import terminal as tables

LINE_S = 30.0  # between two lines at least


class Advance(Protocol):
    """Called after every step, or with no steps to show what goes on now."""

    def __call__(self, steps: int = 1, now: str | None = None) -> None: ...


@contextmanager
def progress(title: str, total: int, done: int = 0) -> Iterator[Advance]:
    """Call what it gives after every step; `done` of the total are done already."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = tables.console(stderr=True)
    start, before = time.monotonic(), done
    shown_s = start
    if done and not console.is_terminal:
        console.print(f"{title}: {done} of {total} already done", markup=False)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=total, completed=done)

        def advance(steps: int = 1, now: str | None = None) -> None:
            nonlocal done, shown_s
            done += steps
            bar.update(task, advance=steps, description=now or title)
            time_s = time.monotonic()
            if not console.is_terminal and time_s - shown_s >= LINE_S:
                shown_s = time_s
                left = (total - done) / max(done - before, 1) * (time_s - start)
                console.print(f"{title}: {done} of {total} done after {time_s - start:.0f} s, about {left:.0f} s left", markup=False)

        yield advance
