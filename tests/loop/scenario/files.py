"""Scenario files to start from, and what is said of one that cannot be read."""

import re
from pathlib import Path

import pytest

from luxloop import LuxloopError, load

SYMBOL = """
name = "good"
steps = 3
[functions.symbol]
kind = "symbol"
image = "snowflake"
"""
GOOD = SYMBOL + 'controller = "luxloop"\n'
PID = SYMBOL + '[functions.symbol.controller]\nname = "thesis_pid"\n'
BOX = '[[objects]]\nkind = "box"\nname = "crate"\nsize_m = [1, 1, 1]\ntrack = [{position_m = [17, 0, 0]}]\n'
LIT = 'name = "lit"\n[lighting]\nbase = { beam = "low" }\n'


def is_one_sentence(text: str) -> bool:
    return "\n" not in text and "Traceback" not in text and not re.search(r"\.\s+[A-Z]", text)


def failure(name: Path | str, *overrides: str, **values: object) -> str:
    with pytest.raises(LuxloopError) as caught:
        load(str(name), overrides, **values)
    assert all(map(is_one_sentence, caught.value.args))
    return str(caught.value)
