"""Methods and images whose last results stay."""

import copy
import gc
import pickle
import weakref
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from luxloop.world.caches import Part, PartialImage, keeping


@dataclass
class Squares:
    asked: int = 0

    def __post_init__(self) -> None:
        self.of = keeping(2, self._of)

    def _of(self, x: int) -> int:
        self.asked += 1
        return x * x


def test_the_last_results_are_kept():
    squares = Squares()
    assert [squares.of(x) for x in (1, 2, 1, 2)] == [1, 4, 1, 4] and squares.asked == 2
    assert [squares.of(x) for x in (3, 1)] == [9, 1] and squares.asked == 4, "1 was the oldest"


def test_objects_go_with_their_last_user():
    squares = Squares()
    squares.of(3)
    gone = weakref.ref(squares)
    gc.disable()
    try:
        del squares
        assert gone() is None
    finally:
        gc.enable()


WHOLE = torch.arange(200.0 * 300).view(200, 300)


@pytest.fixture
def computed() -> list[Part]:
    """Parts that were computed, in order."""
    return []


@pytest.fixture
def image(computed: list[Part]) -> PartialImage:
    def part_of(part: Part) -> Tensor:
        computed.append(part)
        return WHOLE[part].clone()

    return PartialImage.of(200, 300, WHOLE, part_of)


def test_only_what_is_read_is_computed(image, computed):
    assert (image.shape, image.dtype, image.device, image.dim(), image.size(-1)) == ((200, 300), torch.float32, WHOLE.device, 2, 300)
    assert isinstance(image, Tensor) and not computed
    rows, columns = slice(50, 60), slice(100, 140)
    assert image[..., rows, columns].equal(WHOLE[rows, columns]) and image[rows, columns].equal(WHOLE[rows, columns])
    near = slice(44, 66), slice(76, 164)  # 3 % of 200 rows, 8 % of 300 columns beyond
    assert image[near].equal(WHOLE[near]) and computed == [near]
    farther = slice(195, None), slice(0, 2)
    assert image[farther].equal(WHOLE[farther]) and image[rows, columns].equal(WHOLE[rows, columns]) and len(computed) == 2


def test_all_else_sees_the_whole(image, computed):
    assert image[10:12, 20:30].sum() == WHOLE[10:12, 20:30].sum()
    assert float(image.max()) == float(WHOLE.max()) and computed[1:] == [(slice(0, 200), slice(0, 300))]
    for same in (image + 0, 0 + image, image[::1], image[0:200:1, :], image.clone(), torch.stack([image, image])[1], copy.deepcopy(image)):
        assert type(same) is Tensor and same.equal(WHOLE)
    assert image[7].equal(WHOLE[7]) and image.T.equal(WHOLE.T) and image[WHOLE > 9].equal(WHOLE[WHOLE > 9])
    assert pickle.loads(pickle.dumps(image)).equal(WHOLE) and (image.numpy() == WHOLE.numpy()).all() and len(computed) == 2
