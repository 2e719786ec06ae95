"""Keys of a scenario that are tuned, and the ranges that they are tuned in: `controller.position.kp=0.1:2`."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from loop.scenario import Scenario, validate
from loop.validation import did_you_mean
from world.errors import LuxloopError

Values = Mapping[str, float | int]


@dataclass(frozen=True)
class Range:
    """A key and its least and largest value. log: whether factors count, not differences. whole: only whole numbers are possible."""

    key: str
    low: float
    high: float
    log: bool = False
    whole: bool = False


def parse(text: str, scenarios: Sequence[Scenario]) -> Range:
    """A range given as KEY=LOW:HIGH or KEY=LOW:HIGH:log, for scenarios that must have that key and bear either end.

    Raises LuxloopError that names the key and the remedy.
    """
    where = f"--key {text}"
    key, _, ends = text.partition("=")
    low_text, _, rest = ends.partition(":")
    high_text, _, scale = rest.partition(":")
    try:
        low, high = float(low_text), float(high_text)
    except ValueError as error:
        raise LuxloopError(f"{where}: is not of the form key=low:high; write for example controller.position.kp=0.1:2") from error
    if scale not in ("", "log"):
        raise LuxloopError(f"{where}: {scale!r} is no scale; write {key}={low_text}:{high_text}:log, or leave it out")
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        turned = f"write {key}={high_text}:{low_text}" if high < low else f"give {key} two different ends"
        raise LuxloopError(f"{where}: the range is the wrong way round or empty; {turned}")
    if scale and low <= 0:
        raise LuxloopError(f"{where}: a range that reaches {low:g} has no logarithm; let it begin above 0, or leave :log out")
    found = [value_of(scenario, key) for scenario in scenarios]
    whole = any(isinstance(value, int) for value in found)
    if whole and not (low.is_integer() and high.is_integer()):
        raise LuxloopError(f"{where}: only whole numbers are possible; give whole ends")
    made = Range(key, low, high, bool(scale), whole)
    for scenario in scenarios:
        for end in (low, high):
            changed(scenario, {key: int(end) if whole else end})
    return made


def value_of(scenario: Scenario, key: str) -> float | int | None:
    """The number that a scenario has at a key, None where it has left an optional one out. Raises LuxloopError with the nearest key."""
    table: Any = scenario.model_dump(mode="json")
    for number, part in enumerate(parts := key.split(".")):
        if not isinstance(table, dict) or part not in table:
            before = ".".join(parts[:number])
            known = list(table) if isinstance(table, dict) else []
            hint = did_you_mean(part, known) if known else f"{before} is no table"
            raise LuxloopError(f"--key {key}: {scenario.name} has no {part!r}{f' in {before}' if before else ''}; {hint}")
        table = table[part]
    if isinstance(table, bool) or not (table is None or isinstance(table, int | float)):
        hint = f"name one of its keys, such as {key}.{next(iter(table))}" if isinstance(table, dict) and table else "give the key of one"
        raise LuxloopError(f"--key {key}: is no number, and only numbers are tuned; {hint}")
    return table


def changed(scenario: Scenario, values: Values) -> Scenario:
    """The scenario with other values. Raises LuxloopError where one is not possible."""
    data = scenario.model_dump(mode="json")
    for key, value in values.items():
        *path, last = key.split(".")
        table = data
        for part in path:
            table = table[part]
        table[last] = value
    return validate(data, f"{scenario.name} with {' '.join(f'{key}={value:g}' for key, value in values.items())}")


def overlay(values: Values) -> str:
    """Values as a TOML file for `--set`."""
    return "".join(f"{key} = {value if isinstance(value, int) else repr(float(value))}\n" for key, value in values.items())
