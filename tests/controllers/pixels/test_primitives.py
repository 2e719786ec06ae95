"""Where a symbol's corners lie, which way it is read, and what counts as a picture."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from luxloop.controllers.pixels.primitives import QUANTITIES, Observer, Primitives, concatenate, rectangle, road_symbol
from tests.refusal import refusal


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, 0.2)])
def test_a_symbol_is_read_by_the_driver_and_turned_by_roll_within_pitch(roll, pitch):
    """Image row 0 is the far end, column 0 is on the left: far left, far right, near left, near right."""
    drawn = road_symbol(torch.tensor([17.0, 0.5, roll, pitch], dtype=torch.float64), 0.1, 2.0, 4.0, torch.ones(2, 3), 1.0, "u_abs")
    R = Rotation.from_euler("YX", [pitch, roll]).as_matrix()
    corners = [[2, 1, 0], [2, -1, 0], [-2, 1, 0], [-2, -1, 0]] @ R.T + [17, 0.5, 0.1]
    np.testing.assert_allclose(drawn.corners()[0], corners, atol=1e-12)
    np.testing.assert_allclose(drawn.normal[0], R[:, 2], atol=1e-12)


def board(x: float, **changes) -> Primitives:
    origin, d1, d2 = torch.tensor([[x, 1.0, 1.0], [0.0, -2.0, 0.0], [0.0, 0.0, -2.0]], dtype=torch.float64)
    return rectangle(origin, d1, d2, **{"value": 1.0, "quantity": "I_v", **changes})


def test_lists_are_put_together_and_taken_apart():
    image = torch.rand(3, 4)
    first = concatenate(board(10, weight=2.0, symbol=image), board(11, forced=True, priority=3, modules=("left",)))
    both = concatenate(first, road_symbol(torch.zeros(5, 4), 0.0, 1.0, 1.0, image, 0.5, "E_v"))
    assert both.origin.shape == (5, 3, 3)
    assert both.value.shape == both.weight.shape == (5, 3)
    assert [QUANTITIES[k] for k in both.quantity] == ["I_v", "I_v", "E_v"]
    assert both.modules == ((), ("left",), ())
    last = both.select(torch.tensor([False, True, True]))
    assert len(last) == 2
    assert last.forced.tolist() == [True, False]
    assert last.priority.tolist() == [3, 0]
    assert torch.equal(last.symbols[last.symbol_of[1]], image)
    image = image.double()
    shared = concatenate(board(10, symbol=image), board(11), board(12, symbol=image))
    assert len(shared.symbols) == 2 and shared.symbol_of.tolist() == [0, 1, 0], "an image of several is kept once"


def test_a_module_draws_what_names_it_its_lamp_or_nobody():
    scene = concatenate(board(10), board(11, modules=("left",)), board(12, modules=("lores", "hires")), board(13, modules=("right lores",)))
    assert scene.for_module("left lores").origin[:, 0].tolist() == [10, 11, 12]
    assert scene.for_module("right lores").origin[:, 0].tolist() == [10, 12, 13]
    assert scene.for_module("right auxiliary high beam").origin[:, 0].tolist() == [10]


def test_observers_go_with_their_primitives():
    eye = torch.tensor([[-1.0, 0.0, 1.5]], dtype=torch.float64)
    seen = replace(board(10), observer=Observer(eye, eye + 1, eye + 2, eye + 3, torch.tensor([True])))
    both = concatenate(board(11), seen)
    assert both.observer.active.tolist() == [False, True]
    assert torch.equal(both.select(both.observer.active).observer.eye, eye)
    assert concatenate(board(10), board(11)).observer is None


def test_vectors_may_be_sequences_and_take_the_precision_of_the_tensors_beside_them():
    for like in (torch.float32, torch.float64):
        corner = torch.tensor([10.1, 1.0, 0.0], dtype=like)
        beside = (torch.tensor([0.0, -1.7, 0.0], dtype=like), torch.tensor([-2.0, 0.0, 0.0], dtype=like))
        listed = rectangle(corner, [0, -1.7, 0], (-2, 0, 0), 1.0, normal=[0, 0, 3])
        made = rectangle(corner, *beside, 1.0, normal=corner.new_tensor([0, 0, 3]))
        for name in ("origin", "d1", "d2", "normal"):
            assert getattr(listed, name).dtype == like and getattr(listed, name).equal(getattr(made, name))
    assert rectangle([10, 1, 0], [0, -2, 0], [-2, 0, 0], 1.0).origin.dtype == torch.float32
    assert board(10, normal=torch.tensor([-3.0, 0.0, 4.0])).normal.tolist() == [[-0.6, 0.0, 0.8]], "of any length"
    np.testing.assert_allclose(board(10).normal, [[1, 0, 0]])


def test_what_is_no_primitive_is_refused_by_a_sentence():
    with refusal(r"no quantity 'lux'.*I_v, E_v, u_abs, u_rel"):
        board(10, quantity="lux")
    with refusal(r"shape \[3, 4, 5\]"):
        board(10, symbol=torch.ones(3, 4, 5))
    for weight in (-1.0, math.nan, torch.tensor(-0.1)):
        with refusal("weight is below zero or not a number"):
            board(10, weight=weight)
    with refusal("at least one"):
        concatenate()
