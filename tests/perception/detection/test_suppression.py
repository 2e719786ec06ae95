"""Overlaps of boxes, and which of them stay."""

import torch
from hypothesis import given
from hypothesis import strategies as st

from luxloop.perception.detection.detector import overlaps, suppress

numbers = st.integers(0, 40)
boxes = st.lists(st.tuples(numbers, numbers, st.integers(1, 20), st.integers(1, 20)), min_size=1, max_size=12).map(
    lambda found: torch.tensor([(x, y, x + w, y + h) for x, y, w, h in found]).float()
)


def test_overlap_is_shared_area_over_joint_area():
    box = torch.tensor([[0.0, 0.0, 4.0, 2.0]])
    others = torch.tensor([[0.0, 0.0, 4.0, 2.0], [2.0, 0.0, 6.0, 2.0], [0.0, 1.0, 2.0, 3.0], [4.0, 0.0, 8.0, 2.0], [1.0, 1.0, 1.0, 1.0]])
    assert torch.allclose(overlaps(box, others), torch.tensor([[1.0, 4 / 12, 2 / 10, 0.0, 0.0]]))


@given(boxes)
def test_nothing_that_stays_lies_on_what_is_surer_and_stays(found):
    stays = found[~suppress(found, 0.5)]
    assert torch.equal(stays[0], found[0])
    assert (overlaps(stays, stays).fill_diagonal_(0) <= 0.5).all()


def test_frames_do_not_see_each_other():
    one, other = torch.tensor([[0.0, 0, 4, 4], [0, 0, 4, 3]]), torch.tensor([[0.0, 0, 4, 4], [9, 9, 12, 12]])
    assert suppress(torch.stack([one, other]), 0.5).tolist() == [[False, True], [False, False]]
