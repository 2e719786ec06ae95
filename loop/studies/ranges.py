"""Ranges of scenario keys to tune: `functions.symbol.controller.position.kp=0.1:2`."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.scenario.overrides import INDEX, overridden, toml_key
from luxloop.world.errors import LuxloopError, locate

Values = Mapping[str, float | int]


@dataclass(frozen=True)
class Range:
    """A key and its range. log: whether the scale is logarithmic. whole: whether values are integers."""

    key: str
    low: float
    high: float
    log: bool = False
    whole: bool = False

    def draw(self, rng: np.random.Generator) -> float | int:
        """Random number within the range, uniform on its scale."""
        if self.whole:
            return int(rng.integers(int(self.low), int(self.high), endpoint=True))
        low, high = np.log((self.low, self.high)) if self.log else (self.low, self.high)
        value = float(rng.uniform(low, high))
        return float(np.exp(value)) if self.log else value


def parse(text: str, scenarios: Sequence[Scenario], given_as: str = "--key") -> Range:
    """Range from KEY=LOW:HIGH or KEY=LOW:HIGH:log; all scenarios must accept both ends. given_as: option for messages.

    Raises LuxloopError with the key and the remedy.
    """
    where = f"{given_as} {text}"
    key, _, ends = text.partition("=")
    low_text, _, rest = ends.partition(":")
    high_text, _, scale = rest.partition(":")
    try:
        low, high = float(low_text), float(high_text)
    except ValueError as error:
        raise LuxloopError(
            f"{where}: is not of the form key=low:high; write for example functions.symbol.controller.position.kp=0.1:2"
        ) from error
    if scale not in ("", "log"):
        raise LuxloopError(f"{where}: {scale!r} is not a scale; write {key}={low_text}:{high_text}:log, or leave it out")
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        turned = f"write {key}={high_text}:{low_text}" if high < low else f"give {key} two different ends"
        raise LuxloopError(f"{where}: the range is the wrong way round or empty; {turned}")
    if scale and low <= 0:
        raise LuxloopError(f"{where}: a range that reaches {low:g} has no logarithm; let it begin above 0, or leave :log out")
    with locate(where):
        found = [value_of(scenario, key) for scenario in scenarios]
        # A key without a value has no type; the validated lower end has one.
        kinds = found if any(value is not None for value in found) else [value_of(with_values(scenarios[0], {key: _number(low_text)}), key)]
        whole = any(isinstance(value, int) for value in kinds)
        if whole and not (low.is_integer() and high.is_integer()):
            fraction = f", or {key} a value with a point, such as 1.0" if ".options." in key else ""
            raise LuxloopError(f"only whole numbers are possible; give whole ends{fraction}")
        made = Range(key, low, high, bool(scale), whole)
        for scenario in scenarios:
            for end in (low, high):
                ready = with_values(scenario, {key: int(end) if whole else end})
            if ".options." in key and value_of(scenario, key) is None:  # only the class knows whether it has such an option
                prepare(ready, "cpu")
    return made


def _number(text: str) -> float | int:
    return int(text) if text.lstrip("+-").isdecimal() else float(text)


def value_of(scenario: Scenario, key: str) -> float | int | None:
    """Number at a key of a scenario, None without a value. Raises LuxloopError for other values."""
    table: Any = scenario.model_dump(mode="json")
    for part in toml_key(key).replace('"', "").split("."):
        place = INDEX.fullmatch(part)
        if isinstance(table, list) and place:
            table = dict(enumerate(table)).get(int(place[1]))
        else:
            table = table.get(part) if isinstance(table, dict) else None
    if isinstance(table, bool) or not (table is None or isinstance(table, int | float)):
        raise LuxloopError(f"is not a number, and only numbers can be varied; {_hint(key, table)}")
    return table


def _hint(key: str, value: Any) -> str:
    if isinstance(value, dict) and value:
        return f"name one of its keys, such as {key}.{next(iter(value))}"
    return f"name one of its items, {key}[0] to [{len(value) - 1}]" if isinstance(value, list) and value else "give the key of one"


def with_values(scenario: Scenario, values: Values) -> Scenario:
    """Scenario with other values by key, as with `--set`. Raises LuxloopError if a value is invalid."""
    settings = [f"{key}={value!r}" for key, value in values.items()]
    data = overridden(scenario.model_dump(mode="json"), settings)
    return validate(data, f"{scenario.name} with {' '.join(f'{key}={value:g}' for key, value in values.items())}")


def overlay(values: Values) -> str:
    """TOML file of values, for `--set`."""
    return "".join(f"{toml_key(key)} = {value if isinstance(value, int) else repr(float(value))}\n" for key, value in values.items())
