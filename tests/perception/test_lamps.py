"""Lamps say where a vehicle is of which nothing else is seen."""

import pytest
import torch

from luxloop.perception.boxes import ABOVE_M, by_lamps

METRE = 20.0  # px
BOX = torch.tensor([[100.0, 100.0, 136.0, 130.0]]).double()  # 1.8 m by 1.5 m
NOBODY = torch.zeros(0, 4).double()


def frame(*spots: tuple[int, int]) -> torch.Tensor:
    """Dark, with bright spots of 3 px by 3 px around u and v."""
    picture = torch.full((200, 300), 0.01)
    for u, v in spots:
        picture[v - 1 : v + 2, u - 1 : u + 2] = 1.0
    return picture


@pytest.mark.parametrize("moved", [(0, 0), (5, 3), (-8, 2)])
def test_a_box_goes_where_both_lamps_are(moved: tuple[int, int]) -> None:
    lamps = [(u + moved[0], 130 - round(ABOVE_M * METRE) + moved[1]) for u in (105, 130)]
    found = by_lamps(frame(*lamps), BOX, torch.tensor([METRE]).double(), NOBODY)
    wanted = BOX + torch.tensor([*moved, *moved])
    torch.testing.assert_close(found, wanted.double(), rtol=0, atol=0.5)  # lamps are whole pixels, whose middles are half a pixel on


def test_without_lamps_there_is_nothing_to_say() -> None:
    metre = torch.tensor([METRE]).double()
    assert bool(by_lamps(frame(), BOX, metre, NOBODY).isnan().all())
    assert bool(by_lamps(frame((20, 20)), BOX, metre, NOBODY).isnan().all())  # far from the box
    assert bool(by_lamps(frame((105, 118), (130, 118)), BOX, metre, BOX).isnan().all())  # somebody who is lit
    assert bool(by_lamps(frame((112, 118), (124, 118)), BOX, metre, NOBODY).isnan().all())  # of somebody else, farther away
    assert bool(by_lamps(frame((105, 118)), BOX, metre, NOBODY).isnan().all())  # one says little of where the car is
    wide = frame(*((u, 118) for u in range(104, 134)))
    assert bool(by_lamps(wide, BOX, metre, NOBODY).isnan().all())  # one light, not two
    assert by_lamps(frame((118, 115)), NOBODY, metre[:0], NOBODY).shape == (0, 4)
