"""The ambient loop against a scene in which objects are found by the base beam alone."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from luxloop.controllers.functions.object_loop import Ambient, AmbientLoopParams

PARAMS = AmbientLoopParams()


def doubted(ambient: Ambient, *confidences: float) -> Ambient:
    """A step for objects that only the base beam can help."""
    return PARAMS.step(ambient, confidences, confidences)


def followed(needed: float, steps: int) -> list[Ambient]:
    """States of a loop around an object that is found for sure from a share `needed` on, doubtfully from half of that on."""
    ambient, states = Ambient(1.0), []
    for _ in range(steps):
        ambient = doubted(ambient, 0.7 if ambient.share >= needed else 0.35 if ambient.share >= needed / 2 else 0.1)
        states.append(ambient)
    return states


def test_with_nothing_in_doubt_it_falls_to_the_least_within_a_second() -> None:
    shares = [each.share for each in followed(0.0, 30)]
    assert shares == sorted(shares, reverse=True) and shares[-1] == PARAMS.least
    assert [PARAMS.step(Ambient(0.5, rested=k), (), ()).share for k in (0, 2, 3)] == [0.5, 0.5, 0.25]


@given(needed=st.floats(0.06, 1.0))
def test_it_keeps_what_it_found_detectable_and_does_not_hunt(needed: float) -> None:
    """Never doubtful for longer than it takes to rise; steps are rare once the least has been found."""
    states = followed(needed, 600)
    doubtful = [each.share < needed / 2 for each in states]
    assert not any(a and b for a, b in pairwise(doubtful))
    changes = sum(a.share != b.share for a, b in pairwise(states[60:]))
    assert changes <= 2 * 540 / PARAMS.patience + 2
    assert states[-1].share < max(3.5 * needed, 1.5 * PARAMS.least)


def test_it_rises_at_once_and_waits_between_two_steps() -> None:
    first = doubted(Ambient(0.05, rested=1), 0.1, 0.9)
    assert first.share == 0.1
    ambient, shares = first, []
    for _ in range(PARAMS.patience):
        ambient = doubted(ambient, 0.1)
        shares.append(ambient.share)
    assert shares == [0.1] * (PARAMS.patience - 1) + [0.2]
    assert PARAMS.step(Ambient(0.5, rested=9), [0.1, 0.9], [0.9]) == Ambient(0.5, rested=10), "for who may be helped otherwise"


def test_after_a_loss_it_stays_up_for_a_while_and_falls_again() -> None:
    ambient, shares = Ambient(0.05, rested=10), []
    for k in range(400):
        ambient = doubted(ambient, 0.1 if 5 <= k < 12 else 0.8)
        shares.append(ambient.share)
    assert set(shares[:5]) == {0.05} and set(shares[5 : 5 + PARAMS.patience]) == {0.1} and set(shares[5 + PARAMS.patience + 20 :]) == {0.05}


@pytest.mark.parametrize("params", [{"first": 0.0, "least": 0.0}, {"least": 0.0}, {"first": 0.1, "least": 0.5}])
def test_a_loop_that_could_not_rise_or_begins_below_its_least_is_refused(params: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=r"greater than 0|first: 0.1 is below least, 0.5"):
        AmbientLoopParams(**params)


@given(first=st.floats(0.01, 1.0), least=st.floats(0.01, 1.0), confidences=st.lists(st.floats(0, 1), min_size=1, max_size=100))
def test_the_share_stays_between_the_least_and_all(first: float, least: float, confidences: list[float]) -> None:
    params = AmbientLoopParams(first=max(first, least), least=least)
    ambient = Ambient(params.first)
    for confidence in confidences:
        ambient = params.step(ambient, [confidence], [confidence])
        assert least <= ambient.share <= 1
