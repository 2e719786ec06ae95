"""Parts of one simulation serve in the next."""

from typing import Any

from luxloop.loop.simulation.made import Made
from luxloop.world.roads.shapes import Bumps, Flat


def parts(made: Made, *ingredients: Any) -> list[object]:
    found = [made(f"part {k}", each, object) for k, each in enumerate(ingredients)]
    made.end()
    return found


def test_what_has_the_same_ingredients_is_the_same() -> None:
    thing = object()
    first, again = Made(), [Flat(), (Bumps(seed=3), [1.0, "a"]), {"key": thing}]
    before = parts(first, *again)
    assert parts(Made(first), Flat(), (Bumps(seed=3), [1.0, "a"]), {"key": thing}) == before
    changed = parts(Made(first), Bumps(), (Bumps(seed=4), [1.0, "a"]), {"key": object()})
    assert not set(map(id, changed)) & set(map(id, before))


def test_objects_are_compared_by_identity_and_kinds_of_numbers_differ() -> None:
    first = Made()
    before = parts(first, [1], (1, 2), 1)
    assert not set(map(id, parts(Made(first), [1.0], (1, 2, 3), True))) & set(map(id, before))


def test_parts_of_the_one_before_the_last_are_let_go() -> None:
    first = Made()
    parts(first, 1)
    second = Made(first)
    parts(second)  # which has no parts
    assert second.before("part 0", None) is None and Made(second).before("part 0", None) is None
    assert Made(first).before("part 0", None) is not None
