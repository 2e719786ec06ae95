"""The commands list, schema, doctor and data: shipped parts, and the state of this machine."""

from dataclasses import asdict
from pathlib import Path

from cyclopts import App
from rich.markup import escape

from luxloop.loop.commands.options import DIFFERS, OK, Json
from luxloop.loop.report import terminal as tables
from luxloop.loop.scenario import data
from luxloop.loop.scenario.listing import USES, Kind, listing

data_app = App(name="data", help="Measured roads and light distributions from their public sources.")
COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}  # by status of a check


def list_(kind: Kind = "scenarios", /, *, json: Json = False) -> None:
    """List the shipped scenarios, with the data files that they lack, or the parts that a scenario may name.

    Parameters
    ----------
    kind
        What to list.
    json
        Print a JSON list of objects with name and description; scenarios also have uses (controller or kinds of lighting functions) and
        lacks (name of a missing data file, or null).
    """
    found = listing(kind)
    if json:
        tables.show_json(found)
        return
    scenarios = kind == "scenarios"
    columns = (kind.removesuffix("s"), *(["functions and controllers"] if scenarios else []), "description")
    rows = []
    for each in found:
        remedy = f"\n[yellow]needs {each['lacks']}: luxloop data get {each['lacks']}[/]" if each.get("lacks") else ""
        uses = [", ".join(each["uses"])] if scenarios else []
        rows.append([f"[bold]{each['name']}[/]", *uses, escape(each["description"]) + remedy])
    tables.show(tables.plain(columns, rows, caption=escape(USES[kind])))


def schema() -> None:
    """Print the JSON Schema of scenario files, for editors."""
    from luxloop.loop.scenario.model import Scenario

    tables.show_json(Scenario.model_json_schema())


def doctor(*, json: Json = False) -> int:
    """Check this machine for what luxloop needs, and name the remedy for what is missing; exit code 1 if a check failed.

    Parameters
    ----------
    json
        Print a JSON object: ok, and checks, a list of objects with name, status, found and remedy.
    """
    from luxloop.loop.commands.doctor import all_good, checks

    found = checks()
    if json:
        tables.show_json({"ok": all_good(found), "checks": [asdict(check) for check in found]})
    else:
        rows = ((f"[{COLOURS[each.status]}]{each.status}[/]", *map(escape, (each.name, each.found, each.remedy))) for each in found)
        tables.show(tables.plain(("", "what", "found", "remedy"), rows))
    return OK if all_good(found) else DIFFERS


@data_app.command(name="list")
def data_list() -> None:
    """List the data files that can be fetched, and where they are on this machine."""
    rows = (
        (
            f"[bold]{each.name}[/]",
            each.kind,
            f"{each.bytes / 1e6:.1f}",
            escape(each.licence),
            escape(each.description),
            escape(str(path)) if (path := data.present(each.name)) else "[yellow]not here[/]",
        )
        for each in data.registry().values()
    )
    caption = "Get one with `luxloop data get NAME`, all with `luxloop data get all`."
    tables.show(tables.plain(("name", "kind", "MB", "licence", "description", "where it is"), rows, caption=caption))


@data_app.command(name="get")
def data_get(name: str, /, *, dir: Path | None = None) -> None:
    """Fetch a data file from its public source, unless this machine has it.

    Parameters
    ----------
    name
        Name of a file from `luxloop data list`, or "all".
    dir
        Folder to store it in, instead of luxloop's own; set LUXLOOP_DATA to this folder to use it.
    """
    for each in data.registry() if name == "all" else [name]:
        fetched = data.get(each, dir)
        print(f"{each}: {fetched.path}{'' if fetched.downloaded else ' (was here)'}", flush=True)
