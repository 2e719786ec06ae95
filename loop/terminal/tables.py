"""The tables that the command line shows."""

import json
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from loop.scenario import data
from loop.terminal.listing import USES, Kind

if TYPE_CHECKING:  # these import torch
    from loop.recording.comparison import Difference
    from loop.terminal.doctor import Check

WIDE = 160  # columns where there is no terminal to fit into
COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}


def console(stderr: bool = False) -> Console:
    """A console as wide as the terminal, or wide enough not to break lines in files and pipes."""
    stream = sys.stderr if stderr else sys.stdout
    return Console(stderr=stderr, highlight=False, width=None if stream.isatty() else WIDE)


def show(table: Table) -> None:
    """Print a table."""
    console().print(table)


def show_json(value: Any) -> None:
    """Print what a program reads."""
    print(json.dumps(value, indent=2, ensure_ascii=False))


def listed(kind: Kind, found: Sequence[dict[str, Any]]) -> Table:
    """What `loop.terminal.listing` found of a kind."""
    scenarios = kind == "scenarios"
    table = plain(kind.removesuffix("s"), *(["controller or functions"] if scenarios else []), "what it is")
    table.caption, table.caption_justify = escape(USES[kind]), "left"
    for row in found:
        remedy = f"\n[yellow]needs {row['lacks']}: luxloop data get {row['lacks']}[/]" if row.get("lacks") else ""
        uses = [", ".join(row["uses"])] if scenarios else []
        table.add_row(f"[bold]{row['name']}[/]", *uses, escape(row["description"]) + remedy)
    return table


def data_files() -> Table:
    """Registered third-party files."""
    table = plain("name", "kind", "MB", "licence", "what it is", "where it is")
    table.caption, table.caption_justify = "Get one with `luxloop data get NAME`, all with `luxloop data get all`.", "left"
    for row in data.rows():
        where = escape(str(row.path)) if row.path else "[yellow]not here[/]"
        table.add_row(f"[bold]{row.name}[/]", row.kind, f"{row.bytes / 1e6:.1f}", escape(row.licence), escape(row.description), where)
    return table


def findings(checks: "Sequence[Check]") -> Table:
    """What the doctor found."""
    table = plain("", "what", "found", "mend it with")
    for check in checks:
        table.add_row(f"[{COLOURS[check.status]}]{check.status}[/]", escape(check.name), escape(check.found), escape(check.remedy))
    return table


def summary(values: dict[str, Any], files: str) -> Table:
    """The closing table of a run."""
    from loop.recording.remedies import remedies

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    x, y = values["centroid_error_percent"]
    settled = values["settle_step"]
    rows = {
        "settle step": f"{settled} of {values['steps']}" if settled is not None else "not settled",
        "centroid error": f"{_number(x, '.2f')} % along, {_number(y, '.2f')} % across",
        "IoU, open loop → final": f"{_number(values['iou_open'], '.3f')} → {_number(values['iou_final'], '.3f')}",
        "overshoot": f"{_number(values['overshoot_percent'], '.1f')} %" if values["overshoot_percent"] is not None else "–",
        "lost steps": str(values["lost_steps"]),
        "time a step": f"{_number(values['step_ms_median'], '.1f')} ms (median)",
        "files": files,
    }
    if notes := remedies(values):
        rows["note"] = "\n".join(notes)
    for label, value in rows.items():
        table.add_row(f"[bold]{label}[/]", escape(value))
    return table


def differences(found: "Sequence[Difference]") -> Table:
    """What a replay has otherwise than its recording."""
    table = plain("column", "first at step", "recorded", "replayed", "largest difference", "at step", "tolerance")
    for d in found:
        values = (d.first_step, d.recorded, d.replayed, d.largest, d.largest_step, d.tolerance)
        table.add_row(f"[bold]{d.column}[/]", *(f"{value:.6g}" if isinstance(value, float) else escape(str(value)) for value in values))
    return table


def plain(*columns: str) -> Table:
    """A table without lines, with these columns."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)
