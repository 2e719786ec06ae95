"""What comes with luxloop, by kind: the name of each and what it is. `luxloop list` shows it."""

import tomllib
from typing import Any, Literal, get_args

from loop.scenario import data
from loop.scenario.shipped import examples, shipped, shipped_files

Kind = Literal["scenarios", "controllers", "roads", "symbols", "detectors", "lamps", "examples"]
USES: dict[Kind, str] = {
    "scenarios": "Run one with `luxloop run NAME`, copy it with `luxloop new FILE --like NAME`.",
    "controllers": "Take one with `--controller NAME`, or as controller.name of a scenario; one of your own is package.module:Name.",
    "roads": "Take one with `--set road.kind=NAME`; `luxloop schema` has the keys of each; one of your own is package.module:Name.",
    "symbols": "Take one with `--set symbol.image=NAME`; one of your own is the path of a picture.",
    "detectors": "Take one with `--set detector.kind=NAME` in a scenario with [functions.NAME]; one of your own is package.module:Name.",
    "lamps": "Take one with `--set headlight.model=NAME`; `luxloop headlight info NAME` describes it.",
    "examples": "Copy one with `luxloop new --like NAME`.",
}
DEFAULT_CONTROLLER = "luxloop"  # of scenarios that name none, whose model imports torch


def listing(kind: Kind) -> list[dict[str, Any]]:
    """All of a kind: `name` and `description`; of a scenario also what it `uses` and the data file that it `lacks` on this machine, if any.

    Imports no more than the kind needs: scenarios, symbols and examples are read as files.
    """
    match kind:
        case "scenarios":
            return _scenarios()
        case "symbols":
            return [{"name": name, "description": f"shown by {', '.join(_showing(name))}"} for name in shipped_files("symbols")]
        case "examples":
            return [{"name": name, "description": _first_line(path.read_text("utf-8"))} for name, path in examples().items()]
        case "lamps":
            from world.presets import SUMMARIES

            return [{"name": name, "description": summary} for name, summary in SUMMARIES.items()]
        case "controllers":
            from controllers.symbol import ControllerParams

            return _variants(ControllerParams)
        case "roads":
            from world.roads.shapes import RoadParams

            return _variants(RoadParams)
        case "detectors":
            from perception.detection.params import DetectorParams

            return _variants(DetectorParams)


def _scenarios() -> list[dict[str, Any]]:
    """Read without validation, which the tests have done."""
    found = []
    for name, file in shipped().items():
        content = tomllib.loads(file.read_text("utf-8"))
        road = content.get("road", {}).get("file", "")
        lacking = road in data.registry() and data.present(road) is None
        found.append({"name": name, "description": content["description"], "uses": _uses(content), "lacks": road if lacking else None})
    return found


def _uses(content: dict[str, Any]) -> list[str]:
    """The controller of a symbol, or the kinds of lighting functions, the base beam where there are none."""
    if not content.keys() & {"lighting", "functions"}:
        return [str(content.get("controller", {}).get("name", DEFAULT_CONTROLLER))]
    lighting = content.get("lighting", {})
    raw = ["raw utilisations"] if "raw" in lighting else []
    kinds = list(dict.fromkeys([*raw, *(function["kind"] for function in content.get("functions", {}).values())]))
    return kinds or [f"{lighting['base']['beam']} beam"]


def _showing(symbol: str) -> list[str]:
    """The scenarios that show a symbol."""
    contents = {name: tomllib.loads(file.read_text("utf-8")) for name, file in shipped().items()}
    return [name for name, content in contents.items() if content.get("symbol", {}).get("image") == symbol]


def _first_line(text: str) -> str:
    """What the first line of a program or of a TOML file says."""
    return text.partition("\n")[0].strip('"# .')


def _variants(union: Any) -> list[dict[str, Any]]:
    """The variants of a table that luxloop has, each by its tag and the first sentence of its docstring; own parts have no name to list."""
    from world.plugin import OWN

    models = {get_args(each)[1].tag: get_args(each)[0] for each in get_args(get_args(union)[0])}
    return [{"name": tag, "description": _first_sentence(model.__doc__)} for tag, model in models.items() if tag != OWN]


def _first_sentence(text: str) -> str:
    return text.partition("\n")[0].partition(". ")[0].rstrip(".")
