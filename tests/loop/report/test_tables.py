"""Tables to the terminal and to Markdown: the same columns and rows, aligned alike."""

import math

from rich.console import Console

from luxloop.loop.report import terminal
from luxloop.loop.report.terminal import LINE_S, markdown_table, number, plain, progress

COLUMNS = ("road", "step", "IoU", "")
ROWS = [("flat", 3, "0.98", "reached"), ("curb", 12, number(None), "")]


def test_markdown_aligns_columns_that_have_no_letter_as_the_last():
    assert markdown_table(COLUMNS, ROWS, "lrrl").splitlines() == [
        "| road | step | IoU |  |",
        "| --- | ---: | ---: | --- |",
        "| flat | 3 | 0.98 | reached |",
        "| curb | 12 | – |  |",
    ]
    assert markdown_table(COLUMNS, []).splitlines()[1] == "| --- | ---: | ---: | ---: |"


def test_the_terminal_aligns_alike():
    console = Console(record=True, width=60)
    console.print(plain(COLUMNS, ROWS, "lrrl", caption="below"))
    lines = [line.rstrip() for line in console.export_text().splitlines()]
    assert lines == ["road  step   IoU", "flat     3  0.98  reached", "curb    12     –", "below"]
    assert [number(value, ".1f", " lx") for value in (1.25, None, math.nan)] == ["1.2 lx", "–", "–"]


def test_a_log_gets_a_line_now_and_then_and_what_is_quick_says_nothing(capsys, monkeypatch):
    now_s = 100.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now_s)
    with progress("night [1]", 7, 2) as advance:
        for _ in range(5):
            now_s += 0.6 * LINE_S
            advance()
    assert capsys.readouterr().err.splitlines() == [
        "night [1]: 2 of 7 already done",
        "night [1]: 4 of 7 done after 36 s, about 54 s left",
        "night [1]: 6 of 7 done after 72 s, about 18 s left",
    ]
    with progress("steps", 3) as advance:
        for _ in range(3):
            advance()
    assert capsys.readouterr().err == ""
    with progress("after a long preparation", 12) as advance:
        now_s += 1.5 * LINE_S
        advance()
    assert capsys.readouterr().err == "after a long preparation: 1 of 12 done after 45 s\n"
