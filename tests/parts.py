"""Lamps, roads and textures that an earlier test has made serve again: to make them takes longer than most tests need beside.

They are taken over as `Simulation.prepare` takes over those of a simulation before, from any earlier one. `parts_serve_again` is for a
conftest; a test with `unshared` makes all that it needs.
"""

import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from loop.assembly.made import Made, Part, same
from loop.scenario.model import HeadlightParams
from world import presets
from world.roads.shapes import OpenCrgRoad

ENDINGS = ("mounted modules", "flux", "beam", "pixel controller", "over its beam", "module", "texture", "ground")
KEPT = 2  # of each name
MAKERS = tuple(f"loop.{module}.Made" for module in ("lighting.simulation", "lighting.lamps", "plant.simulated", "assembly.build"))
# What the product keeps for the life of a process: simulations, half a gigabyte each, and roads.
LONG_LIVED = (
    *(("loop.metrics", "_prepared"), ("loop.training.scenes", "_road"), ("loop.contracts.controller", "_world")),
    *(("loop.contracts.plant", "_world"), ("loop.contracts.function", "_world"), ("loop.contracts.tracker", "_frames")),
)
Entry = tuple[Any, Any]

memory: dict[str, list[Entry]] = {}


class Remembering(Made):
    """Parts that are made of values alone are taken over from any simulation of this process, as those of one before are."""

    def __call__(self, name: str, ingredients: Any, make: Callable[[], Part]) -> Part:
        if not lasting(name, ingredients):
            return super().__call__(name, ingredients, make)
        return super().__call__(name, ingredients, lambda: recalled(name, ingredients, make))


def lasting(name: str, ingredients: Any) -> bool:
    """Whether the part depends on no file, which a test may write anew."""
    return name.endswith(ENDINGS) and not any(map(of_a_file, ingredients if isinstance(ingredients, tuple) else (ingredients,)))


def of_a_file(ingredient: Any) -> bool:
    """A lamp or road of a file, or something of a module that the test wrote, `package.module:Name`."""
    if isinstance(ingredient, HeadlightParams):
        return ingredient.model not in presets.NAMES
    return isinstance(ingredient, OpenCrgRoad) or ":" in str(getattr(ingredient, "kind", ingredient if isinstance(ingredient, str) else ""))


def recalled(name: str, ingredients: Any, make: Callable[[], Part]) -> Part:
    entries = memory.setdefault(name, [])
    found = next((each for each in entries if same(each[0], ingredients)), None)
    if found is None:
        found = ingredients, make()
    entries[:] = [found, *(each for each in entries if each is not found)][:KEPT]
    part: Part = found[1]
    return part


def made_by(kind: type[Made], patch: pytest.MonkeyPatch) -> None:
    for name in MAKERS:
        patch.setattr(name, kind)


@pytest.fixture(scope="session", autouse=True)
def parts_serve_again() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        made_by(Remembering, patch)
        yield


@pytest.fixture
def unshared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulations of this test are made anew, all of them."""
    made_by(Made, monkeypatch)


@pytest.fixture(scope="module", autouse=True)
def simulations_end_with_the_file() -> Iterator[None]:
    yield
    for module, name in LONG_LIVED:
        if module in sys.modules:
            getattr(sys.modules[module], name).cache_clear()
