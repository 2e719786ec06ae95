"""Where nobody watches a bar, lines tell now and then how far long work is."""

import pytest

from luxloop.loop.report import terminal as module
from luxloop.loop.report.terminal import LINE_S, progress


def test_a_log_gets_a_line_now_and_then(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now_s)
    with progress("night [1]", 7, 2) as advance:
        for _ in range(5):
            now_s += 0.6 * LINE_S
            advance()
    assert capsys.readouterr().err.splitlines() == [
        "night [1]: 2 of 7 already done",
        "night [1]: 4 of 7 done after 36 s, about 54 s left",
        "night [1]: 6 of 7 done after 72 s, about 18 s left",
    ]


def test_what_is_quick_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress("steps", 3) as advance:
        for _ in range(3):
            advance()
    assert capsys.readouterr().err == ""
