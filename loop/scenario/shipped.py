"""Shipped scenarios, examples and their files, by name. Imports nothing heavy, so that `luxloop list` answers at once."""

import json
import os
import re
from importlib.resources import files
from pathlib import Path
from typing import Final

from luxloop.world.errors import LuxloopError, did_you_mean

TEMPLATE: Final = Path(str(files("luxloop.scenarios") / "template" / "template.toml"))


def scenario_files() -> dict[str, Path]:
    """Shipped scenario files, by name."""
    return {path.stem: path for path in sorted(Path(str(files("luxloop.scenarios"))).glob("*.toml"))}


def examples() -> dict[str, Path]:
    """Shipped files of campaigns and data sets, lamp description and programs, by file name."""
    return {path.name: path for path in sorted(Path(str(files("luxloop.scenarios") / "examples")).glob("*.*"))}


def shipped_files(kind: str) -> dict[str, Path]:
    """Shipped files that scenarios name, of a kind, "symbols" or "utilisations", by name."""
    return {path.stem: path for path in sorted(Path(str(files("luxloop.scenarios") / kind)).iterdir())}


def find_file(name: str, kind: str) -> Path:
    """A file of a kind (`shipped_files`) by shipped name or path. Raises LuxloopError with the nearest name."""
    known = shipped_files(kind)
    if name in known:
        return known[name]
    if "/" in name or "." in name:
        return Path(name)
    hint = did_you_mean(name, known, f"shipped are {', '.join(known)}; a file or folder is given by its path")
    raise LuxloopError(f"there is no {name!r} among the {kind}; {hint}")


def original(like: str) -> Path:
    """The file of a shipped scenario or example, to copy. Raises LuxloopError with the nearest name."""
    known = scenario_files() | examples()
    if like not in known:
        hint = did_you_mean(like, known, "`luxloop list` and `luxloop list examples` show all")
        raise LuxloopError(f"--like {like}: there is no shipped scenario or example of this name; {hint}")
    return known[like]


def copy_text(source: Path, name: str) -> str:
    """Text of a shipped file; in scenarios and their template with another name."""
    text = source.read_text("utf-8")
    if source not in (TEMPLATE, scenario_files().get(source.stem)):
        return text
    return re.sub(r'^name = "[^"]*"', lambda _: f"name = {json.dumps(name, ensure_ascii=False)}", text, count=1, flags=re.MULTILINE)


def find(name: str) -> Path:
    """The file of a scenario by shipped name or path. Raises LuxloopError with the nearest name."""
    path = Path(name)
    known = scenario_files()
    if name in known:
        return known[name]
    if os.path.isfile(path):
        return path
    if os.path.isdir(path):
        raise LuxloopError(f"{name} is a folder; give a scenario file in it, whose name ends in .toml")
    if path.suffix == ".toml":
        raise LuxloopError(f"scenario file {name} does not exist; check the path, or write one with `luxloop new {name}`")
    hint = did_you_mean(name, known, "`luxloop list` shows all shipped ones, and a file's name ends in .toml")
    raise LuxloopError(f"there is no scenario {name!r}; {hint}")
