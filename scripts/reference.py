"""Tables of the documentation that are made when the site is built, from models and docstrings.

A page says where: `<!-- keys of Model -->`, `<!-- fields of module:Class -->`, `<!-- calls of module:Class -->`,
`<!-- messages of module:Union -->`, `<!-- columns of runs -->`, `<!-- cited equations -->`. The docstring of a class describes a field as
`name: what it is.`, or names it in backticks in its first sentence, and says when it is None.
"""

import ast
import inspect
import json
import re
from functools import cache
from importlib import import_module
from typing import Any, get_args

from citations import cited_table
from pydantic import BaseModel

from luxloop.loop.recording import record
from luxloop.loop.recording.comparison import TOLERANCES
from luxloop.loop.report.terminal import markdown_table
from luxloop.loop.rig.params import RigParams
from luxloop.loop.rig.simulated.faults import FaultParams
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.overrides import TAGS
from luxloop.loop.simulation import columns as recorded
from luxloop.loop.simulation.frames import COLUMNS
from luxloop.world.lamps.description import LampDescription

FILES: dict[str, tuple[type[BaseModel], ...]] = {
    "scenarios.md": (Scenario,),
    "lamps.md": (LampDescription,),
    "rig.md": (FaultParams, RigParams),
}
MARKED = re.compile(r"^<!-- (keys of|fields of|calls of|columns of|messages of|cited) (\S+) -->$", re.M)


def with_tables(text: str) -> str:
    makers = {
        "keys of": keys, "fields of": fields, "calls of": calls, "columns of": columns, "messages of": messages, "cited": cited_table,
    }  # fmt: skip
    return MARKED.sub(lambda match: f"{match[0]}\n{makers[match[1]](match[2])}", text)


def models(root: type[BaseModel]) -> dict[str, Any]:
    """JSON Schema of each table that a file may have, by the name of its model."""
    schema = root.model_json_schema()
    return {root.__name__: schema, **schema.get("$defs", {})}


@cache
def all_models() -> dict[str, Any]:
    return {name: schema for roots in FILES.values() for root in roots for name, schema in models(root).items()}


def written(value: Any) -> str:
    """A value as TOML writes it on one line."""
    if isinstance(value, dict):
        tags = {key: value[key] for key in TAGS if key in value}
        return "{ " + ", ".join(f"{key} = {written(inner)}" for key, inner in (tags or value).items()) + " }"
    return json.dumps(value)


def default(field: dict[str, Any]) -> str:
    if "default" not in field:
        return "required"
    value = field["default"]
    inner = all_models()[field["$ref"].rpartition("/")[2]]["properties"] if "$ref" in field else {}
    if inner and all("default" in each for each in inner.values()):
        return "its own"
    return "none" if value in (None, {}) else f"`{written(value)}`"


def allowed(field: dict[str, Any]) -> str:
    """What a key may be."""
    field = next((variant for variant in field.get("anyOf", []) if variant.get("type") != "null"), {}) | field
    if "enum" in field:
        return ", ".join(f"`{written(value)}`" for value in field["enum"])
    if "const" in field:
        return ""
    if "$ref" in field or "oneOf" in field or field["type"] == "object":
        return "table"
    if field["type"] == "array":
        if "prefixItems" in field:
            return f"list of {len(field['prefixItems'])} numbers"
        if field["items"].get("type") == "number":
            return "list of numbers"
        if field["items"].get("type") == "integer":
            return "list of whole numbers"
        if field["items"].get("type") == "string" and "enum" not in field["items"]:
            return "list of texts"
        return f"list: {allowed(field['items'])}" if "enum" in field["items"] else "list of tables"
    limits = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    words = {"number": "number", "integer": "whole number", "boolean": "true or false", "string": "text"}
    real = [f"{sign} {field[key]:g}" for key, sign in limits.items() if abs(field.get(key, 2**31)) < 2**31]  # not a type's size
    return ", ".join([words[field["type"]], *real])


def keys(name: str) -> str:
    rows = []
    for key, field in all_models()[name]["properties"].items():
        meaning = field.get("description", "which of the variants this is" if key in TAGS else "")
        rows.append((f"`{key}`", default(field), allowed(field), meaning))
    return markdown_table(("key", "default", "may be", "meaning"), rows, "l")


