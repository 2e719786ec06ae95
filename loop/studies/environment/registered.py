"""The shipped scenarios with one held symbol, registered with Gymnasium."""

import tomllib
from collections.abc import Iterator, Mapping
from typing import Final

import gymnasium

from luxloop.loop.scenario.shipped import scenario_files

IDS: Final[Mapping[str, str]] = {"": "moves", "Gains": "gains", "Heights": "heights"}
SINGLE: Final = "luxloop.loop.studies.environment.single:SymbolEnv"
VECTOR: Final = "luxloop.loop.studies.environment.vector:SymbolVectorEnv"


def register() -> tuple[str, ...]:
    """Register `luxloop/Snowflake-v0`, `luxloop/SnowflakeGains-v0`, `luxloop/SnowflakeHeights-v0` and so on; returns all ids."""
    ids = []
    for name in symbols():
        camel = "".join(part.capitalize() for part in name.split("_"))
        for ending, action in IDS.items():
            ids.append(f"luxloop/{camel}{ending}-v0")
            if ids[-1] not in gymnasium.registry:
                vector = None if action == "heights" else VECTOR
                gymnasium.register(ids[-1], SINGLE, vector_entry_point=vector, kwargs={"scenario": name, "action": action})
    return tuple(ids)


def symbols() -> Iterator[str]:
    """Names of the shipped scenarios with exactly one held symbol."""
    for name, path in scenario_files().items():
        functions = tomllib.loads(path.read_text("utf-8")).get("functions", {})
        if sum("controller" in each for each in functions.values()) == 1:
            yield name
