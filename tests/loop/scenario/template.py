"""The file that `luxloop new` copies: a scenario that runs, with every common key and what it means, made from the model itself.

`python -m tests.loop.scenario.template` writes it anew.
"""

from typing import Any, Literal, cast, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from luxloop import Scenario
from luxloop.controllers.functions.symbol import UNCONTROLLED, SymbolFunctionParams
from luxloop.controllers.symbol import CONTROLLERS, HeightControllerParams
from luxloop.controllers.symbol.sensing.projector import StartParams
from luxloop.controllers.symbol.sensing.symbol_sensor import FeatureParams
from luxloop.loop.scenario.plant import SimulatedPlantParams
from luxloop.loop.scenario.shipped import TEMPLATE, shipped_files
from luxloop.perception.extraction import ExtractionParams
from luxloop.perception.tracking import TrackerParams
from luxloop.world.plugin import by_tag
from luxloop.world.roads.shapes import Mixed, RoadParams
from luxloop.world.validation import toml

LEFT_OUT = ("schema_version", "objects")  # said in HEAD and TAIL
CHOSEN: dict[str, dict[str, Any]] = {
    "road": {"kind": "mixed"},
    "headlight": {"model": "idealised-332x1024", "lamps": ("left",)},
}
SYMBOL: dict[str, dict[str, Any]] = {  # of the function, and of its tables
    "": {"kind": "symbol", "image": "snowflake", "width_m": 2.0, "length_m": 4.0, "x_m": 17.0, "y_m": 0.0},
    "start": {"x_m": 20.0, "y_m": 1.5, "roll_deg": 5.0, "pitch_deg": -2.0},
    "controller": {"name": "luxloop"},
}
VARIANTS: dict[str, type[BaseModel]] = {
    "road": Mixed,
    "plant": SimulatedPlantParams,
    "tracker": TrackerParams,
    "start": StartParams,
    "controller": HeightControllerParams,
    "features": FeatureParams,
    "extraction": ExtractionParams,
}
HEAD = """\
# A scenario of luxloop. Check it with `luxloop check FILE`, run it with `luxloop run FILE`.
# Lines that begin with # show defaults: remove the # to change one. SI units, degrees where a name ends in _deg.
# World: x forward, y left, z up; the origin lies on the road below the middle of the lamps, the vehicle stands still.

schema_version = 1
"""
TAIL = """
# Objects, as many as wanted: kind "box", "mesh" (from a file), "pedestrian", "cyclist", "motorcycle", "car", "animal",
# "traffic_sign", "clutter", "model".
# They may move, appear and vanish; a table [traffic] puts some there at random.
# [[objects]]
# kind = "box"
# name = "black_box"
# size_m = [0.4, 0.4, 0.3]
# albedo = 0.02
# track = [{position_m = [17.0, 0.3, 0.0]}]
# appears_s = 0.35
# vanishes_s = 1.35
"""


def template() -> str:
    """The text of the file."""
    chosen = {"name": "template", "description": "A snowflake is pulled straight on an uneven road.", "steps": 40, "seed": 0}
    keys, tables = [], []
    for key, field in Scenario.model_fields.items():
        if key in LEFT_OUT:
            continue
        if key == "functions":
            tables.append(_symbol())
        elif key in CHOSEN or isinstance(field.default, BaseModel):
            tables.append(_table(key, field))
        else:
            keys.append(_line(key, field, chosen.get(key)))
    return HEAD + "\n".join(keys) + "\n\n" + "\n\n".join(tables) + "\n" + TAIL


def _symbol() -> str:
    """A symbol that is held, and its tables."""
    fields = {key: each for key, each in SymbolFunctionParams.model_fields.items() if key not in UNCONTROLLED}
    lines = ["[functions.symbol]  # a lighting function; `luxloop list functions` has all kinds, and a file may have several"]
    lines.append(f"# shipped images: {', '.join(shipped_files('symbols'))}")
    lines += [_line(key, each, SYMBOL[""].get(key)) for key, each in fields.items() if key not in VARIANTS]
    tables = [_table(key, fields[key], "functions.symbol.", SYMBOL.get(key, {})) for key in VARIANTS if key in fields]
    return "\n\n".join(["\n".join(lines), *tables])


def _table(key: str, field: FieldInfo, within: str = "", chosen: dict[str, Any] | None = None) -> str:
    chosen = CHOSEN.get(key, {}) if chosen is None else chosen
    model = VARIANTS.get(key) or cast(type[BaseModel], field.annotation)
    lines = [f"[{within}{key}]  # {field.description}"]
    if key == "road":
        kinds = by_tag(get_args(RoadParams)[0])
        lines.append(f"# kinds: {', '.join(kinds)}; `luxloop schema` has the keys of each")
    if key == "controller":
        lines.append(f"# controllers: {', '.join(CONTROLLERS)}")
    lines += [_line(name, inner, chosen.get(name)) for name, inner in model.model_fields.items()]
    return "\n".join(lines)


def _line(key: str, field: FieldInfo, chosen: Any) -> str:
    value = field.default if chosen is None else chosen
    hidden = "# " if chosen is None else ""
    written = "..." if value is None else toml(value)
    choices = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
    meaning = [field.description] if field.description else []
    meaning += [f"one of {toml(choices)}"] if len(choices) > 1 else []
    return f"{hidden}{key} = {written}" + (f"  # {'; '.join(meaning)}" if meaning else "")


if __name__ == "__main__":
    TEMPLATE.write_text(template(), "utf-8")
