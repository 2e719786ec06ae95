"""Methods whose last results are kept by their object."""

import gc
import weakref
from dataclasses import dataclass

from luxloop.world.kept import keeping


@dataclass
class Squares:
    asked: int = 0

    def __post_init__(self) -> None:
        self.of = keeping(2, self._of)

    def _of(self, x: int) -> int:
        self.asked += 1
        return x * x


def test_the_last_results_are_kept() -> None:
    squares = Squares()
    assert [squares.of(x) for x in (1, 2, 1, 2)] == [1, 4, 1, 4] and squares.asked == 2
    assert [squares.of(x) for x in (3, 1)] == [9, 1] and squares.asked == 4, "1 was the oldest"


def test_objects_go_with_their_last_user() -> None:
    squares = Squares()
    squares.of(3)
    gone = weakref.ref(squares)
    gc.disable()
    try:
        del squares
        assert gone() is None
    finally:
        gc.enable()
