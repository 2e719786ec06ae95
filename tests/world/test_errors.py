"""Suggestions are made where a name is near, and nowhere else."""

import pytest

from world.errors import LuxloopError, did_you_mean

KNOWN = ("zones", "flat", "gfhb", "belgian_block", "kp")


@pytest.mark.parametrize(
    ("given", "meant"), [("zone", "zones"), ("Flat", "flat"), ("gfbh", "gfhb"), ("belgian", "belgian_block"), ("kq", "kp"), ("flt", "flat")]
)
def test_one_slip_is_recognised(given: str, meant: str) -> None:
    assert did_you_mean(given, KNOWN) == f"did you mean {meant!r}?"


@pytest.mark.parametrize("given", ["nonexist", "night", "", "belt", "xy"])
def test_what_is_not_near_is_not_suggested(given: str) -> None:
    assert did_you_mean(given, KNOWN) == "known are zones, flat, gfhb, belgian_block, kp"
    assert did_you_mean(given, KNOWN, "see the list") == "see the list"


def test_input_in_a_message_does_not_control_the_terminal() -> None:
    assert str(LuxloopError("a\x1b[31m\x07: line\nü")) == "a?[31m?: line\nü"
