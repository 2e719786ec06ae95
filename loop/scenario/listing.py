"""Shipped parts by kind, with names and descriptions, for `luxloop list`."""

import tomllib
from importlib import import_module
from typing import Any, Literal, get_args

from luxloop.loop.scenario import data
from luxloop.loop.scenario.shipped import examples, scenario_files, shipped_files

Kind = Literal["scenarios", "functions", "controllers", "roads", "symbols", "detectors", "lamps", "plants", "examples"]
USES: dict[Kind, str] = {
    "scenarios": "Run one with `luxloop run NAME`, copy it with `luxloop new FILE --like NAME`.",
    "functions": "Use one as functions.NAME.kind of a scenario (keys in docs/scenarios.md); your own is package.module:Name.",
    "controllers": "Use one with `--controller NAME`, or as functions.NAME.controller; your own is package.module:Name.",
    "roads": "Use one with `--set road.kind=NAME`; `luxloop schema` has the keys of each; your own is package.module:Name.",
    "symbols": "Use one as functions.NAME.image of a symbol; your own is the path of a picture.",
    "detectors": "Use one with `--set detector.kind=NAME`; your own is package.module:Name.",
    "lamps": "Use one with `--set headlight.model=NAME`; `luxloop headlight info NAME` describes it.",
    "plants": "Use one with `--set plant.kind=NAME`, a recording with `--plant FOLDER`; your own is package.module:Name.",
    "examples": "Copy one with `luxloop new --like NAME`.",
}

VARIANTS: dict[Kind, str] = {  # unions of a scenario's tables
    "controllers": "controllers.symbol.ControllerParams",
    "functions": "controllers.functions.planner.FunctionParams",
    "plants": "loop.scenario.plant.PlantParams",
    "roads": "world.roads.shapes.RoadParams",
    "detectors": "perception.detection.detector.DetectorParams",
}


def listing(kind: Kind) -> list[dict[str, Any]]:
    """`name` and `description` of all parts of a kind; of scenarios also `uses` (controllers and kinds of lighting functions) and `lacks`
    (a data file that is missing on this machine, or None).

    Scenarios, symbols and examples are read as files, without heavy imports.
    """
    match kind:
        case "scenarios":
            return _scenarios()
        case "symbols":
            shown = [(name, each.get("image")) for name, content in _contents().items() for each in content.get("functions", {}).values()]
            scenarios = {symbol: dict.fromkeys(name for name, image in shown if image == symbol) for symbol in shipped_files("symbols")}
            return [{"name": symbol, "description": f"shown by {', '.join(names)}"} for symbol, names in scenarios.items()]
        case "examples":
            return [
                {"name": name, "description": path.read_text("utf-8").partition("\n")[0].strip('"# .')} for name, path in examples().items()
            ]
        case "lamps":
            from luxloop.world.lamps.presets import SUMMARIES

            return [{"name": name, "description": summary} for name, summary in SUMMARIES.items()]
        case _:
            return _variants(VARIANTS[kind])


def _scenarios() -> list[dict[str, Any]]:
    """Shipped scenarios. uses: controllers of symbols and kinds of other lighting functions, or else the base beam."""
    found = []
    for name, content in _contents().items():
        road, lighting = content.get("road", {}).get("file", ""), content.get("lighting", {})
        lacking = road in data.registry() and data.present(road) is None
        controllers = ((each, each.get("controller")) for each in content.get("functions", {}).values())
        kinds = (given["name"] if isinstance(given, dict) else given or each["kind"] for each, given in controllers)
        uses = list(dict.fromkeys([*(["raw utilisations"] if "raw" in lighting else []), *kinds]))
        uses = uses or [f"{lighting['base']['beam']} beam"]
        found.append({"name": name, "description": content["description"], "uses": uses, "lacks": road if lacking else None})
    return found


def _contents() -> dict[str, dict[str, Any]]:
    """Tables of the shipped scenarios, by name."""
    return {name: tomllib.loads(file.read_text("utf-8")) for name, file in scenario_files().items()}


def _variants(name: str) -> list[dict[str, Any]]:
    """Variants of a union by tag, described by the first sentences of their docstrings; the user's own parts have no tag."""
    from luxloop.world.plugin import OWN, by_tag

    module, _, union = name.rpartition(".")
    models = by_tag(get_args(getattr(import_module(f"luxloop.{module}"), union))[0])
    return [
        {"name": tag, "description": model.__doc__.partition("\n")[0].partition(". ")[0].rstrip(".")}
        for tag, model in models.items()
        if tag != OWN
    ]