def messages(path: str) -> str:
    """Types, fields and meanings of the messages of a union of models."""
    rows = []
    for model in get_args(named(path)):
        properties = model.model_json_schema()["properties"]
        kinds = properties["type"].get("enum", [properties["type"].get("const")])
        given = []
        for key, field in properties.items():
            if key in ("type", "ask"):
                continue
            null = " or null" if {"type": "null"} in field.get("anyOf", ()) else ""
            given.append(f"`{key}`: {allowed(field)}{null}" + (f" = `{written(field['default'])}`" if "default" in field else ""))
        meaning = " ".join(inspect.cleandoc(model.__doc__).split())
        rows.append((", ".join(f"`{kind}`" for kind in kinds), "; ".join(given), meaning))
    return markdown_table(("type", "fields", "meaning"), rows, "l")


def named(path: str) -> type:
    """The class `module:Class`."""
    module, name = path.split(":")
    found: type = getattr(import_module(module), name)
    return found


def source(path: str) -> ast.ClassDef:
    tree = ast.parse(inspect.getsource(named(path))).body[0]
    assert isinstance(tree, ast.ClassDef)
    return tree


def annotated(path: str) -> dict[str, ast.AnnAssign]:
    return {ast.unparse(each.target): each for each in source(path).body if isinstance(each, ast.AnnAssign)}


def described(path: str) -> dict[str, str]:
    """What the docstring of a class says of each of its fields."""
    text = " ".join((named(path).__doc__ or "").split())
    field = "|".join(annotated(path))
    parts = re.split(rf"(?:^|(?<=[.;] ))((?:{field})(?:, (?:{field}))*): ", text)
    found = {each: meaning.strip(" .;") for names, meaning in zip(parts[1::2], parts[2::2], strict=True) for each in names.split(", ")}
    return {each: parts[0].split(". ")[0].strip(" .") for each in annotated(path) if f"`{each}`" in parts[0]} | found


def fields(path: str) -> str:
    meanings = described(path)
    rows = []
    for each, field in annotated(path).items():
        kind = ast.unparse(field.annotation) + (f" = {ast.unparse(field.value)}" if field.value else "")
        rows.append((f"`{each}`", "`" + kind.replace("|", "\\|") + "`", meanings.get(each, "")))
    return markdown_table(("field", "type", "meaning"), rows, "l")


def calls(path: str) -> str:
    rows = []
    for method in (each for each in source(path).body if isinstance(each, ast.FunctionDef) and each.name[0] != "_"):
        asked = ", ".join(each.arg for each in method.args.args[1:])
        is_value = any(ast.unparse(each).endswith("property") for each in method.decorator_list)
        returned = ast.unparse(method.returns).strip("'").replace("|", "\\|") if method.returns else ""
        meaning = " ".join((ast.get_docstring(method) or "").split())
        rows.append((f"`{method.name}`" if is_value else f"`{method.name}({asked})`", f"`{returned}`", meaning))
    return markdown_table(("call", "returns", "meaning"), rows, "l")


def columns(of: str) -> str:
    """Columns of `runs`, of `symbols` that are held, of their tolerances in `replays`, or of the exposures in `frames`."""
    if of == "replays":
        rows = [(f"`{name}`", f"{tolerance:g}", why) for name, (tolerance, why) in TOLERANCES.items()]
        return markdown_table(("column", "largest difference", "why"), rows, "l")
    groups: dict[str, dict[str, Any]] = {
        "": record.STEP | record.CONTROL | record.OBSERVED | record.LEARNING | record.LOOKING | record.EYES_PEAK,
        "body.true.": record.BODY,
        "body.measured.": record.BODY,
        "lamp.SIDE.": record.LAMP | record.LAMP_PEAK,
        "modules.NAME.": record.MODULE,
        "objects.NAME.": record.OBJECT | record.OBJECT_PEAK | record.LOOKED_AT,
        "functions.NAME.": record.ZONE,
    }
    if of == "symbols":
        groups = {"functions.NAME.": recorded.SYMBOL | recorded.CAUSES}
    if of == "frames":
        groups = {"": {name: entry[1:] for name, entry in COLUMNS.items()}}
    rows = [(f"`{prefix}{name}`", unit, text) for prefix, group in groups.items() for name, (unit, text) in group.items()]
    return markdown_table(("column", "unit", "meaning"), rows, "l")
