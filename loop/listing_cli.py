"""The commands that show what luxloop has and what this machine has: list, schema, doctor, data."""

from pathlib import Path
from typing import Any, Literal

from cyclopts import App

from loop import tables
from loop.cli_common import DIFFERS, OK

data_app = App(name="data", help="Measured roads and light distributions from their public sources.")


def list_() -> None:
    """Show the scenarios that come with luxloop, and what data they lack."""
    tables.show(tables.scenarios())


def schema(*, kind: Literal["symbol", "lighting"] | None = None) -> None:
    """Print the JSON Schema of scenario files, for editors.

    Parameters
    ----------
    kind
        Scenarios that have a table of this name; by default both kinds.
    """
    import json

    from pydantic import TypeAdapter

    from loop.scenario import AnyScenario, LightingScenario, Scenario

    models: dict[str | None, Any] = {"symbol": Scenario, "lighting": LightingScenario, None: AnyScenario}
    print(json.dumps(TypeAdapter(models[kind]).json_schema(), indent=2))


def doctor() -> int:
    """Look at what luxloop needs on this machine, and name the command that mends what is missing."""
    from loop.doctor import all_good, checks

    found = checks()
    tables.show(tables.findings(found))
    return OK if all_good(found) else DIFFERS


@data_app.command(name="list")
def data_list() -> None:
    """Show the files that can be had, and which of them are here."""
    tables.show(tables.data_files())


@data_app.command(name="get")
def data_get(name: str, /, *, dir: Path | None = None) -> None:
    """Fetch a file from its public source, unless it is here.

    Parameters
    ----------
    name
        Name of a file from `luxloop data list`, or "all".
    dir
        Folder to put it into, in place of luxloop's own; point LUXLOOP_DATA to it later.
    """
    from loop import data

    for each in data.registry() if name == "all" else [name]:
        fetched = data.get(each, dir)
        print(f"{each}: {fetched.path}{'' if fetched.downloaded else ' (was here)'}", flush=True)
