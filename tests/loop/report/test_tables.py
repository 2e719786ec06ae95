"""Tables to the terminal and to Markdown: the same columns and rows, aligned alike."""

import math

import pytest
from rich.console import Console

from luxloop.loop.report.terminal import markdown_table, number, plain

COLUMNS = ("road", "step", "IoU", "")
ROWS = [("flat", 3, "0.98", "reached"), ("curb", 12, number(None), "")]


def test_markdown_aligns_columns_that_have_no_letter_as_the_last() -> None:
    assert markdown_table(COLUMNS, ROWS, "lrrl").splitlines() == [
        "| road | step | IoU |  |",
        "| --- | ---: | ---: | --- |",
        "| flat | 3 | 0.98 | reached |",
        "| curb | 12 | – |  |",
    ]
    assert markdown_table(COLUMNS, []).splitlines()[1] == "| --- | ---: | ---: | ---: |"


def test_the_terminal_aligns_alike() -> None:
    console = Console(record=True, width=60)
    console.print(plain(COLUMNS, ROWS, "lrrl", caption="below"))
    lines = [line.rstrip() for line in console.export_text().splitlines()]
    assert lines == ["road  step   IoU", "flat     3  0.98  reached", "curb    12     –", "below"]


@pytest.mark.parametrize(("value", "text"), [(1.25, "1.2 lx"), (None, "–"), (math.nan, "–")])
def test_a_number_that_is_missing_is_a_dash(value: float | None, text: str) -> None:
    assert number(value, ".1f", " lx") == text
