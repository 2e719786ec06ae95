"""Texts of scenario files: of a scenario, and of a night drawn from a seed for `luxloop new`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.overrides import TAGS
from luxloop.world.traffic.roles import Population
from luxloop.world.validation import toml

HEAD: Final = """\
# A night on the road, drawn from a seed. Check it with `luxloop check FILE`, run it with `luxloop run FILE`.
# Another traffic.seed: others elsewhere. Add your own objects as [[objects]].

schema_version = 1"""


def scenario_text(scenario: Scenario) -> str:
    """Text of a file that `load` reads as the scenario; defaults are left out."""
    values, lines, tables = _plain(scenario), list[str](), list[str]()
    for key, value in values.items():
        if key in ("functions", "checks") and isinstance(value, dict):
            tables += [_table(f"[{key}.{name}]", each) for name, each in value.items()]
        elif isinstance(value, dict):
            tables.append(_table(f"[{key}]", value))
        elif isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
            tables += [_table(f"[[{key}]]", each) for each in value]
        else:
            lines.append(f"{key} = {toml(value)}")
    return "\n\n".join(["\n".join(lines), *tables]) + "\n"


def _table(head: str, values: Mapping[str, Any]) -> str:
    return "\n".join([head, *(f"{key} = {toml(value)}" for key, value in values.items())])


def _plain(value: Any) -> Any:
    """Plain data without defaults and None; tags of variants stay."""
    if isinstance(value, BaseModel):
        fields = {key: (getattr(value, key), field.get_default()) for key, field in type(value).model_fields.items()}
        return {key: _plain(each) for key, (each, default) in fields.items() if key in TAGS or each != default}
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items() if each is not None}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return str(value) if isinstance(value, Path) else value


def night(name: str, seed: int, population: Population = "first") -> str:
    """Text of a scenario of lighting functions with traffic, road and light drawn from a seed."""
    from luxloop.world.traffic.generator import random_tables, second_tables

    world = second_tables(seed) if population == "second" else random_tables(seed)
    head = {"name": name, "steps": 40, "rate_hz": 20, "conditions": world.pop("conditions", None)}
    tables = {
        **world,
        "traffic": world["traffic"] | {"on_road": True},
        "camera": {"width_px": 960, "height_px": 400, "hfov_deg": 30.0, "pitch_deg": 1.5},
        "headlight": {"model": "ssl-hd-lores"},
        "lighting": {"base": {"beam": "low"}},
        "functions.guard_traffic": {"kind": "glare_free"},
    }
    top = _table(HEAD, {key: value for key, value in head.items() if value is not None})
    return "\n\n".join([top, *(_table(f"[{key}]", table) for key, table in tables.items())]) + "\n"
