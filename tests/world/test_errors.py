"""Suggestions are made where a name is near, and nowhere else; a message has a line an error."""

import pytest

from luxloop.world.errors import LuxloopError, all_of, did_you_mean, redact

KNOWN = ("zones", "flat", "gfhb", "belgian_block", "kp")


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("zone", "zones"),
        ("Flat", "flat"),
        ("gfbh", "gfhb"),
        ("belgian", "belgian_block"),
        ("kq", "kp"),
        ("flt", "flat"),
        ("bel", "belgian_block"),
    ],
)
def test_one_slip_is_recognised(given: str, meant: str) -> None:
    assert did_you_mean(given, KNOWN) == f"did you mean {meant!r}?"


@pytest.mark.parametrize("given", ["nonexist", "night", "", "belt", "xy"])
def test_what_is_not_near_is_not_suggested(given: str) -> None:
    assert did_you_mean(given, KNOWN) == "known are zones, flat, gfhb, belgian_block, kp"
    assert did_you_mean(given, KNOWN, "see the list") == "see the list"


def test_input_in_a_message_does_not_control_the_terminal() -> None:
    assert str(LuxloopError("a\x1b[31m\x07: line\nü")) == "a?[31m?: line ü"


def test_a_single_error_has_no_count() -> None:
    assert str(all_of(["key: is wrong"])) == "key: is wrong"


def test_plain_data_is_told_without_logins() -> None:
    rig = {
        "camera": {"url": "rtsp://a:b@host/x?user=c&PWD=d&n=1", "options": {"password": "e", "rtsp_transport": "tcp", "width": 3}},
        "list": ["x://f@g"],
    }
    told = {
        "camera": {"url": "rtsp://***@host/x?user=c&PWD=***&n=1", "options": {"password": "***", "rtsp_transport": "tcp", "width": 3}},
        "list": ["x://***@g"],
    }
    assert redact(rig) == told
