"""Parts of one simulation serve in the next."""

from typing import Any

from luxloop.loop.simulation.part_cache import PartCache
from luxloop.world.roads.shapes import Bumps, Flat


def parts(cache: PartCache, *keys: Any) -> list[object]:
    found = [cache(f"part {k}", lambda _: object(), each) for k, each in enumerate(keys)]
    cache.end()
    return found


def test_parts_of_equal_parameters_and_the_same_objects_serve_again():
    thing, first = object(), PartCache()
    before = parts(first, Flat(), (Bumps(seed=3), [1.0, "a"]), {"key": thing}, 1)
    assert parts(PartCache(first), Flat(), (Bumps(seed=3), [1.0, "a"]), {"key": thing}, 1) == before
    others = parts(PartCache(first), Bumps(), (Bumps(seed=4), [1.0, "a"]), {"key": object()}, True)
    assert not set(map(id, others)) & set(map(id, before))


def test_parts_of_the_one_before_the_last_are_released():
    first = PartCache()
    parts(first, 1)
    second = PartCache(first)
    parts(second)  # which has no parts
    assert second.before("part 0", None) is None and PartCache(second).before("part 0", None) is None
    assert PartCache(first).before("part 0", None) is not None
